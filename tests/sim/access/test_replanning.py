"""Windows and eclipses after manoeuvres, against elevations and shadows along the orbit that is flown."""

import pytest
import torch

from bsk_torch.astro.eclipse import in_umbra
from bsk_torch.astro.ephemeris import earth_orientation, sun_position
from bsk_torch.sim.access.links.line_of_sight_search import flown_positions
from bsk_torch.vec3 import Vec3
from tests.sim.orbit.arcs import sine_of_elevation
from tests.support.episodes import begun
from tests.support.manoeuvring import Imager, make, push

AHEAD = 6500.0
"""Seconds ahead that are looked at: more than an orbit."""

CLOSE = 0.06
"""Largest error of a crossing, s: look-ahead is metres away from the orbit that is flown, and samples are a second apart.

Measured 0.011 for the satellite that manoeuvres, whose look-ahead begins again, and 0.027 for the one that does not."""

PLAN = (
    (0.0, (0.0, 0.0, 0.0)),
    (437.5, (30.0, -20.0, 10.0)),
    (437.5, (-5.0, 40.0, 0.0)),
    (1612.0, (0.0, -60.0, 30.0)),
    (5001.5, (20.0, 20.0, 20.0)),
)
"""Times and changes of velocity; the first is none, the second and third come at the same time."""


def imagers(n=3, **options):
    defaults = dict(
        kind=Imager,
        sim_rate=0.5,
        time_limit=9000.0,
        sat_args={"imageTargetMinimumElevation": 0.6, "dv_available_init": 1000.0},
        backend="compiled",
    )
    return make(n, **(defaults | options))


def fly(env, seconds):
    """Drift so many seconds."""
    if seconds > 0.0:
        ticks = round(seconds / env.fleet.h)
        everyone = torch.ones(env.num_envs, dtype=torch.bool)
        env.fleet.run(everyone, env.fleet.ticks + ticks, env.fleet.ticks + ticks)


def manoeuvre(env, rows, plan=PLAN):
    """Fly and manoeuvre as planned, and stop after each manoeuvre."""
    for time, dv_N in plan:
        fly(env, time - float(env.fleet.sim_time[0]))
        push(env, *dv_N, rows=rows)
        yield time


def flight(env, row, begin, end, step=1.0):
    """Times, s, and positions [K, 3] in N, m, on the orbit that is flown."""
    simulator = env.simulator
    now = simulator.sim_time
    time = torch.full_like(now, end + 600.0)
    simulator.lookahead.reach_in_flight(time, now, simulator.lookahead.short_of(time))
    time = torch.arange(begin, end, step, dtype=torch.float64)
    return time, flown_positions(simulator.arcs, torch.full(time.shape, row), time, False)


def crossings(time, clearance):
    """Times at which a clearance [K] rises above zero, and at which it falls below, by a straight line between samples."""
    above = clearance > 0.0
    at = torch.nonzero(above[1:] != above[:-1]).squeeze(-1)
    share = clearance[at] / (clearance[at] - clearance[at + 1])
    when = time[at] + share * (time[at + 1] - time[at])
    return when[above[at + 1]], when[~above[at + 1]]


def compare_windows(env, row, kind, sites, elevation):
    """Largest difference of the windows that are known from brute force, of those that begin and end within what is looked at."""
    now = float(env.simulator.sim_time[row])
    time, r_N = flight(env, row, now, now + AHEAD)
    PN = earth_orientation(env.simulator.arcs.et[row] + time)
    r_P = (PN @ r_N.unsqueeze(-1)).squeeze(-1)
    known = env.satellite.find_windows(now + AHEAD, kind)
    worst, passes = 0.0, 0
    for place, site in enumerate(sites):
        clearance = sine_of_elevation(r_P, site) - torch.sin(elevation)
        rises, sets = crossings(time, clearance)
        mine = (known.place[row] == place) & torch.isfinite(known.close[row])
        opens, closes = (side[row][mine].sort().values for side in (known.open, known.close))
        inside = opens > now
        assert bool((~inside).any()) == bool(clearance[0] > 0.0), (place, now)
        opens, closes = opens[inside & (opens < now + AHEAD - 1.0)], closes[closes < now + AHEAD - 1.0]
        rises, sets = rises[rises < now + AHEAD - 1.0], sets[sets < now + AHEAD - 1.0]
        assert len(opens) == len(rises), (place, now)
        assert len(closes) == len(sets), (place, now)
        for found, wanted in ((opens, rises), (closes, sets)):
            worst = max(worst, float((found - wanted).abs().max()) if len(found) else 0.0)
        passes += len(sets)
    return worst, passes


@pytest.mark.parametrize("orbit", ["arc", "integrated"])
def test_windows_after_manoeuvres_against_brute_force(orbit):
    """Also of a row that does not manoeuvre beside one that does."""
    env = begun(imagers(2, orbit=orbit))
    rows = torch.tensor([True, False])
    elevation = torch.tensor(0.6, dtype=torch.float64)
    passes = 0
    for _ in manoeuvre(env, rows):
        env.satellite.find_next_opportunities(4)
        for row in (0, 1):
            sites = env.simulator.scenario_state["target_r_LP_P"][row]
            worst, number = compare_windows(env, row, "target", sites, elevation)
            assert worst < CLOSE, (row, worst)
            passes += number
    assert passes > 100


