from __future__ import annotations

import math

import pytest
import torch

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.ephemeris import parse_utc, sun_position
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.codegen.kernel import Samples
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.access.eclipses import NOT_FOUND, EclipseTable
from bsk_torch.sim.access.visibility.backend import make_visibility
from bsk_torch.sim.access.visibility.planned import PlannedOrbits
from bsk_torch.sim.environment.ephemeris import ephemeris_records
from bsk_torch.sim.orbit.arcs import Arcs, segments_for
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, PLAN_STEP
from bsk_torch.sim.orbit.restartable import RestartableArcs
from bsk_torch.sim.orbit.solvers import make_solver
from bsk_torch.vec3 import Vec3
from tests.sim.orbit.arcs import Solved, planned
from tests.support.refusals import check_refusals, refusal

CPU = torch.device("cpu")
GENERATED = 28_800.0


@pytest.fixture(scope="module")
def five_orbits(recording, fly) -> Solved:
    return fly(recording("windows")["ic"], segments_for(41_000.0))


def table(flight: Solved, sampled: float = GENERATED) -> EclipseTable:
    """As after a reset that generated windows for ``sampled`` seconds."""
    eclipses = EclipseTable(flight.arcs, make_visibility(flight.backend, CPU))
    n = len(flight.arcs.start)
    eclipses.search(torch.arange(n), flight.view, at(sampled, n))
    return eclipses


def at(time: float, n: int = 5) -> torch.Tensor:
    return torch.full((n,), time, dtype=torch.float64)


def test_answers_of_basilisk(recording, five_orbits):
    """468 queries on five orbits in increasing order; answers name samples of a 30 s grid and are identical, 1.0 for none."""
    recorded, eclipses = recording("windows"), table(five_orbits)
    for k, time in enumerate(recorded["eclipse_time"].tolist()):
        assert (eclipses.needs(at(time)) <= five_orbits.arcs.end).all()
        start, end = eclipses.query(at(time))
        # Basilisk's clock turns 3840 s into 3840.0000000000005
        assert start.tolist() == recorded["eclipse_start"][:, k].round(9).tolist()
        assert end.tolist() == recorded["eclipse_end"][:, k].round(9).tolist()
    assert (recorded["eclipse_start"] == NOT_FOUND).any()


# -- answers by definition --------------------------------------------------------------------------------------------------


def in_umbra(flight: Solved, row: int, time: torch.Tensor) -> torch.Tensor:
    """Whether the umbra covers a satellite on its planned arc, with the Sun where the ephemeris has it."""
    r_sun = Vec3.of(sun_position(flight.arcs.et[row] + time))
    return illumination(planned(flight.view, row, time), r_sun) <= 0.0


def transitions(flight: Solved, row: int, until: float) -> tuple[torch.Tensor, torch.Tensor]:
    """First samples in the umbra and first samples out of it."""
    time = torch.arange(0.0, until, PLAN_STEP, dtype=torch.float64)
    dark = in_umbra(flight, row, time)
    return time[1:][dark[1:] & ~dark[:-1]], time[1:][~dark[1:] & dark[:-1]]


def first_dark(flight: Solved, row: int, after: float) -> tuple[float, float]:
    """First of both after a time."""
    return tuple(times[times > after][0].item() for times in transitions(flight, row, 30_000.0))


@pytest.mark.parametrize("time", [0.0, 29.0, 30.0, 1234.5, 9000.0])
def test_answers_by_definition(time, five_orbits):
    start, end = table(five_orbits).query(at(time))
    for row in (0, 1, 2, 4):
        assert (start[row].item(), end[row].item()) == first_dark(five_orbits, row, time)


def test_transitions_are_listed_in_order(five_orbits):
    eclipses = table(five_orbits)
    for row in range(5):
        for found, expected in zip(
            (eclipses.starts, eclipses.ends), transitions(five_orbits, row, five_orbits.arcs.length), strict=True
        ):
            times = found[row][torch.isfinite(found[row])]
            assert times.tolist() == [t for t in expected.tolist() if t <= five_orbits.arcs.length]
            assert torch.isinf(found[row, len(times) :]).all()


def test_an_eclipse_that_starts_now_has_started(five_orbits):
    eclipses = table(five_orbits)
    start = eclipses.query(at(0.0))[0][0].item()
    assert eclipses.query(at(start - 1e-3))[0][0] == start
    assert eclipses.query(at(start))[0][0] > start + 5000.0


def test_no_eclipse(five_orbits):
    """The dawn-dusk orbit: all three searches fail."""
    start, end = table(five_orbits).query(at(0.0))
    assert start[3].item() == end[3].item() == NOT_FOUND


