from __future__ import annotations

import math

import pytest
import torch

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.ephemeris import parse_utc, sun_position
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.eclipse import UNKNOWN, EclipseTable, planned_samples
from bsk_torch.sim.orbit import Arcs, spans_for
from bsk_torch.sim.span import PLAN_STEP, SPACING, Solver
from bsk_torch.vec3 import Vec3

GENERATED = 28_800.0


@pytest.fixture(scope="module")
def five_orbits(recording, make_arcs) -> Arcs:
    return make_arcs(recording("windows")["ic"], spans_for(41_000.0))


def table(arcs: Arcs, sampled: float = GENERATED) -> EclipseTable:
    """As after a reset that generated windows for ``sampled`` seconds."""
    eclipses = EclipseTable(arcs)
    eclipses.sampled[:] = sampled
    eclipses.refresh(torch.arange(len(arcs.start)))
    return eclipses


def at(time: float, n: int = 5) -> torch.Tensor:
    return torch.full((n,), time, dtype=torch.float64)


def test_answers_of_basilisk(recording, five_orbits):
    """468 queries on five orbits in increasing order; answers name samples of a 30 s grid and are identical, 1.0 for none."""
    recorded, eclipses = recording("windows"), table(five_orbits)
    rows = torch.arange(5)
    for k, time in enumerate(recorded["eclipse_time"].tolist()):
        assert (eclipses.needs(rows, at(time)) <= five_orbits.end).all()
        start, end = eclipses.query(rows, at(time))
        # Basilisk's clock turns 3840 s into 3840.0000000000005
        assert start.tolist() == recorded["eclipse_start"][:, k].round(9).tolist()
        assert end.tolist() == recorded["eclipse_end"][:, k].round(9).tolist()
    assert (recorded["eclipse_start"] == UNKNOWN).any()


def test_samples_lie_on_the_planned_arc(five_orbits):
    rows = torch.tensor([1, 4])
    samples = planned_samples(five_orbits, rows)
    for k in (0, 1, 2, 77, samples.x.shape[1] - 1):
        expected = five_orbits.planned_position(rows, at(k * PLAN_STEP, 2))
        torch.testing.assert_close(Vec3(*(x[:, k] for x in samples)).stack(), expected.stack(), rtol=0, atol=1e-8)


def first_dark(arcs: Arcs, row: int, after: float, until: float) -> tuple[float, float]:
    """First sample in the umbra and first sample out of it after a time, with the Sun where it is."""
    time = torch.arange(0.0, until, PLAN_STEP, dtype=torch.float64)
    r = arcs.planned_position(torch.full(time.shape, row), time)
    dark = illumination(r, Vec3.of(sun_position(arcs.et[row] + time))) <= 0.0
    later = time[1:] > after
    return time[1:][dark[1:] & ~dark[:-1] & later][0].item(), time[1:][~dark[1:] & dark[:-1] & later][0].item()


@pytest.mark.parametrize("time", [0.0, 29.0, 30.0, 1234.5, 9000.0])
def test_answers_by_definition(time, five_orbits):
    start, end = table(five_orbits).query(torch.tensor([0, 1, 2, 4]), at(time, 4))
    for k, row in enumerate((0, 1, 2, 4)):
        assert (start[k].item(), end[k].item()) == first_dark(five_orbits, row, time, 30_000.0)


def test_an_eclipse_that_starts_now_has_started(five_orbits):
    eclipses, row = table(five_orbits), torch.tensor([0])
    start, _ = eclipses.query(row, at(0.0, 1))
    again, _ = eclipses.query(row, start - 1e-3)
    after, _ = eclipses.query(row, start.clone())
    assert again == start
    assert after > start + 5000.0


def test_no_eclipse(five_orbits):
    """The dawn-dusk orbit: all three searches fail."""
    start, end = table(five_orbits).query(torch.tensor([3]), at(0.0, 1))
    assert start.item() == end.item() == UNKNOWN


def test_the_third_search_is_not_looked_at(five_orbits):
    """What lies beyond 6030 s is known only after the first query, which answers 1.0 even if the third search finds it."""
    row = torch.tensor([0])
    start, end = first_dark(five_orbits, 0, 0.0, 30_000.0)
    last = max(start, end)
    assert last < 6030.0  # so two searches are enough at the epoch
    fresh = table(five_orbits, 0.0)
    assert [x.item() for x in fresh.query(row, at(0.0, 1))] == [start, end]
    # 6030 s before the transition are the limit of what the second search sees
    behind = table(five_orbits, 0.0)
    behind.starts, behind.ends = behind.starts + 250, behind.ends + 250  # as if all came 7500 s later
    assert [x.item() for x in behind.query(row, at(0.0, 1))] == [UNKNOWN, UNKNOWN]
    assert behind.known[0] == 12_030.0
    assert [x.item() for x in behind.query(row, at(0.0, 1))] == [start + 7500.0, end + 7500.0]


def test_queries_of_some_rows_leave_the_others_alone(five_orbits):
    eclipses = table(five_orbits)
    known = eclipses.known.clone()
    eclipses.query(torch.tensor([1, 2]), at(5000.0, 2))
    assert torch.equal(eclipses.known[[0, 3, 4]], known[[0, 3, 4]])
    assert (eclipses.known[[1, 2]] > 0).all()


def test_moved_and_longer_arcs_answer_the_same(recording, make_arcs):
    initials = recording("windows")["ic"]
    arcs, long = make_arcs(initials, 4), make_arcs(initials, 8)
    eclipses, rows = table(arcs, 0.0), torch.arange(5)
    arcs.extend(torch.tensor([0, 2]), 1)
    arcs.grow()
    eclipses.refresh(rows)
    for query in (3700.0, 4000.0):
        answers = table(long, 0.0).query(rows, at(query))
        mine = eclipses.query(rows, at(query))
        eclipses.known[:] = 0.0
        eclipses.sampled[:] = 0.0
        assert [x.tolist() for x in mine] == [x.tolist() for x in answers]


def circular(spans: int) -> Arcs:
    """A planned arc filled with a circle in the equator's plane instead of a solution."""
    arcs = Arcs(1, spans, Solver(1.0, "eager", torch.device("cpu")))
    arcs.et[:] = parse_utc("2020-03-01T00:00:00")
    angle = math.sqrt(MU_EARTH / 6871e3**3) * SPACING * torch.arange(arcs.planned.shape[1], dtype=torch.float64)
    zero = torch.zeros_like(angle)
    r, v = elements_to_rv(Elements(zero + 6871e3, zero, zero + 0.9, zero, zero, angle))
    arcs.planned[0] = torch.cat([r.stack(), v.stack(), (r * (-MU_EARTH / 6871e3**3)).stack()], -1)
    return arcs


@pytest.mark.parametrize("days", [1, 30])
def test_a_long_arc_knows_where_the_sun_is(days):
    """All transitions, against the ephemeris at every sample: the Sun does not move on a straight line."""
    arcs = circular(24 * days)
    eclipses, row = table(arcs, arcs.length), torch.tensor([0])
    time = torch.arange(0.0, arcs.length, PLAN_STEP, dtype=torch.float64)
    dark = illumination(arcs.planned_position(torch.zeros_like(time).long(), time), Vec3.of(sun_position(arcs.et + time))) <= 0
    expected = time[1:][dark[1:] & ~dark[:-1]].tolist()
    found, now = [], at(0.0, 1)
    while len(found) < len(expected):
        now, _ = eclipses.query(row, now)
        found.append(now.item())
    assert found == expected
