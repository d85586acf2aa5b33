"""fly_on_basilisk.py: what episodes start from, who flies, how both sides are compared, and flights on Basilisk."""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict

sys.path.insert(0, str(Path(__file__).parents[3] / "scripts" / "validation"))
import fly_on_basilisk
from flight_comparison import Pair, findings, kept, rarest, table
from flight_policy import Flyer, planner_pilot, random_action, recruit
from fly_on_basilisk import arguments
from rich.console import Console

from bsk_torch import make, rand
from bsk_torch.lab.basilisk.certificate import as_sets
from bsk_torch.lab.basilisk.flight import FLOWN, Flight, absent_data, fly_here, problem_of, replay_pilot
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.wrappers.gymnasium import GymEnv
from tests.support.refusals import check_refusals, refusal

SEEDS = range(2, 5)
EAGER: dict[str, Any] = {"backend": "eager", "time_limit": 400.0}


@pytest.fixture(scope="module")
def mortal() -> Flyer:
    """The rule in an environment in which some die of an empty battery."""
    return Flyer("rule", "NadirScan-v1", {"time_limit": 400.0, "sat_args": {"storedCharge_Init": rand.Uniform(1e2, 1.6e4)}})


@pytest.fixture(scope="module")
def flown(mortal) -> Any:
    env = mortal.environment(len(SEEDS))
    return env, *fly_here(env, mortal.pilot(problem_of(env, mortal.preset).observed), SEEDS)


@pytest.mark.compiled
def test_arguments_of_a_start_make_the_same_episode_whatever_the_seed(flown):
    _, starts, flights = flown
    given = {"sat_args": starts[-1].sat_args, "world_args": starts[-1].world_args}
    again = make("NadirScan-v1", seed=99, dtype=torch.float64, **EAGER, **given)
    # positions are computed from elements there and given here, both in float64; angles and times follow from them
    np.testing.assert_allclose(again.reset()["observation"][0], flights[-1].observations[0], rtol=0, atol=1e-9)


@pytest.mark.compiled
def test_a_start_leaves_nothing_to_draw_and_is_plain(flown):
    env, starts, _ = flown
    assert env.simulator.type.arguments.sat_args.random - {"oe"} <= starts[0].sat_args.keys()
    assert starts[0].sat_args["oe"] is None
    assert json.loads(json.dumps(dataclasses.asdict(starts[0])))["world_args"] == starts[0].world_args
    assert len({start.world_args["utc_init"] for start in starts}) == len(SEEDS)


@pytest.mark.compiled
def test_a_start_of_areas_has_their_cells_in_their_order():
    env = Flyer("random", "Areas-v1", {"n_areas": 7, "revisit": 900.0}).environment(2, time_limit=60.0)
    starts, _ = fly_here(env, random_action, range(2))
    assert problem_of(env, "Areas-v1").scenario == {"swath": 300e3, "revisit": 900.0}
    for row, start in enumerate(starts):
        cells, share, weight = (torch.as_tensor(part) for part in start.areas)
        index = env.scenario.index[row]
        torch.testing.assert_close(cells, env.scenario.r_CP_P[index], rtol=0, atol=0)
        torch.testing.assert_close(share.sum(1), torch.ones(7, dtype=torch.float64))
        torch.testing.assert_close(weight, env.scenario.weight[row], rtol=0, atol=0)


@pytest.mark.compiled
def test_a_start_of_targets_has_them_in_their_order():
    env = Flyer("random", "AEOS-v1", {}).environment(2, n_targets=(4, 9), time_limit=30.0)
    starts, _ = fly_here(env, random_action, range(2))
    assert len(starts) == 2
    for row, start in enumerate(starts):
        there = env.scenario.available[row]
        torch.testing.assert_close(torch.as_tensor(start.targets[0]), env.scenario.r_LP_P[row, there], rtol=0, atol=0)
        torch.testing.assert_close(torch.as_tensor(start.targets[1]), env.scenario.priority[row, there], rtol=0, atol=0)


def test_epochs_of_a_users_function_are_refused():
    env = Flyer("rule", "NadirScan-v1", {}).environment(
        1, world_args={"utc_init": lambda: "2020 MAR 01 00:00:00.000 (UTC)"}, **EAGER
    )
    check_refusals(refusal(lambda: fly_here(env, random_action, [0]), ValueError, "utc_init"))


