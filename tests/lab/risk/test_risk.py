"""Risks: agreement with independent episodes, and episodes that can be flown again."""

import json

import pytest
import torch

import bsk_torch
from bsk_torch.lab.planners.base_policies import base_of
from bsk_torch.lab.risk.estimate import risk
from bsk_torch.lab.risk.rare_events import rare_event
from bsk_torch.lab.risk.rare_flights import DRAWN, RETURNS, Flights, play_again, read_paths, save_paths
from bsk_torch.rand import blended
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.evaluation.statistics import wilson
from tests.lab.planners.conftest import scanning

pytestmark = pytest.mark.compiled

LOW = "battery_charge_fraction<0.22"
SMALL = dict(event=LOW, episodes=40, repetitions=4)


@pytest.fixture(scope="module")
def found():
    return risk(scanning(16, 1200.0), "random", **SMALL)


def test_the_estimate_agrees_with_independent_episodes_whatever_the_batch(found):
    env = scanning(200, 1200.0)
    env.reset()
    flights = Flights(env, base_of("random", env), rare_event(env, LOW, None))
    seen = flights(torch.arange(600) + 10**6)["level"] == torch.inf
    low, high = wilson(int(seen.sum()), 600)
    assert found.thresholds
    assert found.probability.low < high
    assert low < found.probability.high
    assert 0.0 < found.probability.mean < 0.2
    other = risk(scanning(7, 1200.0), "random", **SMALL)
    assert torch.equal(found.estimates, other.estimates)
    assert torch.equal(found.sample.seeds, other.sample.seeds)
    assert torch.equal(found.sample.flown[DRAWN], other.sample.flown[DRAWN])
    assert (found.ways, found.actions) == (other.ways, other.actions)


@pytest.fixture(scope="module")
def screened():
    return risk(scanning(16, 1200.0), "random", **SMALL, method="screen", pool=400)


def test_both_methods_agree_and_describe_the_same_ways(found, screened):
    assert screened.probability.low < found.probability.high
    assert found.probability.low < screened.probability.high
    assert screened.tally.episodes < found.tally.episodes
    assert screened.screening.learned == 80
    assert 0.0 < screened.screening.largest < 0.5
    assert screened.screening.explained > 0.5
    assert screened.shifts[0].name == "storedCharge_Init"
    assert [way.cause for way in screened.ways] == [()]
    kept = json.loads(json.dumps(screened.to_dict(), allow_nan=False))
    assert (kept["screening"]["pool"], kept["thresholds"]) == (400, [])


def test_screened_episodes_do_not_depend_on_the_batch_and_are_those_of_plain_seeds(screened):
    other = risk(scanning(7, 1200.0), "random", **SMALL, method="screen", pool=400)
    assert torch.equal(screened.estimates, other.estimates)
    assert torch.equal(screened.sample.seeds, other.sample.seeds)
    assert screened.actions == other.actions
    env = scanning(3, 1200.0)
    paths = screened.paths()
    again = evaluate(bsk_torch.rule("random", env), env, seeds=paths.seeds.tolist())
    assert torch.equal(again.returns, paths.flown[RETURNS])


def test_the_ways_are_described(found):
    (way,) = found.ways
    assert (way.cause, way.share) == ((), pytest.approx(1.0))
    assert 0.0 <= way.time[0] <= way.time[2] <= 1200.0
    assert found.shifts[0].name == "storedCharge_Init"
    assert found.shifts[0].larger < 0.2
    assert found.shifts[0].event[1] < found.shifts[0].all[1]
    kept = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert kept["probability"]["mean"] == pytest.approx(float(found.estimates.mean()))
    assert kept["ways"][0]["seed"] == int(found.paths().seeds[0])


def test_a_saved_episode_is_flown_again_with_its_actions_and_by_its_policy(found, tmp_path):
    path = tmp_path / "paths.json"
    sample = found.paths()
    save_paths(path, {"preset": "NadirScan-v1"}, sample, found.actions)
    env = scanning(3, 1200.0)
    assert torch.equal(play_again(env, path), sample.flown[RETURNS])
    content, blend = read_paths(path)
    assert content["preset"] == "NadirScan-v1"
    with blended(blend):
        again = evaluate(bsk_torch.rule("random", env), env, seeds=[content["episodes"][0]["seed"]])
    assert torch.equal(again.returns, sample.flown[RETURNS][:1])
    path.write_text("{}")
    with pytest.raises(ValueError, match="is not a file of episodes written by 'bsk-torch risk'"):
        read_paths(path)


@pytest.mark.parametrize(("method", "high"), [("subset", 0.3), ("screen", 0.4)])
def test_an_event_that_never_happens_has_an_upper_limit(method, high):
    given = dict(event="storage_level_fraction>2", episodes=20, repetitions=4, smallest=0.05, pool=100)
    never = risk(scanning(16, 300.0), "rule", method=method, **given)
    assert never.probability.mean == 0.0
    assert 0.0 < never.probability.high < high
    assert never.ways == []
    assert json.loads(json.dumps(never.to_dict(), allow_nan=False))["saved"] is None


def test_satellites_of_a_team_are_named_and_own_functions_are_events():
    env = bsk_torch.make("Constellation-v1", num_envs=20, env_ids=[0] * 20, time_limit=60.0)

    def late(env):
        return env.fleet.sim_time > 50.0

    found = risk(env, "random", event=late, level=lambda env: env.fleet.sim_time, episodes=20, repetitions=4)
    assert (found.event, found.probability.mean) == ("late", 1.0)
    assert f"{env.names[0]}: sigma_init[0]" in found.columns


def test_faults_are_followed_too():
    env = bsk_torch.make("FaultyScan-v1", num_envs=20, env_ids=[0] * 20, time_limit=600.0, kinds=["battery"], chance=0.5)
    found = risk(env, "rule", event="battery_charge_fraction<0.31", episodes=40, repetitions=4)
    assert found.probability.mean > 0.0
    assert found.sample.flown[DRAWN][:, found.columns.index("battery.at")].isfinite().any()
