"""Groups: their rows end in the tick in which the first of them stops, and are what they would be without the others."""

import itertools
from functools import cache

import pytest
import torch

from bsk_torch.codegen.ir import Loop
from bsk_torch.codegen.kernel import Entry, Kernel, Samples
from bsk_torch.codegen.tiling import SPARE, in_tiles
from bsk_torch.codegen.trace import Tracer
from bsk_torch.sim.component import Field, Track
from tests.support.refusals import check_refusals, refusal

ISAS = ["", "avx2", "default"] if torch.backends.cpu.get_cpu_capability() in ("AVX2", "AVX512") else ["", "default"]
GROUPS = [1, 2, 3, 7, 12, 40]
LONGEST = 40
MODES = 3
PAIR = Track("pair", 3.0, (Field("x"), Field("y")), count=2, before=0)
NANOSECONDS = 400_000_000


@cache
def walkers(isa: str, mixed: bool = False, stops: bool = True) -> Kernel:
    """Rows that do something of everything, and stop when their fuse is down to zero.

    What is not needed any more when a tick ends, what no tick reads, what comes as another kind than it is read as, planes that
    trade places, and what lasts as long as the call or a record, of one row or of all.
    """
    program = Tracer()
    dtype = torch.float32 if mixed else torch.float64
    x, _, rounded, left, right, still, fuse = (
        program.input("state", k, dtype=dtype if k == 2 else torch.float64) for k in range(7)
    )
    gain, offset = (program.input("shared", k) for k in range(2))
    push = program.input("own", 0, dtype=dtype).to(torch.float64)
    on = program.input("flag", 0) > 0.5
    before, _, after, _ = (program.input("track", 1, k) for k in range(4))
    slope = (after - before) * (1.0 / 3.0)
    height = before + slope * program.input("tau", 1)
    fuse = fuse - 1.0
    (pushed,) = on.only(lambda: [x * (gain * gain) + push * push], [x - offset / gain])
    moved = pushed + height * 1e-3 + rounded.to(torch.float64) * 1e-2
    rounded = moved.sin() + still
    ticks = program.input("ticks_now")
    outputs = [moved, ticks, rounded, right, left, still, fuse, offset * 2.0, (fuse > 3.0)]
    with pytest.MonkeyPatch.context() as patch:
        if isa:
            patch.setenv("BSK_TORCH_ISA", isa)
        kernel = Kernel("test of groups", Loop(program, outputs, (PAIR,), stop=fuse == 0.0 if stops else None), lockstep=2)
        assert kernel.independent.width == (kernel.lockstep.width if stops else kernel.independent.width)
        return kernel


