import math

import pytest
import torch

from bsk_torch.astro.earth_rotation import pole_matrix
from bsk_torch.astro.orbit import periapsis_radius
from bsk_torch.astro.sight import POLAR_STRETCH, line_clearance
from bsk_torch.comm import los
from bsk_torch.comm.los import flown_orbits, make_search, visible_pairs
from bsk_torch.constants import MU_EARTH, R_EARTH
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim.access.links import line_of_sight_search
from bsk_torch.sim.access.links.line_of_sight import SatellitePositions, speed_bound, visibility_margin
from bsk_torch.sim.access.links.line_of_sight_search import SatellitePairs, pole_directions
from bsk_torch.vec3 import Vec3
from tests.comm.fleets import drawn_elements, make_fleet, recorded, states, step, with_ranges

EXACT = 1e-7  # m; rounding of squared distances of 1e14 m^2, over twice the Earth's radius: measured 4e-9
FILES = ("los_unlimited", "los_ranges", "los_two_seconds")
Z = Vec3(*torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))


def directions(n: int) -> torch.Tensor:
    r = torch.randn(n, 3, dtype=torch.float64)
    return r / r.norm(dim=-1, keepdim=True)


def vec(*xyz: float) -> Vec3:
    return Vec3(*torch.tensor(xyz, dtype=torch.float64))


def test_clearance_is_the_distance_of_the_nearest_point():
    """Against a search along the line, which ends within a millimetre."""
    p, q = ((6.5e6 + 3e7 * torch.rand(500, 1, dtype=torch.float64) ** 3) * directions(500) for _ in range(2))
    p[::5] = q[::5] + 1e4 * directions(100)  # some are neighbours
    a, b = torch.zeros(500, 1, dtype=torch.float64), torch.ones(500, 1, dtype=torch.float64)
    for _ in range(80):
        thirds = a + (b - a) / 3.0, b - (b - a) / 3.0
        left, right = ((p + k * (q - p)).norm(dim=-1, keepdim=True) for k in thirds)
        a, b = torch.where(left < right, a, thirds[0]), torch.where(left < right, thirds[1], b)
    expected = (p + a * (q - p)).norm(dim=-1) - R_EARTH
    torch.testing.assert_close(line_clearance(Vec3.of(p), Vec3.of(q)), expected, rtol=0, atol=1e-3)
    r = 7.0e6
    assert line_clearance(vec(r, 0, 0), vec(-r, 0, 0)).item() == pytest.approx(-R_EARTH, abs=EXACT)
    assert line_clearance(vec(r, 0, 0), vec(r, 0, 0)).item() == pytest.approx(r - R_EARTH, abs=EXACT)
    assert line_clearance(vec(r, 0, 0), vec(2 * r, 0, 0)).item() == pytest.approx(r - R_EARTH, abs=EXACT)  # the end is nearest
    half = math.acos(R_EARTH / r)
    p, q = (vec(r * math.cos(half), r * math.sin(k * half), 0) for k in (-1, 1))
    assert line_clearance(p, q).item() == pytest.approx(0.0, abs=EXACT)


@pytest.mark.parametrize(("height", "sees"), [(0.98 * R_EARTH - 1.0, False), (0.98 * R_EARTH + 1.0, True)])
def test_the_earth_is_flattened_at_its_poles(height, sees):
    """A line across the pole at that height, in axes where the pole points anywhere."""
    pole, across = directions(2)
    across = torch.linalg.cross(pole, across)
    p, q = (SatellitePositions.of(Vec3.of(height * pole + k * 3e6 * across), Vec3.of(pole)) for k in (-1.0, 1.0))
    assert bool(visibility_margin(p, q, torch.tensor(math.inf)) > 0.0) == sees


def test_the_longest_range_is_in_range():
    p, q = (SatellitePositions.of(vec(*xyz), Z) for xyz in ((8e6, 0, 0), (8e6, 3e6, 4e6)))
    assert visibility_margin(p, q, torch.tensor(5e6)) > 0.0
    assert visibility_margin(p, q, torch.tensor(5e6).nextafter(torch.tensor(0.0)).double()) < 0.0
    assert visibility_margin(p, q, torch.tensor(5e6 - 100.0, dtype=torch.float64)).item() == pytest.approx(-50.0)
    assert visibility_margin(p, q, torch.tensor(math.inf)).item() == line_clearance(p.stretched, q.stretched).item()