@pytest.mark.compiled
def test_a_flight_is_the_episode_of_gymnasium_with_that_seed(mortal, flown):
    _, _, flights = flown
    assert {flight.survived for flight in flights} == {True, False}
    single = GymEnv("NadirScan-v1", dtype=torch.float64, **mortal.options)
    for flight in flights:
        observation, _ = single.reset(seed=flight.seed)
        for k, action in enumerate(flight.actions):
            np.testing.assert_array_equal(observation, flight.observations[k])
            observation, reward, terminated, _, _ = single.step(action)
            assert reward == flight.rewards[k]
        assert terminated
        assert flight.survived == (not single.core.dead.item())
        assert flight.seconds == pytest.approx(single.core.simulator.sim_time.item(), abs=1e-9)
        assert flight.fill == flight.observations[-1][0]
        assert flight.collected == pytest.approx(flight.returns + (not flight.survived), abs=1e-12)
        assert flight.deaths == (() if flight.survived else ("battery_valid",))


def test_random_actions_are_legal_and_belong_to_the_episode():
    mask = torch.tensor([[True, False, True, True]] * 200)
    seen = TensorDict({"action_mask": mask}, [200])
    actions, logits = random_action(seen, range(200), 5)
    assert (set(actions.tolist()), logits.shape) == ({0, 2, 3}, (200, 0))
    alone, _ = random_action(seen[7:8], [7], 5)
    assert alone[0] == actions[7]
    assert not torch.equal(actions, random_action(seen, range(200), 6)[0])


@pytest.mark.compiled
def test_sets_are_made_of_vectors_as_the_preset_makes_them():
    options = {"time_limit": 400.0, "num_envs": 2, "seed": 5, "n_targets": (3, 60)}
    vector, sets = (make("AEOSPower-v1", as_set=as_set, **options) for as_set in (False, True))
    wanted = sets.reset()["observation"]
    made = as_sets(vector.reset()["observation"], vector.satellite.observation_description)
    assert set(made.keys(True, True)) == set(wanted.keys(True, True))
    for key in wanted.keys(True, True):
        torch.testing.assert_close(made[key], wanted[key], rtol=0, atol=0)


def flight(actions: list[int], rewards: list[float], shift: float = 0.0, deaths: tuple[str, ...] = ()) -> Flight:
    k = len(actions)
    observations = np.outer(np.arange(k + 1.0), [1.0, -2.0]) + shift
    logits = np.array([[0.0, 0.1 + 10 * shift * (1 if action else -1)] for action in actions])
    return Flight(4, np.array(actions), observations, logits, np.array(rewards), 60.0 * k, -1.0 if deaths else 0.0, deaths, 0.5)


EQUAL = Pair(flight([0, 1, 1], [0.1, 0.2, 0.3]), flight([0, 1, 1], [0.1, 0.2, 0.3 + 1e-9], 1e-8))
APART = Pair(flight([0, 1, 1], [0.1, 0.2, 0.3]), flight([0, 0, 1], [0.1, 0.0, -0.5], 1e-3, ("battery_valid",)))
SHORTER = Pair(flight([0, 1, 1], [0.1, 0.2, 0.3]), flight([0, 1], [0.1, -0.8], 0.0, ("rw_speeds_valid",)))
WRONG = Pair(flight([0, 1], [0.1, 0.2]), flight([0, 1], [0.1, 0.2 + 1e-5]))


def test_pairs_agree_up_to_the_first_decision_that_differs():
    assert EQUAL.same
    assert EQUAL.divergence is None
    assert EQUAL.return_difference == pytest.approx(-1e-9)
    np.testing.assert_allclose(EQUAL.observation_differences, 1e-8, rtol=1e-6)
    assert not APART.same
    assert (APART.divergence.step, APART.divergence.actions) == (1, (1, 0))
    assert APART.divergence.margins == pytest.approx((0.1, -0.09))  # Basilisk's pilot did what its logits do not prefer
    assert APART.divergence.logits == pytest.approx(0.01)
    assert not SHORTER.same
    assert (SHORTER.divergence.step, SHORTER.divergence.actions) == (2, (1, -1))
    assert np.isnan(SHORTER.divergence.logits)
    assert (1 - rarest(100)) ** 100 == pytest.approx(0.05)