class Groups:
    """Random groups."""

    def __init__(self, groups: int, group: int) -> None:
        """Fuses end before, with and after the number of ticks, or never; some groups have no tick to run."""
        n = groups * group
        self.group, self.n = group, n
        counts = torch.where(torch.rand(groups) < 0.15, 0, torch.randint(0, LONGEST, (groups,)))
        self.counts = counts.repeat_interleave(group)
        far = torch.randint(-3, LONGEST * max(1, group // 2), (n,))
        self.fuse = torch.where(torch.rand(n) < 0.1, self.counts, far).double()
        self.state = torch.rand(9, n).double()
        self.state[6] = self.fuse
        self.ticks = torch.randint(0, 20, (groups,)).repeat_interleave(group)
        self.mode = torch.randint(0, MODES, (n,))
        records = torch.randn(n, 20, 2, dtype=torch.float64)
        self.track = Samples(records, torch.rand(n, dtype=torch.float64))
        self.options = dict(
            shared=torch.tensor([0.99, 0.3], dtype=torch.float64),
            own=torch.rand(1, n).double(),
            flags=torch.tensor([[0.0, 1.0, 1.0]], dtype=torch.float64),
            nanoseconds=NANOSECONDS,
        )

    @property
    def ends(self) -> torch.Tensor:
        """How many ticks each row should run."""
        burnt = torch.where((self.fuse >= 1.0) & (self.fuse <= self.counts), self.fuse.long(), self.counts)
        return burnt.view(-1, self.group).amin(1).repeat_interleave(self.group)

    def after(self, kernel: Kernel, counts: torch.Tensor, **options) -> tuple[torch.Tensor, torch.Tensor]:
        """State and numbers of ticks."""
        state = self.state.clone()
        options = dict(mode=self.mode, ticks=self.ticks) | self.options | options
        return state, kernel(state, counts, (self.track,), **options)

    def faults(self, kernel: Kernel, tolerance: float = 0.0, **options) -> list[str]:
        """What differs, bit for bit unless there is a tolerance, from rows that each run by itself until its group's end."""
        state, ran = self.after(kernel, self.counts, lockstep=self.group, **options)
        expected, alone = self.after(kernel, self.ends)
        if tolerance:
            same = torch.allclose(state, expected, rtol=tolerance, atol=tolerance)
        else:
            same = torch.equal(state.view(torch.int64), expected.view(torch.int64))
        checks = {"ticks": torch.equal(ran, self.ends), "ticks alone": torch.equal(alone, self.ends), "state": same}
        return [name for name, right in checks.items() if not right]


@pytest.mark.compiled
def test_rows_of_a_group_end_with_the_first_that_stops():
    """In plain C++, the compiler does not fuse the same products with sums in both libraries: a rounding in a few ticks."""
    failures = []
    for isa, mixed, group in itertools.product(ISAS, (False, True), GROUPS):
        kernel, tolerance = walkers(isa, mixed), 0.0 if isa != "default" else 1e-5 if mixed else 1e-12
        rows = [Groups(int(torch.randint(1, 60, ())), group) for _ in range(30)]
        if differ := {fault for groups in rows for fault in groups.faults(kernel, tolerance)}:
            failures.append(f"{isa or 'native'}, {'mixed' if mixed else 'double'}, groups of {group}: {differ} differ")
    assert not failures, "\n".join(failures)


@pytest.mark.compiled
@pytest.mark.parametrize("group", GROUPS)
def test_without_modes(group):
    groups = Groups(20, group)
    groups.mode[:] = 0
    expected, _ = groups.after(walkers(""), groups.ends)
    state, ran = groups.after(walkers(""), groups.counts, lockstep=group)
    assert torch.equal(ran, groups.ends)
    assert torch.equal(state, expected)


@pytest.mark.compiled
@pytest.mark.parametrize("group", GROUPS)
def test_several_threads(group):
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        for _ in range(5):
            assert not Groups(300, group).faults(walkers(""))
    finally:
        torch.set_num_threads(before)


@pytest.mark.compiled
@pytest.mark.parametrize("group", GROUPS)
def test_the_expected_ticks_change_nothing(group):
    for groups in (1, 5, 70):
        rows = Groups(groups, group)
        for expected in (rows.ends, torch.randint(0, LONGEST, (rows.n,)), torch.zeros(rows.n, dtype=torch.int64)):
            assert not rows.faults(walkers(""), expected_ticks=expected)


@pytest.mark.compiled
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("tick", [1, 2, 9, 10])
def test_a_group_may_stop_in_its_first_and_in_its_last_tick(tick, last):
    """Whichever row stops, in whichever block."""
    groups = Groups(3, 40)
    groups.counts[:] = 10
    groups.fuse[:] = groups.state[6] = 99.0
    groups.fuse[-1 if last else 40] = groups.state[6, -1 if last else 40] = tick
    assert groups.ends.view(3, 40)[:, 0].tolist() == ([10, 10, tick] if last else [10, tick, 10])
    assert not groups.faults(walkers(""))


@pytest.mark.compiled
def test_several_rows_may_stop_at_once_and_one_after_another():
    groups = Groups(4, 12)
    groups.counts[:], groups.fuse[:] = 30, 99.0
    groups.fuse[[0, 5, 11]], groups.fuse[[12, 20]], groups.fuse[[24, 25]] = 7.0, 7.0, torch.tensor([8.0, 9.0]).double()
    groups.state[6] = groups.fuse
    assert groups.ends[::12].tolist() == [7, 7, 8, 30]
    assert not groups.faults(walkers(""))


@pytest.mark.compiled
def test_rows_without_time_are_untouched():
    """Bit for bit, even where they hold no numbers."""
    groups = Groups(30, 7)
    still = groups.counts == 0
    groups.state[0, still] = torch.nan
    state, _ = groups.after(walkers(""), groups.counts, lockstep=7)
    assert still.any()
    assert torch.equal(state[:, still].view(torch.int64), groups.state[:, still].view(torch.int64))
    assert (state[0, ~still] != groups.state[0, ~still]).all()


@pytest.mark.compiled
def test_tiles_end_with_their_last_group_and_change_no_counts():
    """A bound of a million years costs nothing where all groups stop."""
    groups = Groups(20, 12)
    groups.counts[:], groups.state[6], groups.state[6, ::12] = 2**62, 30.0, 7.0
    _, ran = groups.after(walkers(""), groups.counts, lockstep=12)
    assert (ran == 7).all()
    before = groups.counts.clone()
    groups.after(walkers(""), groups.counts, lockstep=12)
    assert torch.equal(groups.counts, before)
    groups.counts[:] = 9
    state, ran = groups.after(walkers(""), groups.counts, lockstep=12)
    again, alike = groups.after(walkers(""), 9, lockstep=12)
    assert torch.equal(ran, alike)
    assert torch.equal(state, again)
    groups = Groups(0, 12)
    _, ran = groups.after(walkers(""), groups.counts, lockstep=12)
    assert len(ran) == 0


@pytest.mark.compiled
def test_without_stop_there_are_no_groups():
    groups, kernel = Groups(5, 12), walkers("", stops=False)
    state, ran = groups.after(kernel, groups.counts, lockstep=12)
    expected, _ = groups.after(kernel, groups.counts)
    assert ran is groups.counts
    assert torch.equal(state, expected)
    assert "lockstep" not in vars(kernel)
    check_refusals(refusal(lambda: kernel.lockstep, ValueError, "test of groups", "lockstep"))


@pytest.mark.compiled
def test_libraries_are_built_when_they_are_needed(monkeypatch):
    built = []
    monkeypatch.setattr("bsk_torch.codegen.kernel.Entry.of", lambda loop, lockstep, name: built.append(name) or Entry(8, None))
    program = Tracer()
    x = program.input("state", 0)
    make = lambda **options: Kernel("tick", Loop(program, [x + 1.0], stop=x > 3.0), **options)
    one, many = make(), make(lockstep=5)
    assert built == ["tick", "tick in lockstep"]
    for kernel in (one, many, one, many):
        assert kernel.independent.width == kernel.lockstep.width == 8
    assert sorted(built) == ["tick", "tick", "tick in lockstep", "tick in lockstep"]


def test_tiles_hold_whole_groups():
    failures = []
    for groups, group, width in itertools.product([1, 2, 9, 300], [2, 3, 7, 12, 40, 100, 1001], [2, 4, 8, 16]):
        counts = torch.randint(0, 9, (groups,)).repeat_interleave(group)
        tiles = in_tiles(counts, counts, torch.randint(0, 3, (groups * group,)), group, width)
        real, full = tiles.groups < groups, tiles.groups[0]
        homes = [set(row.unique().tolist()) - {groups} for row in tiles.groups]
        checks = {
            "shapes": tiles.rows.shape == tiles.groups.shape == (tiles.size[0], tiles.size[1] * width),
            "rows": torch.equal(tiles.rows[real].sort().values, torch.arange(groups * group)),
            "groups": torch.equal(tiles.rows[real] // group, tiles.groups[real]),
            "ends": torch.equal(tiles.ends, torch.cat([counts[::group], torch.zeros(1, dtype=torch.int64)])),
            "homes": sum(len(home) for home in homes) == groups == len(set().union(*homes)),
            "spare": groups < 300 or (full == groups).sum() <= SPARE * (full < groups).sum(),
        }
        failures += [f"{groups} groups of {group}, width {width}: {name}" for name, right in checks.items() if not right]
    assert not failures, "\n".join(failures)


@pytest.mark.parametrize("group", [2, 3, 12, 64])
def test_tiles_are_of_like_durations_and_blocks_of_like_modes(group):
    groups, width = 1000, 8
    counts = torch.randperm(groups).repeat_interleave(group)
    mode = torch.randint(0, MODES, (groups * group,))
    tiles = in_tiles(counts, counts, mode, group, width)
    real = tiles.groups < groups
    ends = tiles.ends[tiles.groups]
    assert (torch.where(real, ends, 0).amax(1)[:-1] < torch.where(real, ends, groups).amin(1)[1:]).all()
    modes = torch.where(real, mode[tiles.rows], 0)[:-1].view(-1, width)
    assert (modes.amin(1) == modes.amax(1)).float().mean() > 0.4


@pytest.mark.compiled
def test_rejects_groups_that_do_not_fit_and_what_they_write():
    kernel, groups, uneven = walkers(""), Groups(4, 6), Groups(4, 6)
    uneven.counts[:] = 5
    uneven.counts[14] = 3
    written = torch.zeros(24, LONGEST, 1, dtype=torch.float64)
    check_refusals(
        refusal(lambda: groups.after(kernel, groups.counts, lockstep=7), ValueError, "lockstep=7", "24"),
        refusal(lambda: uneven.after(kernel, uneven.counts, lockstep=6), ValueError, "counts", "group 2", "[3, 5]", "ticks"),
        refusal(
            lambda: groups.after(kernel, groups.counts, lockstep=6, written=written), ValueError, kernel.name, "written", "None"
        ),
    )