def test_margins_change_no_faster_than_their_ends():
    """Both ends move by at most 10 km in some direction."""
    n = 4000
    reach = 1e7 * torch.rand(n, dtype=torch.float64)
    before = [6.4e6 * directions(n) * (1.0 + torch.rand(n, 1, dtype=torch.float64)) for _ in range(2)]
    after = [r + 1e4 * directions(n) for r in before]
    found = [visibility_margin(*(SatellitePositions.of(Vec3.of(r), Z) for r in ends), reach) for ends in (before, after)]
    change = (found[1] - found[0]).abs()
    assert change.amax() <= POLAR_STRETCH * 1e4
    assert change.amax() > 0.99 * 1e4  # the bound is not far from what happens


def test_positions_are_those_of_the_simulation(backend):
    fleet = make_fleet(states(drawn_elements(3)), 2, backend=backend)
    simulator = fleet.simulators[0]
    simulator.run(torch.tensor([7, 7, 7, 190, 190, 190]))
    rows = torch.tensor([5, 0, 3, 3])
    found = flown_orbits(simulator, torch.arange(3)).positions(rows, simulator.sim_time[rows])
    torch.testing.assert_close(found, simulator.read("r_BN_N")[rows], rtol=0, atol=1e-8)  # kernels and tensors round differently


@pytest.mark.compiled
def test_positions_by_kernel_and_by_tensors():
    satellites = states(drawn_elements(4))
    eager, compiled = (make_fleet(satellites, backend=name).simulators[0] for name in ("eager", "compiled"))
    compiled.arcs.flown = eager.arcs.flown
    rows, time = torch.randint(4, (100,)), 3600.0 * torch.rand(100, dtype=torch.float64)
    a, b = (flown_orbits(simulator, torch.arange(4)).positions(rows, time) for simulator in (eager, compiled))
    torch.testing.assert_close(a, b, rtol=0, atol=1e-8)