def test_findings_say_what_is_equal_and_what_is_not():
    text = "\n".join(findings([EQUAL, APART, SHORTER], ["first", "second"], ["charge", "scan"]))
    assert "episodes with the same actions: 1 of 3 (6 of 9 decisions" in text
    assert "1e-09 (as asked" in text
    assert "only one side survived: 2 of 3" in text
    assert "decision 1 is scan and charge, observations differ by 0.001, logits by 0.01, preferred by 0.1 and -0.09" in text
    assert "decision 2 is scan and the end" in text
    assert "TOO MUCH" in "\n".join(findings([EQUAL, WRONG], ["first", "second"], []))
    assert f"at most {rarest(2):.1%}" in "\n".join(findings([EQUAL, WRONG], ["first", "second"], []))


def test_differences_are_held_against_basilisk_itself():
    nudged = dataclasses.replace(APART, nudged=SHORTER.there)
    assert nudged.itself.divergence.actions == (1, 0)
    assert (
        "Basilisk against itself, 1e-12 away: decision 1 is scan and charge"
        in findings([nudged], ["a", "b"], ["charge", "scan"])[-1]
    )
    seen = Pair(flight([0, 1], [0.1, 0.2]), flight([0, 1], [0.1, 0.2], 2e-6))
    assert seen.same
    assert seen.doubtful
    assert not EQUAL.doubtful


@pytest.mark.compiled
def test_a_nudged_start_differs_in_its_attitude_only(flown):
    start = flown[1][0]
    nudged = start.nudged()
    difference = np.subtract(nudged.sat_args["sigma_init"], start.sat_args["sigma_init"])
    np.testing.assert_allclose(difference, [1e-12, 0, 0], rtol=0, atol=1e-15)
    same = {name: value for name, value in nudged.sat_args.items() if name != "sigma_init"}
    assert dataclasses.replace(nudged, sat_args={}) == dataclasses.replace(start, sat_args={})
    assert same == {name: value for name, value in start.sat_args.items() if name != "sigma_init"}


def test_kept_findings_are_read_back_as_they_are_shown():
    pairs = [EQUAL, APART, SHORTER]
    read = json.loads(json.dumps(kept(pairs), allow_nan=True))
    differences = torch.tensor([pair.return_difference for pair in pairs], dtype=torch.float64)
    assert read["summary"]["difference"]["return"] == pytest.approx(
        [confidence(differences).mean, confidence(differences).half_width]
    )
    assert read["summary"]["basilisk"]["deaths"] == {"battery": 1, "rw_speeds": 1}
    assert (read["summary"]["same_actions"], read["episodes"]["same_actions"]) == (1, [True, False, False])
    assert read["doubtful"].keys() == {"4"}
    console = Console(record=True, width=120)
    console.print(table(pairs, "title"))
    shown = console.export_text()
    assert f"{differences.mean():.2g} ±" in shown
    assert "1 battery, 1 rw_speeds" in shown


@pytest.mark.compiled
def test_a_planner_decides_here_and_its_actions_are_flown_there():
    """By copies of the state, which Basilisk does not give."""
    flyer = recruit("plan:rollout", "NadirScan-v1", ("base=rule", "horizon=300", "budget=2"))
    flyer.check()
    env = flyer.environment(2, time_limit=900.0)
    starts, here = fly_here(env, planner_pilot(flyer, env), range(3, 5))
    assert [start.seed for start in starts] == [3, 4]
    pilot = replay_pilot({flight.seed: flight.actions for flight in here})
    for flight in here:
        flown = [int(pilot(TensorDict({}, [1]), [flight.seed], step)[0]) for step in range(flight.decisions + 2)]
        assert flown == [*flight.actions.tolist(), *[flight.actions[-1]] * 2]
    check_refusals(refusal(lambda: recruit("rule", None, ["horizon=3"]), ValueError, "horizon=3"))


@pytest.mark.parametrize("seeds", ["5", "5:5", "7:3", "a:b", "-1:3", ":4"])
def test_seeds_must_be_a_range(seeds, capsys):
    with pytest.raises(SystemExit):
        arguments(["rule", "--seeds", seeds] if seeds[0] != "-" else ["rule", f"--seeds={seeds}"])
    assert "A:B with 0 <= A < B" in capsys.readouterr().err