def test_the_third_search_is_not_looked_at(five_orbits):
    """What lies beyond 6030 s is known only after the first query, which answers 1.0 even if the third search finds it."""
    start, end = first_dark(five_orbits, 0, 0.0)
    last = max(start, end)
    assert last < 6030.0  # so two searches are enough at the epoch
    fresh = table(five_orbits, 0.0)
    assert [x[0].item() for x in fresh.query(at(0.0))] == [start, end]
    # 6030 s before the transition are the limit of what the second search sees
    behind = table(five_orbits, 0.0)
    behind.starts, behind.ends = behind.starts + 7500.0, behind.ends + 7500.0
    assert [x[0].item() for x in behind.query(at(0.0))] == [NOT_FOUND, NOT_FOUND]
    assert behind.known[0] == 12_030.0
    assert [x[0].item() for x in behind.query(at(0.0))] == [start + 7500.0, end + 7500.0]


def test_rows_are_queried_independently(five_orbits):
    """Each at its own time, as if alone."""
    times = torch.tensor([0.0, 5000.0, 100.0, 9000.0, 12_345.0], dtype=torch.float64)
    together = table(five_orbits, 0.0)
    answers = together.query(times)
    for row in range(5):
        alone = table(five_orbits, 0.0)
        expected = alone.query(at(times[row].item()))
        assert [x[row].item() for x in answers] == [x[row].item() for x in expected]
        assert together.known[row] == alone.known[row]
        assert together.sampled[row] == alone.sampled[row]


# -- the kernel -------------------------------------------------------------------------------------------------------------


def random_tables(n: int, restarts: bool) -> list[EclipseTable]:
    """The same transitions and progress of searches twice: for queries by the kernel, and by torch."""
    solver = make_solver(1.0, "eager", CPU)
    arcs = RestartableArcs(n, 1, solver) if restarts else Arcs(n, 1, solver)
    if restarts:
        arcs.epoch = torch.where(torch.arange(n) % 3 == 0, 0.0, 9000.0 * torch.rand(n).double())
    origin = arcs.begun.unsqueeze(-1) if isinstance(arcs.begun, torch.Tensor) else 0.0
    samples = torch.randint(0, 900, (2, n, 6)).double().sort(-1).values
    missing = torch.arange(6) >= torch.randint(0, 7, (2, n, 1))
    starts, ends = (origin + PLAN_STEP * samples).masked_fill(missing, math.inf)
    progress = 30_000.0 * torch.rand(2, n).double()
    tables = [EclipseTable(arcs, make_visibility(backend, CPU)) for backend in ("compiled", "eager")]
    for eclipses in tables:
        eclipses.starts, eclipses.ends = starts, ends
        eclipses.sampled, eclipses.known = (times.clone() for times in progress)
    return tables


@pytest.mark.parametrize("restarts", [False, True])
@pytest.mark.parametrize("n", [1, 1200])
def test_the_kernel_agrees_with_torch(n, restarts):
    """Bit for bit, on the grid, next to it and between its samples; known, found by either search, and not found."""
    one, other = random_tables(n, restarts)
    found, failed = 0, 0
    for offset in (0.0, 1e-9, -1e-9, 3e-8, 12.3):
        time = other.arcs.begun + PLAN_STEP * torch.randint(1, 500, (n,)).double() + offset
        answers, expected = one.query(time), other.query(time)
        assert all(torch.equal(x, y) for x, y in zip(answers, expected, strict=True))
        assert torch.equal(one.known, other.known)
        assert torch.equal(one.sampled, other.sampled)
        failed, found = failed + int((expected[0] == NOT_FOUND).sum()), found + int((expected[0] != NOT_FOUND).sum())
    assert n == 1 or min(found, failed) > n


@pytest.mark.parametrize("kernel", [0, 1])
def test_queries_beyond_the_arcs_note_nothing(kernel):
    """As long as they are answered, with what :meth:`EclipseTable.query` answers."""
    eclipses, same = (random_tables(5, False)[1 - kernel] for _ in range(2))
    for name in ("starts", "ends", "sampled", "known"):
        setattr(same, name, getattr(eclipses, name).clone())
    before = eclipses.sampled.clone(), eclipses.known.clone()
    for times, covered in (([0.0] * 4 + [1e5], False), ([0.0] * 5, True)):
        eclipses.arcs.start[:] = eclipses.known.max() + 2 * PLAN_STEP - eclipses.arcs.length
        time = torch.tensor(times, dtype=torch.float64)
        found = eclipses.query_if_covered(time)
        assert (found is not None) == covered == bool((eclipses.needs(time) <= eclipses.arcs.end).all())
        if not covered:
            assert torch.equal(eclipses.sampled, before[0])
            assert torch.equal(eclipses.known, before[1])
        else:
            assert all(torch.equal(x, y) for x, y in zip(found, same.query(time), strict=True))