def test_eclipses_after_manoeuvres_against_brute_force():
    """They are the times at which it is entered and left, between samples of the flight."""
    env = begun(imagers(2))
    found = 0
    for now in manoeuvre(env, torch.tensor([True, True])):
        start, end = env.satellite.next_eclipse()
        time, r_N = flight(env, 0, now, now + AHEAD)
        dark = in_umbra(Vec3.of(r_N), Vec3.of(sun_position(env.simulator.arcs.et[0] + time))).double() - 0.5
        for answer, wanted in zip((start[0], end[0]), crossings(time, dark), strict=True):
            if len(wanted):
                assert abs(float(answer - wanted[0])) < 1.0
                found += 1
    assert found >= 6


def test_lazy_search_finds_what_a_search_of_everything_finds():
    lazy, eager = imagers(time_limit=30000.0), imagers(time_limit=30000.0)
    rows = torch.tensor([True, False, True])
    for env in (lazy, eager):
        env.reset()
    for _ in zip(manoeuvre(lazy, rows), manoeuvre(eager, rows), strict=True):
        eager.simulator.lookahead.search_visible(eager.simulator.sim_time)
        for kind, count in (("target", 4), ("ground_station", 2), ("target", 9)):
            mine, other = (env.satellite.find_next_opportunities(count, kind) for env in (lazy, eager))
            assert torch.equal(mine.place, other.place)
            torch.testing.assert_close(mine.open, other.open, rtol=0.0, atol=1e-6)
            torch.testing.assert_close(mine.close, other.close, rtol=0.0, atol=1e-6)
    access = lazy.simulator.access
    assert bool((access.ready < access.until)[0])  # or nothing was saved
    assert not bool((eager.simulator.access.ready < access.until).any())


def test_without_replanning_the_first_orbit_stays():
    """In bsk_rl look-ahead never follows a manoeuvre; nor does it with replan=False, whichever way orbits are flown."""
    for options in ({"replan": False}, {"compat": "bsk_rl"}, {"replan": False, "orbit": "integrated"}):
        moved, still = imagers(2, **options), imagers(2, **options)
        for env in (moved, still):
            env.reset()
        for time in manoeuvre(moved, torch.tensor([True, True])):
            fly(still, time - float(still.fleet.sim_time[0]))
            a, b = (env.satellite.find_next_opportunities(4) for env in (moved, still))
            assert all(torch.equal(x, y) for x, y in zip((a.place, a.open, a.close), (b.place, b.open, b.close), strict=True))
            assert all(torch.equal(x, y) for x, y in zip(*(env.satellite.next_eclipse() for env in (moved, still)), strict=True))
        fly(moved, 100.0)
        fly(still, 100.0)
        assert (moved.simulator.read("r_BN_N") - still.simulator.read("r_BN_N")).norm(dim=-1).min() > 1e5


def test_a_window_that_is_open_at_a_manoeuvre_keeps_its_beginning():
    env = begun(imagers(8))
    known = env.satellite.find_windows(3000.0)
    wide = torch.isfinite(known.close) & (known.close - known.open > 60.0) & (known.open > 100.0)
    row, k = (part[0] for part in torch.nonzero(wide, as_tuple=True))
    opens, close, place = (side[row, k] for side in (known.open, known.close, known.place))
    now = float(torch.round(opens + close)) / 2.0
    fly(env, now)
    push(env, 0.0, 20.0, 0.0)
    after = env.satellite.find_windows(now + 1.0)
    mine = (after.place[row] == place) & torch.isfinite(after.close[row])
    assert after.open[row][mine].tolist() == [float(opens)]
    assert 0.0 < abs(float(after.close[row][mine] - close)) < 20.0


def test_one_alone_equals_one_of_many():
    many, alone = imagers(4), imagers(1, env_ids=[2])
    for env in (many, alone):
        env.reset()
    mine = torch.tensor([True, False, True, True])
    steps = 0
    for _ in zip(manoeuvre(many, mine), manoeuvre(alone, mine[2:3]), strict=True):
        steps += 1
        a, b = (env.satellite.find_next_opportunities(4) for env in (many, alone))
        for x, y in ((a.place, b.place), (a.open, b.open), (a.close, b.close)):
            torch.testing.assert_close(x[2:3], y, rtol=0.0, atol=1e-6)
        assert all(torch.equal(x[2:3], y) for x, y in zip(*(env.satellite.next_eclipse() for env in (many, alone)), strict=True))
        assert torch.equal(many.simulator.read("r_BN_N")[2:3], alone.simulator.read("r_BN_N"))
    assert steps > 1


@pytest.mark.parametrize("options", [{}, {"replan": False}, {"orbit": "integrated"}])
def test_a_state_is_restored_in_mid_manoeuvre(options):
    """The change of velocity has been commanded and not been flown; the rows change their places."""
    first = begun(imagers(3, **options))
    rows = torch.tensor([True, False, True])
    for _ in manoeuvre(first, rows, PLAN[:4]):
        pass
    first.satellite.find_next_opportunities(4)
    saved = first.get_state()
    again = imagers(3, **options)
    again.restore(saved, [0, 1, 2], [2, 1, 0])
    for env in (first, again):
        fly(env, 500.0)
        push(env, 1.0, 1.0, 1.0)
        fly(env, 900.0)
    for name in ("r_BN_N", "v_BN_N", "dv_available", "thrust_count"):
        assert torch.equal(first.simulator.read(name)[[2, 1, 0]], again.simulator.read(name))
    a, b = (env.satellite.find_next_opportunities(4) for env in (first, again))
    assert torch.equal(a.place[[2, 1, 0]], b.place)
    torch.testing.assert_close(a.close[[2, 1, 0]], b.close, rtol=0.0, atol=1e-6)