def test_rejects_wrong_names_with_the_nearest(capsys, tmp_path):
    check_refusals(refusal(lambda: arguments(["rule", "--preset", "NadirScan"]), SystemExit))
    assert "did you mean 'NadirScan-v1'" in capsys.readouterr().err
    check_refusals(refusal(lambda: arguments(["rule", "--out", str(tmp_path / "nowhere" / "flight.json")]), SystemExit))
    assert "there is no folder" in capsys.readouterr().err
    check_refusals(
        refusal(lambda: recruit("rul", None), ValueError, "'rule'"),
        refusal(lambda: Flyer("rule", "Constellation-v1", {}).check(), ValueError, "NadirScan-v1, AEOS-v1"),
        refusal(lambda: Flyer("rule", "AEOS-v1", {}).check(), (ValueError, KeyError), "storage_level_fraction"),
    )


def test_rejects_missing_packages_and_data(monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "bsk_rl" else object())
    check_refusals(refusal(lambda: fly_on_basilisk.main(["rule", "--seeds", "0:1"]), SystemExit, "bsk_rl"))
    (tmp_path / "supportData" / "LocalGravData").mkdir(parents=True)
    (tmp_path / "supportData" / "LocalGravData" / "GGM03S.txt").touch()
    text = absent_data(str(tmp_path))
    assert "supportData/EphemerisData/de430.bsp" in text
    assert "GGM03S" not in text
    assert "BSK_SUPPORT_DATA_CACHE is not set" in absent_data(None)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("name", "policy", "preset", "options", "survived"),
    [
        ("flight_rule", "rule", "NadirScan-v1", {}, [True, False, True]),
        ("flight_areas", "pretrained", "Areas-v1", {"time_limit": 5700.0}, [True, True]),
    ],
)
def test_policies_fly_as_they_have_flown_on_basilisk(name, policy, preset, options, survived):
    """Every action follows from what that simulator shows; one episode ends with an empty battery."""
    with np.load(Path(__file__).parents[2] / "basilisk" / "recordings" / f"{name}.npz") as file:
        there = dict(file)
    flyer = recruit(policy, preset)
    env = flyer.environment(len(survived), **options)
    _, flights = fly_here(env, flyer.pilot(problem_of(env, flyer.preset).observed), there["seed"].tolist())
    assert [len(flight.actions) for flight in flights] == there["decisions"].tolist()
    assert [flight.survived for flight in flights] == there["survived"].tolist() == survived
    actions, rewards, observations = (
        np.concatenate([getattr(flight, name) for flight in flights]) for name in ("actions", "rewards", "observations")
    )
    np.testing.assert_array_equal(actions, there["actions"])
    np.testing.assert_allclose(rewards, there["rewards"], rtol=0, atol=1e-9)  # the bounds of the parity tests
    np.testing.assert_allclose(observations, there["observations"], rtol=0, atol=1e-6)


@pytest.mark.basilisk
@pytest.mark.parametrize(
    ("preset", "policy", "options"),
    [
        ("NadirScan-v1", "rule", {}),
        ("AEOSPower-v1", "nearest", {"n_targets": 300, "time_limit": 200.0}),
        ("Areas-v1", "areas", {"revisit": 300.0, "time_limit": 1800.0}),
    ],
)
def test_a_policy_flies_on_basilisk_as_in_bsk_torch(preset, policy, options):
    from bsk_torch.lab.basilisk.reference_env import BUILDERS, fly_there

    assert tuple(BUILDERS) == FLOWN
    flyer = Flyer(policy, preset, EAGER | options)
    env = flyer.environment(1)
    problem = problem_of(env, preset)
    starts, here = fly_here(env, flyer.pilot(problem.observed), [11])
    pair = Pair(here[0], fly_there(problem, starts[0], flyer.pilot(problem.observed)))
    assert pair.same
    assert abs(pair.return_difference) < 1e-9
    assert (pair.here.seconds, pair.here.deaths) == (pair.there.seconds, pair.there.deaths)
    assert pair.observation_differences.max() < 1e-6  # the bound of the parity tests
