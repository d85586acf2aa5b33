"""Loops: each row runs its own number of ticks, or as many as there are until its stop."""

import itertools
import math
from functools import cache

import pytest
import torch

from bsk_torch.codegen.ir import Loop
from bsk_torch.codegen.kernel import Entry, Kernel, Samples
from bsk_torch.codegen.trace import Tracer
from bsk_torch.sim.component import Field, Track
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

ISAS = ["", "avx2", "default"] if torch.backends.cpu.get_cpu_capability() in ("AVX2", "AVX512") else ["", "default"]
SIZES = [1, 2, 3, 17, 64]
LONGEST = 40


@cache
def fuses(isa: str, mixed: bool = False, stops: bool = True) -> Kernel:
    """Rows that double a number, and stop when their fuse is down to zero or, where they are ``stubborn``, in every later tick.

    When it is down to -5, the number is none any more: what ended rows go on computing must not matter.
    """
    program = Tracer()
    x, fuse, seen = (program.input("state", k) for k in range(3))
    stubborn = program.input("own", 0) > 0.5
    left = (program.input("state", 3, dtype=torch.float32) if mixed else fuse) - 1.0
    stop = (left == 0.0) | (stubborn & (left < 0.0))
    x = torch.where(left == -5.0, torch.nan, x * 2.0)
    outputs = [x, fuse - 1.0, program.input("ticks_now"), left]
    with pytest.MonkeyPatch.context() as patch:
        if isa:
            patch.setenv("BSK_TORCH_ISA", isa)
        return Kernel("test of stops", Loop(program, outputs, (), [x, seen], stop=stop if stops else None))


