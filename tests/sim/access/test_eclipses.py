import csv
import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from bsk_torch.astro.eclipse import illumination, sunlight_margin
from bsk_torch.astro.ephemeris import parse_utc, sun_position
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.codegen.kernel import Samples
from bsk_torch.constants import MU_EARTH, R_EARTH
from bsk_torch.sim.access.light.eclipses import NOT_FOUND, SHORTEST_SEARCH, EclipseTable, search_range
from bsk_torch.sim.access.lookahead import LookAhead
from bsk_torch.sim.access.visibility.kernels import make_visibility
from bsk_torch.sim.access.visibility.planned import PlannedOrbits, position_between
from bsk_torch.sim.environment.ephemeris import ephemeris_records
from bsk_torch.sim.orbit.arcs import Arcs, segments_for
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, PLAN_STEP
from bsk_torch.sim.orbit.kernel_solver import make_solver
from bsk_torch.sim.orbit.restartable import RestartableArcs
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
    eclipses.search(torch.arange(n), flight.view, at(SHORTEST_SEARCH, n), at(sampled, n))
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


PART = 250
"""Random orbits that are solved at once."""


def random_orbits(n: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Position and velocity of orbits with perigees from 200 km to the geostationary height, half of them eccentric."""
    u = torch.rand(7, n, dtype=torch.float64)
    perigee = R_EARTH + 200e3 * (35_786.0 / 200.0) ** u[0]
    a = perigee + torch.where(u[1] < 0.5, 0.0, (42_164e3 - perigee).clamp(min=0.0) * u[2])
    angles = math.pi * u[3], *(2.0 * math.pi * u[k] for k in (4, 5, 6))
    r, v = elements_to_rv(Elements(a, 1.0 - perigee / a, *angles))
    return r.stack(), v.stack()


def crossed(dark: Callable[[torch.Tensor, torch.Tensor], torch.Tensor], row: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
    """Times [m] within a sample after ``a`` [m] at which the darkness of rows [m] changes, by bisection to a millisecond."""
    before, b = dark(row, a), a + 10.0
    for _ in range(14):
        middle = 0.5 * (a + b)
        same = dark(row, middle) == before
        a, b = torch.where(same, middle, a), torch.where(same, b, middle)
    return 0.5 * (a + b)


def first_after(row: torch.Tensor, times: torch.Tensor, now: torch.Tensor) -> torch.Tensor:
    """First of the times [m] of rows [m] after ``now`` [n], [n]; infinity if there is none."""
    later = torch.where(times > now[row], times, torch.inf)
    return torch.full_like(now, torch.inf).scatter_reduce(0, row, later, "amin")


@pytest.mark.parametrize(
    ("part", "backend"), [(0, "eager"), *(pytest.param(part, "compiled", marks=pytest.mark.compiled) for part in (1, 2, 3))]
)
@pytest.mark.nightly("0-eager", "2-compiled", "3-compiled")
def test_next_eclipses_of_random_orbits_against_brute_force(part, backend):
    """Perigees from 200 km to 35,786 km: illumination every 10 s for 1.1 revolutions, refined to a millisecond."""
    torch.manual_seed(part)
    (r, v), et = random_orbits(PART), 7.8e8 * torch.rand(PART, dtype=torch.float64)
    solver, sight = make_solver(1.0, backend, CPU), make_visibility(backend, CPU)
    options: dict = {"horizon": 600.0, "segment": 600.0, "compat": False}
    lookahead = LookAhead(PART, 1, solver, sight, {}, **options)
    rows = torch.arange(PART)
    lookahead.solve(rows, et, r, v, at(600.0, PART))
    ahead, latest = lookahead.eclipses.ahead, 5000.0
    arcs = Arcs(PART, segments_for(float(ahead.max()) + latest + 600.0), solver)
    whole = arcs.solve(rows, et, r, v)[:, ::2].contiguous()
    view = PlannedOrbits(Samples(whole, at(0.0, PART)), arcs.ephemeris_samples)

    def dark(row: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
        place, _ = position_between(*view.take(row), time)
        return illumination(place, Vec3.of(sun_position(et[row] + time))) <= 0.0

    count = ((ahead + latest) / 10.0).ceil().long() + 1
    row = rows.repeat_interleave(count)
    time = 10.0 * (torch.arange(len(row)) - (count.cumsum(0) - count)[row]).double()
    shaded = dark(row, time)
    (change,) = torch.nonzero((shaded[1:] != shaded[:-1]) & (row[1:] == row[:-1]), as_tuple=True)
    times, enters = crossed(dark, row[change], time[change]), shaded[change + 1]
    seen, without = 0, 0
    for _ in range(3):
        now = latest * torch.rand(PART, dtype=torch.float64)
        for answer, chosen in zip(lookahead.next_eclipse(now), (enters, ~enters), strict=True):
            expected = first_after(row[change][chosen], times[chosen], now)
            none = expected > now + ahead
            torch.testing.assert_close(answer, torch.where(none, now + ahead, expected), rtol=0.0, atol=5e-3)
            seen, without = seen + int((~none).sum()), without + int(none.sum())
    assert min(seen, without) > PART // 4


def test_next_eclipses_are_those_of_skyfield(solve_arcs):
    """SGP4's orbits from 400 km to the geostationary ring, on which record_skyfield.py has looked for the center of the Sun.

    Its center is hidden seconds before the umbra begins, and a minute before on high orbits; both are computed on the arcs.
    The file is from scripts/recorders/record_skyfield.py.
    """
    with Path(__file__).with_name("skyfield_eclipses.csv").open(encoding="utf-8") as file:
        recorded = list(csv.DictReader(line for line in file if not line.startswith("#")))
    axes = "xyz"
    initials = [
        {
            "utc_init": case["utc"],
            "rN": [float(case[f"{axis}_m"]) for axis in axes],
            "vN": [float(case[f"v{axis}_m_s"]) for axis in axes],
        }
        for case in recorded
    ]
    flight = Solved(*solve_arcs(initials, segments_for(100_000.0)), "eager")
    r, v = (torch.tensor([one[name] for one in initials], dtype=torch.float64) for name in ("rN", "vN"))
    eclipses = EclipseTable(flight.arcs, make_visibility("eager", CPU))
    ahead = search_range(r, v)
    eclipses.search(torch.arange(len(r)), flight.view, ahead, at(0.0, len(r)))
    answers = eclipses.next(at(0.0, len(r)))
    compared = 0
    for row, case in enumerate(recorded):
        for answer, name, inward in zip(answers, ("start_s", "end_s"), (1.0, -1.0), strict=True):
            if not case[name]:
                assert answer[row] == ahead[row]
                continue
            time = float(case[name]) + torch.arange(-300.0, 300.0, 0.1, dtype=torch.float64)
            place, sun = place_and_sun(flight, row, time)
            center, umbra = (time[int(sunlight_margin(place, sun, part).abs().argmin())] for part in (0.5, 0.0))
            bound = 0.2 if float(case[name]) < 6000.0 else 2.5  # measured 0.1 and 2.0: high orbits feel Sun and Moon in SGP4
            assert abs(float(center) - float(case[name])) < bound
            assert abs(float(answer[row] - umbra)) < 0.1
            assert inward * float(answer[row] - center) > 3.0
            compared += 1
    assert compared == 16


def test_answers_depend_on_nothing_that_was_asked_before_or_of_other_rows(five_orbits):
    asked, fresh = table(five_orbits, 0.0), table(five_orbits)
    for time in (0.0, 3000.0, 9000.0):
        asked.next(at(time))
        asked.query(at(time))
    assert all(torch.equal(x, y) for x, y in zip(asked.next(at(1000.0)), fresh.next(at(1000.0)), strict=True))
    # Each at its own time, as if alone.
    times = torch.tensor([0.0, 5000.0, 100.0, 9000.0, 12_345.0], dtype=torch.float64)
    together = table(five_orbits, 0.0)
    answers = together.query(times)
    for row in range(5):
        alone = table(five_orbits, 0.0)
        expected = alone.query(at(times[row].item()))
        assert [x[row].item() for x in answers] == [x[row].item() for x in expected]
        assert (together.known[row], together.sampled[row]) == (alone.known[row], alone.sampled[row])


def test_without_eclipses_searches_end(five_orbits):
    """The dawn-dusk orbit; bsk_rl names the first second."""
    assert [float(time[3]) for time in table(five_orbits).next(at(500.0))] == [500.0 + SHORTEST_SEARCH] * 2
    # The dawn-dusk orbit: all three searches fail.
    start, end = table(five_orbits).query(at(0.0))
    assert start[3].item() == end[3].item() == NOT_FOUND


def place_and_sun(flight: Solved, row: int, time: torch.Tensor) -> tuple[Vec3, Vec3]:
    """Where a satellite is on its planned arc, and the Sun where the ephemeris has it."""
    return planned(flight.view, row, time), Vec3.of(sun_position(flight.arcs.et[row] + time))


def in_umbra(flight: Solved, row: int, time: torch.Tensor) -> torch.Tensor:
    """Whether the umbra covers a satellite."""
    return illumination(*place_and_sun(flight, row, time)) <= 0.0


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


def test_transitions_are_listed_in_order_from_the_next_one_on(five_orbits):
    eclipses = table(five_orbits)
    for row in range(5):
        for found, expected in zip(
            (eclipses.starts, eclipses.ends), transitions(five_orbits, row, five_orbits.arcs.length), strict=True
        ):
            times = torch.ceil(found[row][torch.isfinite(found[row])] / PLAN_STEP) * PLAN_STEP
            assert times.tolist() == [t for t in expected.tolist() if t <= five_orbits.arcs.length]
            assert torch.isinf(found[row, len(times) :]).all()
    eclipses = table(five_orbits)
    start = eclipses.query(at(0.0))[0][0].item()
    assert eclipses.query(at(start - 1e-3))[0][0] == start
    assert eclipses.query(at(start))[0][0] > start + 5000.0


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


def random_tables(n: int, restarts: bool) -> list[EclipseTable]:
    """The same transitions and progress of searches twice: for queries by the kernel, and by torch."""
    solver = make_solver(1.0, "eager", CPU)
    arcs = RestartableArcs(n, 1, solver) if restarts else Arcs(n, 1, solver)
    if restarts:
        arcs.epoch = torch.where(torch.arange(n) % 3 == 0, 0.0, 9000.0 * torch.rand(n).double())
    origin = arcs.begun.unsqueeze(-1) if isinstance(arcs.begun, torch.Tensor) else 0.0
    samples = torch.randint(1, 900, (2, n, 6)).double().sort(-1).values
    missing = torch.arange(6) >= torch.randint(0, 7, (2, n, 1))
    starts, ends = (origin + PLAN_STEP * (samples - 0.4)).masked_fill(missing, math.inf)
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
        refusal(lambda: eclipses.query(at(0.0).float()), TypeError, "time", "[5]", "torch.float32", "torch.float64"),
        refusal(lambda: short.query(at(0.0)), TypeError, "known", "[4]"),
    )


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
