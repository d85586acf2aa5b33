"""Cases as environments: batteries, limits of satellites, episodes to learn from, and what a rule delivers."""

import numpy as np
import pytest
import torch

from bsk_torch.astro.earth_rotation import sidereal_time_1982
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.tasks.aeossp import case_env, drawn_case_env
from bsk_torch.tasks.aeossp.geometry import angle, ephemeris_time, on_ellipsoid, orbit, tracks, turned
from bsk_torch.tasks.aeossp.rules import find_power, find_slews
from tests.tasks.aeossp.flown_case import AGILE, case_of, satellite

pytestmark = pytest.mark.compiled

LOOKS = [(0, 300, 10, 10.0), (0, 340, 15, -15.0), (0, 420, 10, 20.0), (1, 300, 20, 10.0), (1, 400, 10, -20.0), (1, 500, 10, 5.0)]


def small(**limits):
    """A case with two satellites, the second one with other limits, and as many tasks as they have time for."""
    return case_of([satellite(0, 0, AGILE), satellite(1, 1, AGILE | limits)], LOOKS)


def flown(env, policy):
    """The environment after an episode."""
    td = env.reset()
    while not bool(td["done"].all()):
        td = env.step(policy(td))["next"]
    return env


def test_rules_serve_tasks_in_their_times():
    case, _ = small()
    env = case_env(case, 2)
    completed = flown(env, rule("nearest", env)).rewarder.completed
    assert env.scenario.target_names == list(case.requests.names)
    assert (env.rewarder.measures()["WCR"] == 1.0).all()
    assert (completed[0] == completed[1]).all()
    assert (completed[0].numpy() >= case.requests.release_s + case.requests.duration_s).all()


def test_satellites_keep_smaller_limits_than_others_with_their_sensor():
    case, _ = small(off_nadir=25.0)
    env = case_env(case)
    env.reset()
    places = on_ellipsoid(case.requests)
    windows = env.satellites[0].simulator.lookahead.access.windows["target"]
    for number, limit in enumerate((30.0, 25.0)):
        known = windows.close[number].isfinite()
        task = windows.place[number, known].numpy()
        for time in (windows.open[number, known].numpy(), windows.close[number, known].numpy()):
            r = orbit(case, number, time)[0]
            line = turned(places[task], sidereal_time_1982(ephemeris_time(case, time)).numpy()) - r
            off_nadir = np.degrees(angle(-r, line))
            # limits of elevations are those of the lowest point of the orbit, and 0.2 degrees larger
            assert limit - 1.0 < off_nadir.min()
            assert off_nadir.max() < limit + 1e-3


def test_idle_batteries_are_those_of_the_rules():
    case, plan = small()
    env = case_env(case)
    env.reset()
    wait = env.satellites[0].action_description.index("action_drift")
    flown(env, lambda td: td.set(("agents", "action"), torch.full((1, 2), wait)))
    idle = plan.take(np.zeros(len(plan), dtype=bool))
    power = find_power(case, idle, find_slews(case, idle, tracks(case)))
    charge = env.satellites[0].dynamics.battery_charge.numpy() / 3600.0
    np.testing.assert_allclose(charge, power.final_wh, atol=0.3)  # the eclipse has a penumbra, and begins within a step of 10 s


def test_episodes_to_learn_from_differ_and_have_the_tasks_of_a_part_of_the_day():
    case, _ = small(off_nadir=25.0)
    env = drawn_case_env(case, 32, hours=0.1, backend="eager", seed=1)
    env.reset()
    started = (env.scenario.release < 360.0) & (env.scenario.due > 0.0)
    # windows of 1,200 s begin from 1,200 s before the start to 1,200 s after it
    assert abs(float(started.double().mean()) - 0.65) < 0.1
    assert (env.scenario.due - env.scenario.release == 1200.0).all()
    assert len(env.satellites[0].dynamics.r_BN_N.round().unique(dim=0)) > 10