class Rows:
    """Random rows, what a kernel makes of them, and what should become of them."""

    def __init__(self, n: int) -> None:
        """Fuses end before, with and after the number of ticks, or never; numbers are random."""
        self.counts = torch.randint(0, LONGEST, (n,))
        fuse = torch.where(torch.rand(n) < 0.2, self.counts, torch.randint(-3, LONGEST, (n,))).double()
        self.state = torch.stack([torch.rand(n).double(), fuse, torch.zeros(n, dtype=torch.float64), fuse])
        self.stubborn = torch.randint(0, 2, (1, n)).double()
        self.ticks = torch.randint(0, 1000, (n,))

    def after(
        self, kernel: Kernel, expected_ticks: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """State, numbers of ticks and what was written, -1 where nothing was."""
        state = self.state.clone()
        written = -torch.ones(len(self.counts), LONGEST, 2, dtype=torch.float64)
        options = dict(own=self.stubborn, ticks=self.ticks, expected_ticks=expected_ticks, written=written)
        ran = kernel(state, self.counts, (), **options)
        return state, ran, written

    def expected(self, stops: bool = True) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """The same by plain Python."""
        state, ran = self.state.clone(), self.counts.clone()
        written = -torch.ones(len(self.counts), LONGEST, 2, dtype=torch.float64)
        for row in range(len(ran)):
            x, fuse, seen, _ = self.state[:, row].tolist()
            for k in range(1, int(self.counts[row]) + 1):
                fuse -= 1.0
                x = float("nan") if fuse == -5.0 else 2.0 * x
                written[row, k - 1] = torch.tensor([x, seen])
                seen = float(self.ticks[row]) + k
                state[:, row] = torch.tensor([x, fuse, seen, fuse])
                if stops and (fuse == 0.0 or (fuse < 0.0 and self.stubborn[0, row] > 0.5)):
                    ran[row] = k
                    break
        return state, ran, written


def differing(found, expected) -> list[str]:
    """Names of what is not the same bit for bit."""
    parts = zip(("state", "ticks", "written"), found, expected, strict=True)
    return [name for name, a, b in parts if not torch.equal(a.view(torch.int64), b.view(torch.int64))]


def test_rows_end_where_they_stop():
    failures = []
    for isa, mixed, n in itertools.product(ISAS, (False, True), SIZES):
        samples = [Rows(n) for _ in range(40)]
        if differ := {name for rows in samples for name in differing(rows.after(fuses(isa, mixed)), rows.expected())}:
            failures.append(f"{isa or 'native'}, {'mixed' if mixed else 'double'}, {n} rows: {differ} differ")
    assert not failures, "\n".join(failures)


def test_rows_without_stop_run_their_counts_which_are_not_changed():
    rows = Rows(64)
    state, ran, written = rows.after(fuses("", stops=False))
    assert ran is rows.counts
    assert not differing((state, ran, written), rows.expected(stops=False))
    for n in (*SIZES, fuses("").independent.width):
        rows = Rows(n)
        before = rows.counts.clone()
        rows.after(fuses(""))
        assert torch.equal(rows.counts, before)


@pytest.mark.parametrize("tick", [1, 2, 9, 10])
def test_a_row_may_stop_in_its_first_and_in_its_last_tick(tick):
    rows = Rows(5)
    rows.counts[:], rows.state[1:4:2] = torch.tensor([10, 0, 10, 3, 10]), torch.tensor([99.0, tick, tick, 99.0, 99.0])
    _, ran, _ = rows.after(fuses(""))
    assert ran.tolist() == [10, 0, tick, 3, 10]
    assert not differing(rows.after(fuses("")), rows.expected())


@pytest.mark.parametrize("n", SIZES)
def test_the_expected_ticks_change_nothing(n):
    rows = Rows(n)
    for expected_ticks in (rows.state[1].long(), torch.randint(0, LONGEST, (n,)), torch.zeros(n, dtype=torch.int64)):
        assert not differing(rows.after(fuses(""), expected_ticks), rows.expected())


def test_blocks_end_with_their_last_row():
    """A bound of a million years costs nothing where all rows stop."""
    rows = Rows(64)
    rows.counts[:], rows.state[1:4:2] = 2**62, 7.0
    written = torch.zeros(64, 7, 2, dtype=torch.float64)
    ran = fuses("")(rows.state, rows.counts, (), own=rows.stubborn, ticks=rows.ticks, written=written)
    assert (ran == 7).all()


def test_several_threads():
    rows, before = Rows(1000), torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert not differing(rows.after(fuses("")), rows.expected())
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize(("blocks", "threads"), [(0, 1), (1, 1), (2, 2), (5, 4)])
def test_no_more_threads_than_blocks(blocks, threads, monkeypatch):
    kernel, seen = fuses(""), []
    monkeypatch.setattr(kernel, "independent", Entry(kernel.independent.width, lambda *args: seen.append(args[:2])))
    monkeypatch.setattr(torch, "get_num_threads", lambda: 4)
    Rows(blocks * kernel.independent.width).after(kernel)
    assert seen == [(blocks, threads)]


TRIPLE = Track("triple", 10.0, (Field("x"),), count=3, before=1)


@cache
def looking() -> Kernel:
    """Rows whose state is a time; written are the first record that the tick sees, and tau."""
    program = Tracer()
    time, tau = program.input("state", 0), program.input("tau", 1)
    first = program.input("track", 1, 0)
    return Kernel("test of tracks", Loop(program, [time + tau], (TRIPLE,), [first, tau], clock=time))


def looked_up(time: torch.Tensor, records: int = 6) -> tuple[torch.Tensor, torch.Tensor]:
    """Written planes [n, 2] and state [n] after a tick; record k of row r is 100 r + k."""
    n = len(time)
    table = (100.0 * torch.arange(n).view(-1, 1, 1) + torch.arange(records).view(1, -1, 1)).double()
    state, written = time.double().unsqueeze(0).clone(), torch.empty(n, 1, 2, dtype=torch.float64)
    samples = Samples(table, torch.zeros(n, dtype=torch.float64))
    looking()(state, torch.ones(n, dtype=torch.int64), (samples,), written=written)
    return written.squeeze(1), state[0]


def test_a_tick_sees_the_records_around_its_time():
    """Beyond the ends of the table, however far, it sees those at the end."""
    time = torch.tensor([0.0, 9.0, 10.0, 19.0, 25.0, 45.0, 1e3, -5.0, 1e300, -1e300, 33.0], dtype=torch.float64)
    first = torch.tensor([0, 0, 0, 0, 1, 3, 3, 0, 3, 0, 2])
    written, _ = looked_up(time)
    assert torch.equal(written[:, 0], 100.0 * torch.arange(11) + first)
    assert torch.equal(written[:, 1], time - 10.0 * (first + 1))


@pytest.mark.parametrize("n", SIZES)
def test_times_that_are_no_numbers_see_the_first_record_and_stay_none(n):
    """Nor do they disturb others."""
    time = 40.0 * torch.rand(n).double()
    broken = torch.rand(n) < 0.4
    broken[0] = True
    written, state = looked_up(torch.where(broken, math.nan, time))
    whole, expected = looked_up(time)
    assert torch.equal(written[broken, 0], 100.0 * broken.nonzero().squeeze(-1))
    assert written[broken, 1].isnan().all()
    assert state[broken].isnan().all()
    assert torch.equal(written[~broken], whole[~broken])
    assert torch.equal(state[~broken], expected[~broken])


def test_infinite_times():
    written, state = looked_up(torch.tensor([math.inf, -math.inf]))
    assert written.tolist() == [[3.0, math.inf], [100.0, -math.inf]]
    assert state.tolist() == [math.inf, -math.inf]


def test_rejects_wrong_tables_and_tensors():
    rows = Rows(8)
    parts = {"state": rows.state, "counts": rows.counts, "own": rows.stubborn, "ticks": rows.ticks}
    written = torch.empty(8, LONGEST, 2, dtype=torch.float64)
    looked_up(torch.zeros(2), records=3)

    def run(name, change):
        given = parts | {name: change(parts[name])}
        fuses("")(given.pop("state"), given.pop("counts"), (), **given, written=written)

    apart = lambda part: torch.stack([part, part], -1)[..., 0]
    other = lambda part: part.to(torch.float32 if part.dtype == torch.float64 else torch.int32)
    check_refusals(
        refusal(lambda: looked_up(torch.zeros(2), records=2), ValueError, "table", "[2, 2, 1]", "3 records"),
        *(refusal(lambda name=name: run(name, apart), ValueError, "strides", list(parts[name].shape)) for name in parts),
        *(
            refusal(lambda name=name: run(name, other), ValueError, other(parts[name]).dtype, "float64", "int64")
            for name in parts
        ),
    )