def test_the_axis_is_the_ephemeris():
    fleet = make_fleet(states(drawn_elements(2)), 2)
    simulator = fleet.simulators[0]
    time = torch.tensor([0.0, 1800.0, 3599.0, 3601.0], dtype=torch.float64)
    expected = pole_matrix(simulator.arcs.et + time).z.stack()
    torch.testing.assert_close(
        pole_directions(simulator.arcs, torch.arange(4), time, simulator.h_ns), expected, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("eccentricity", [0.001, 0.1, 0.7])
def test_no_satellite_is_faster_than_the_bound(eccentricity):
    """For two orbits, looked at every ten seconds, from wherever the satellite is; the bound is not more than 5 % above that."""
    oe = drawn_elements(30)
    oe[:, 0], oe[:, 1] = 6.8e6 / (1.0 - eccentricity), eccentricity
    fleet = make_fleet(states(oe))
    simulator = fleet.simulators[0]
    r, v = (Vec3.of(simulator.read(name)) for name in ("r_BN_N", "v_BN_N"))
    period = 2.0 * math.pi * math.sqrt((6.8e6 / (1.0 - eccentricity)) ** 3 / MU_EARTH)
    step(fleet, int(2.0 * period))
    time = torch.arange(0.0, 2.0 * period, 10.0, dtype=torch.float64)
    rows = torch.arange(30).repeat_interleave(len(time))
    orbits = flown_orbits(simulator, torch.arange(30))
    moved = orbits.positions(rows, time.repeat(30) + 0.1) - orbits.positions(rows, time.repeat(30))
    speed = moved.norm(dim=-1).view(30, -1).amax(1) / 0.1
    bound = speed_bound(r, v)
    assert (speed < bound).all()
    assert (bound < 1.05 * speed).all()
    assert (periapsis_radius(r, v) > 6.7e6).all()


@pytest.mark.parametrize("name", FILES)
def test_every_tick_against_basilisk(name, recording, backend):
    """Access of every ordered pair from the tick at the reset on; ticks within a millimetre of a limit are among them."""
    file = recording(name)
    assert file["nearest"].min() < 2e-3
    fleet, access = recorded(file, backend), torch.tensor(file["access"])
    assert (access != access.mT).any()  # delays, or ranges, tell both directions apart
    step(fleet, len(access))
    ticks = torch.arange(len(access))
    found = make_search(fleet, fleet.since, fleet.ticks).all_margins(torch.zeros_like(ticks), ticks)
    apart = ~torch.eye(len(file["ic"]), dtype=torch.bool)
    assert torch.equal((found > 0.0) & apart, access)


@pytest.mark.parametrize("backend", ["eager", "compiled"])
@pytest.mark.parametrize("name", FILES)
@pytest.mark.nightly("eager")
def test_every_step_against_basilisk(name, recording, backend):
    """bsk_rl's pairs after steps of 1 to 150 ticks."""
    file = recording(name)
    fleet, asked = recorded(file, backend), torch.tensor([True])
    by_ticks = torch.tensor(file["access"])
    flips = 0
    for ticks, pairs in zip(file["ticks"].tolist(), torch.tensor(file["pairs"]), strict=True):
        step(fleet, ticks)
        assert torch.equal(visible_pairs(fleet, asked)[0], pairs)
        seen = by_ticks[int(fleet.since) + 1 : int(fleet.ticks) + 1].any(0)
        flips += int((pairs != (seen | seen.mT)).any())
    assert flips > 0  # steps after which it matters that the log is a tick late


def by_brute_force(fleet: SatelliteFleet) -> torch.Tensor:
    """Who sees whom, sensors first, by a look in every tick."""
    first, last = fleet.since, torch.maximum(fleet.ticks - 1, fleet.since)
    seen = torch.zeros(fleet.num_envs, fleet.size, fleet.size, dtype=torch.bool)
    search = make_search(fleet, first, last)
    for env in torch.nonzero(fleet.ticks > first).squeeze(-1):
        ticks = torch.arange(int(first[env]), int(last[env]) + 1)
        seen[env] = (search.all_margins(env.expand(len(ticks)), ticks) > 0.0).any(0)
    return seen & ~torch.eye(fleet.size, dtype=torch.bool)


def mixed_fleet(n: int, s: int, eccentricity: float, backend: str = "eager", **options: object) -> SatelliteFleet:
    """Random satellites, half of them with a limited range."""
    reach = torch.where(torch.rand(s) < 0.5, 6e6 * torch.rand(s), -1.0)
    return make_fleet(with_ranges(states(drawn_elements(s, eccentricity)), reach.tolist()), n, backend=backend, **options)


@pytest.mark.parametrize(("eccentricity", "longest"), [(0.02, 30), (0.02, 900), (0.3, 900), (0.7, 6000)])
@pytest.mark.nightly("eager-0.7-6000", "eager-0.3-900")
def test_the_search_finds_what_brute_force_finds(eccentricity, longest, backend):
    fleet = mixed_fleet(12, 9, eccentricity, backend)
    asked, glimpses = torch.ones(12, dtype=torch.bool), 0
    for _ in range(4):
        step(fleet, torch.randint(1, longest, (12,)))
        found, seen = visible_pairs(fleet, asked), by_brute_force(fleet)
        assert torch.equal(visible_pairs(fleet, asked, directed=True), seen)
        assert torch.equal(found, seen | seen.mT)
        search = make_search(fleet, fleet.since, fleet.ticks - 1)
        ends = [search.all_margins(fleet.all_envs, tick) > 0.0 for tick in (search.first, search.last)]
        glimpses += int((found & ~(ends[0] | ends[0].mT | ends[1] | ends[1].mT)).sum())
    assert glimpses > 0 or longest == 30  # some are only seen between the ends of a step


def test_pairs_are_looked_at_as_everybody_is(backend):
    """Both ways to look give the same margins, of different ticks and episodes."""
    fleet = mixed_fleet(4, 6, 0.1, backend)
    step(fleet, 2000)
    search = make_search(fleet, fleet.since, fleet.ticks - 1)
    env, tick = torch.randint(4, (60,)), torch.randint(2000, (60,))
    i, j = torch.triu_indices(6, 6, 1)[:, torch.randint(15, (60,))]
    both, row = search.all_margins(env, tick), torch.arange(60)
    expected = torch.maximum(both[row, i, j], both[row, j, i])
    torch.testing.assert_close(search.pair_margins(SatellitePairs(env, i, j), tick), expected, rtol=0, atol=EXACT)
    for margins in (both[row, i, j], both[row, j, i]):
        assert (margins < expected - 1.0).any()  # either direction matters somewhere


@pytest.mark.parametrize("seer", [0, 1])
def test_a_glimpse_of_one_tick(seer):
    """Satellites meet head-on; one reaches as far as the other comes, no farther; steps begin and end all around that tick."""
    oe = torch.tensor([[7.0e6, 0.0, 0.0, 0.0, 0.0, -0.35], [7.02e6, 0.0, math.pi, 0.0, 0.0, -0.35]], dtype=torch.float64)
    fleet, ticks = make_fleet(with_ranges(states(oe), [1.0, 1.0])), torch.arange(1, 700)
    step(fleet, 700)
    search = make_search(fleet, fleet.since, fleet.ticks - 1)
    margins = search.all_margins(torch.zeros_like(ticks), ticks)[:, seer, 1 - seer]
    there = int(margins.argmax()) + 1
    assert 100 < there < 600
    reach = [1.0, 1.0]
    reach[seer] = 1.0 - 2.0 * float(margins.amax()) + 1e-3
    fleet = make_fleet(with_ranges(states(oe), reach), 600)
    begin = torch.randint(there + 60, (600,))
    begin[:40] = torch.arange(40) + there - 20
    length = torch.randint(1, 120, (600,))
    length[:40] = 3
    step(fleet, begin)
    step(fleet, length)
    expected = (begin <= there) & (there < begin + length)
    assert torch.equal(visible_pairs(fleet, torch.ones(600, dtype=torch.bool))[:, 0, 1], expected)
    assert expected.any()
    assert not expected.all()


def test_results_do_not_depend_on_batch_or_blocks(monkeypatch):
    """One episode by itself, all together, and all in blocks of a few pairs."""
    satellites = with_ranges(states(drawn_elements(7)), [-1, 3e6, -1, 4e6, -1, -1, 2e6])
    ticks = torch.tensor([1, 400, 33, 1000, 0, 2])
    many = make_fleet(satellites, 6)
    step(many, 100)
    step(many, ticks)
    whole = visible_pairs(many, torch.ones(6, dtype=torch.bool))
    for env in range(6):
        alone = make_fleet(satellites, 1)
        step(alone, 100)
        step(alone, int(ticks[env]))
        assert torch.equal(visible_pairs(alone, torch.tensor([True]))[0], whole[env])
    for size in (1, 5, 50):
        monkeypatch.setattr(line_of_sight_search, "PAIRS_PER_BLOCK", size)
        monkeypatch.setattr(los, "PAIRS_PER_BATCH", size)
        assert torch.equal(visible_pairs(many, torch.ones(6, dtype=torch.bool)), whole)
    assert not whole[4].any()  # no tick has passed
    assert whole.any()


def test_types_of_satellites_see_one_another(backend):
    """Satellites 0 to 4 of one type, or of two that take turns."""
    satellites = with_ranges(states(drawn_elements(5)), [-1, 5e6, -1, 4e6, -1])
    one, two = (make_fleet(satellites, 3, backend=backend, types=types) for types in (None, [[0, 2, 3], [1, 4]]))
    for ticks in ([1, 500, 60], [900, 3, 250]):
        for fleet in (one, two):
            step(fleet, ticks)
        found, expected = (visible_pairs(fleet, torch.ones(3, dtype=torch.bool)) for fleet in (two, one))
        assert torch.equal(found, expected)
        assert found.any()


def test_nobody_sees_alone_or_where_nobody_asks():
    fleet = mixed_fleet(3, 6, 0.02)
    step(fleet, 1000)
    every = visible_pairs(fleet, torch.ones(3, dtype=torch.bool))
    some = visible_pairs(fleet, torch.tensor([False, True, False]))
    assert torch.equal(some[1], every[1])
    assert every.any()
    assert not some[[0, 2]].any()
    fleet = make_fleet(states(drawn_elements(1)), 2)
    step(fleet, 50)
    assert visible_pairs(fleet, torch.ones(2, dtype=torch.bool)).tolist() == [[[False]], [[False]]]


def test_arcs_that_have_moved_on_are_an_error():
    fleet = mixed_fleet(2, 3, 0.02)
    step(fleet, 20000)
    for simulator in fleet.simulators:
        simulator.lookahead.reach(simulator.sim_time + 10800.0, simulator.sim_time)
    with pytest.raises(RuntimeError, match="before looking ahead"):
        visible_pairs(fleet, torch.ones(2, dtype=torch.bool))
    assert not visible_pairs(fleet, torch.zeros(2, dtype=torch.bool)).any()