def test_rejects_tables_that_the_kernel_would_misread():
    eclipses, short = (random_tables(5, False)[0] for _ in range(2))
    short.known = at(0.0, 4)
    check_refusals(
        [
            refusal(lambda: eclipses.query(at(0.0).float()), TypeError, "time", "[5]", "torch.float32", "torch.float64"),
            refusal(lambda: short.query(at(0.0)), TypeError, "known", "[4]"),
        ]
    )


# -- arcs that move on ------------------------------------------------------------------------------------------------------


def test_moved_and_longer_arcs_answer_the_same(recording, fly):
    initials = recording("windows")["ic"]
    flight, long = fly(initials, 4), fly(initials, 8)
    eclipses = table(flight, 0.0)
    flight.arcs.extend(torch.tensor([0, 2]))
    eclipses.lengthen(torch.tensor([0, 2]))
    flight.arcs.grow()
    eclipses.lengthen(torch.arange(5))
    for query in (3700.0, 4000.0, 5300.0):
        eclipses.known[:], eclipses.sampled[:] = 0.0, 0.0
        expected = table(long, 0.0).query(at(query))
        assert [x.tolist() for x in eclipses.query(at(query))] == [x.tolist() for x in expected]


def test_transitions_before_the_arcs_are_forgotten(recording, fly):
    """The list does not grow with the time that has passed, whatever the other rows do."""
    flight = fly(recording("windows")["ic"], 3)
    eclipses, widths = table(flight), []
    for _ in range(12):
        flight.arcs.extend(torch.tensor([0, 4]))
        eclipses.lengthen(torch.tensor([0, 4]))
        kept = eclipses.starts[0][torch.isfinite(eclipses.starts[0])]
        assert (kept >= flight.arcs.start[0]).all()
        assert (kept.diff() > 5000.0).all()
        widths.append(eclipses.starts.shape[1])
    assert max(widths) <= 4
    untouched = table(fly(recording("windows")["ic"], 3))
    assert [t for t in eclipses.starts[2].tolist() if t < math.inf] == [t for t in untouched.starts[2].tolist() if t < math.inf]


def test_rows_are_adopted(recording, fly):
    initials = recording("windows")["ic"]
    mine, other = table(fly(initials, 3), 0.0), table(fly(initials[::-1], 3), 600.0)
    other.query(at(100.0))
    mine.copy_rows(torch.tensor([1, 3]), other, torch.tensor([1, 3]))
    for name in ("starts", "ends"):
        for row, source in ((0, table(fly(initials, 3))), (1, other), (3, other)):
            finite = [[t for t in getattr(x, name)[row].tolist() if t < math.inf] for x in (mine, source)]
            assert finite[0] == finite[1]
    assert torch.equal(mine.known[[1, 3]], other.known[[1, 3]])
    assert torch.equal(mine.sampled, torch.where(torch.tensor([False, True, False, True, False]), other.sampled, 0.0))


def circular(spans: int, backend: str) -> Solved:
    """A planned arc that is a circle in the equator's plane instead of a solution."""
    arcs = Arcs(1, spans, make_solver(1.0, backend, CPU))
    arcs.et[:] = parse_utc("2020-03-01T00:00:00")
    angle = math.sqrt(MU_EARTH / 6871e3**3) * PLAN_STEP * torch.arange(2 * arcs.flown.shape[1], dtype=torch.float64)
    zero = torch.zeros_like(angle)
    r, _ = elements_to_rv(Elements(zero + 6871e3, zero, zero + 0.9, zero, zero, angle))
    ephemeris = ephemeris_records(arcs.et, spans + 1)
    return Solved(arcs, PlannedOrbits(Samples(r.stack().unsqueeze(0), at(0.0, 1)), Samples(ephemeris, at(0.0, 1))), backend)


@pytest.mark.parametrize("days", [1, 30])
def test_a_long_arc_knows_where_the_sun_is(days, backend):
    """All transitions, against the ephemeris at every sample: the Sun does not move on a straight line."""
    flight = circular(24 * days, backend)
    assert flight.arcs.length == days * 24 * ARC_SEGMENT
    eclipses = table(flight, flight.arcs.length)
    expected = transitions(flight, 0, flight.arcs.length)[0].tolist()
    found, now = [], at(0.0, 1)
    while len(found) < len(expected):
        now, _ = eclipses.query(now)
        found.append(now.item())
    assert found == expected
