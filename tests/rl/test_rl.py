"""The learning recipe: statistics, semi-Markov advantages, the rule, and a run from end to end."""

import json

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ValueOperator

import bsk_torch
from bsk_torch import scene
from bsk_torch.rl.baselines import BASELINES, Columns, ScanRule, random_policy
from bsk_torch.rl.evaluate import Estimate, Evaluation, confidence, evaluate, student_quantile
from bsk_torch.rl.log import COLUMNS, read_log
from bsk_torch.rl.policies import load_policy
from bsk_torch.rl.ppo import PPOConfig, estimate_advantages
from bsk_torch.rl.recipes import configure
from bsk_torch.rl.sight import OWN
from bsk_torch.rl.training import Training, train

FLOAT32_SUMS = dict(atol=5e-5, rtol=1e-5)
"""A dozen numbers of order one, each good to 1e-7 of the largest, multiplied and added up in float32 in another order."""

SHORT = {"backend": "eager", "time_limit": 400.0}


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=3, seed=0, **SHORT)


# -- statistics -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("freedom", "expected"), [(9, 2.26216), (20, 2.08596), (255, 1.96931)])
def test_student_quantile_agrees_with_tables(freedom, expected):
    assert student_quantile(0.975, freedom) == pytest.approx(expected, abs=1e-3)


def test_confidence_interval_of_a_worked_example():
    # 1 ... 10: mean 5.5, standard deviation 3.02765, t(0.975, 9) = 2.26216
    estimate = confidence(torch.arange(1.0, 11.0))
    assert estimate.mean == 5.5
    assert estimate.half_width == pytest.approx(2.26216 * 3.02765 / 10**0.5, abs=1e-3)


def test_one_sample_has_no_finite_interval():
    assert confidence(torch.ones(1)).half_width == float("inf")


def test_intervals_overlap_when_they_touch():
    assert Estimate(1.0, 0.25).overlaps(Estimate(1.5, 0.25))
    assert not Estimate(1.0, 0.25).overlaps(Estimate(1.75, 0.25))


# -- semi-Markov advantages -------------------------------------------------------------------------------------------


def brute_force(reward, seconds, done, value, next_value, gamma, lmbda):
    """Advantages [T] by the definition: with g = gamma^t, A = g (r + V') - V + g lambda A', cut at the end of an episode."""
    advantage, following = [], 0.0
    for r, t, d, v, w in reversed(list(zip(reward, seconds, done, value, next_value, strict=True))):
        discount = gamma**t
        following = discount * (r + w * (not d)) - v + discount * lmbda * following * (not d)
        advantage.append(following)
    return torch.tensor(advantage[::-1])


def batch_of_decisions(n, steps):
    """Random decisions; what follows one is what the next one sees, except at the end of an episode."""
    torch.manual_seed(0)
    done = torch.rand(n, steps, 1) < 0.2
    seen = torch.randn(n, steps + 1, 2)
    following = {
        "seen": {"own": torch.where(done, torch.randn(n, steps, 2), seen[:, 1:])},
        "reward": torch.randn(n, steps, 1),
        "duration": torch.randint(60, 181, (n, steps, 1)).float(),
        "done": done,
        "terminated": done.clone(),
        "truncated": done.clone(),
    }
    now = {"seen": {"own": seen[:, :-1].clone()}, "next": TensorDict(following, [n, steps])}
    return TensorDict(now, [n, steps], names=[None, "time"])


def test_advantages_discount_reward_and_value_by_elapsed_time():
    batch, gamma, lmbda = batch_of_decisions(3, 12), 0.999, 0.9
    critic = ValueOperator(torch.nn.Linear(2, 1), in_keys=[OWN])
    reward = batch["next", "reward"].clone()
    estimate_advantages(batch, critic, gamma, lmbda)
    with torch.no_grad():
        value, following = (critic.module(x[OWN]).squeeze(-1) for x in (batch, batch["next"]))
    for i in range(3):
        row = [batch["next", key][i, :, 0].double().tolist() for key in ("reward", "duration", "done")]
        expected = brute_force(*row, value[i].tolist(), following[i].tolist(), gamma, lmbda)
        torch.testing.assert_close(batch["advantage"][i, :, 0], expected.float(), **FLOAT32_SUMS)
        torch.testing.assert_close(batch["value_target"][i, :, 0], (expected + value[i]).float(), **FLOAT32_SUMS)
    assert torch.equal(batch["next", "reward"], reward)


# -- baselines --------------------------------------------------------------------------------------------------------

NOTHING_URGENT = {
    "storage_level_fraction": 0.3,
    "battery_charge_fraction": 0.9,
    "wheel_speeds_fraction[0]": 0.1,
    "wheel_speeds_fraction[1]": -0.2,
    "wheel_speeds_fraction[2]": 0.0,
    "solar_pointing_error_normd": 0.5,
    "ground_station_0.opportunity_open_normd": 0.2,
    "ground_station_0.opportunity_close_normd": 0.3,
    "eclipse[0]": 0.3,
    "eclipse[1]": 0.6,
}
ACTIONS = ["action_nadir_scan", "action_charge", "action_downlink", "action_desat"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, "action_nadir_scan"),
        ({"battery_charge_fraction": 0.1}, "action_charge"),
        ({"storage_level_fraction": 0.99}, "action_charge"),
        ({"ground_station_0.opportunity_open_normd": -0.01, "storage_level_fraction": 0.8}, "action_downlink"),
        ({"ground_station_0.opportunity_open_normd": -0.01, "storage_level_fraction": 0.0}, "action_nadir_scan"),
        ({"wheel_speeds_fraction[1]": -0.95}, "action_desat"),
    ],
)
def test_rule_takes_the_obvious_action(change, expected):
    seen = NOTHING_URGENT | change
    action = ScanRule().decide(torch.tensor([list(seen.values())]), list(seen), ACTIONS)
    assert ACTIONS[int(action)] == expected


def test_rule_names_what_it_misses():
    with pytest.raises(KeyError, match=r"time.*not observed"):
        Columns(torch.zeros(1, 1), ["storage_level_fraction"])["time"]


def test_random_policy_obeys_the_mask_and_its_seed(env):
    mask = torch.tensor([[True, False, True, False]]).expand(200, 4)
    first, again = (random_policy(env, 3)(TensorDict({"action_mask": mask}, [200]))["action"] for _ in range(2))
    assert torch.equal(first, again)
    assert set(first.tolist()) == {0, 2}


# -- from end to end --------------------------------------------------------------------------------------------------


def test_evaluation_counts_one_episode_per_row(env):
    first, again = (evaluate(BASELINES["rule"](env, 0), env, seed=5) for _ in range(2))
    assert first.returns.shape == (3,)
    assert torch.equal(first.returns, again.returns)
    assert torch.equal(first.seconds, torch.full((3,), 400.0))
    assert first.survival == 1.0
    assert first.causes == {}


def test_evaluation_names_the_cause_of_death():
    env = bsk_torch.make("NadirScan-v1", num_envs=2, seed=0, sat_args={"storedCharge_Init": 1000.0}, **SHORT)
    result = evaluate(random_policy(env, 0), env, seed=0)
    assert result.causes == {"battery_valid": 2}
    assert result.survival == 0.0
    assert bool((result.returns < -0.9).all())
    torch.testing.assert_close(result.collected, result.returns + 1.0)


def test_training_leaves_a_log_and_a_policy_that_acts_the_same(tmp_path):
    config = PPOConfig(frames=48, seconds=None, num_envs=4, rollout=6, minibatch=12, epochs=2, hidden=(8,), options=SHORT)
    policy = train(config, tmp_path)
    log = read_log(tmp_path / "log.csv")
    assert tuple(log) == COLUMNS
    assert log["frames"] == [24.0, 48.0]
    assert log["episodes"][-1] >= 4
    assert json.loads((tmp_path / "config.json").read_text())["num_envs"] == 4
    seen = TensorDict({"observation": torch.rand(50, 12), "action_mask": torch.ones(50, 4, dtype=torch.bool)}, [50])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        kept = load_policy(tmp_path / "policy.pt")(seen.clone())
        assert torch.equal(policy(seen.clone())["action"], kept["action"])


# -- configuration ----------------------------------------------------------------------------------------------------


def test_recipes_can_be_changed():
    config = configure("AEOS-v1", "attention", seconds=5.0, num_envs=7, options={"n_targets": 10})
    assert (config.num_envs, config.seconds, config.gamma) == (7, 5.0, 0.997)
    assert config.options == {"as_set": True, "n_targets": 10}
    assert configure("NadirScan-v1").hidden == PPOConfig().hidden


def test_options_that_json_does_not_know_are_noted(tmp_path):
    fires = {"scenario": scene.Wildfires(50), "backend": "eager"}
    training = Training(configure("AEOS-v1", "attention", seconds=5.0, num_envs=2, options=fires), tmp_path)
    assert "Wildfires" in json.loads((tmp_path / "config.json").read_text())["options"]["scenario"]
    assert training.policy(training.env.reset())["action"].shape == (2,)


def test_unknown_networks_are_answered_with_the_nearest():
    with pytest.raises(ValueError, match=r"did you mean 'attention'"):
        PPOConfig(network="atention")


@pytest.mark.parametrize("limits", [{"seconds": None}, {"seconds": 0.0}, {"frames": -1}])
def test_training_needs_a_limit(limits):
    with pytest.raises(ValueError, match="needs a limit"):
        PPOConfig(**limits)


@pytest.mark.compiled
@pytest.mark.parametrize("network", ["mlp", "attention"])
def test_a_short_training_beats_random_choice_of_targets(tmp_path, network):
    world = {"n_targets": 3000, "time_limit": 1500.0}
    config = configure(
        "AEOS-v1", network, options=world, frames=8192, seconds=None, num_envs=16, rollout=32, minibatch=128, epochs=2
    )  # fmt: skip
    train(config, tmp_path)
    env = bsk_torch.make("AEOS-v1", num_envs=64, seed=0, **config.options)
    trained = evaluate(load_policy(tmp_path / "policy.pt"), env, seed=7)
    random = evaluate(random_policy(env, 0), env, seed=7)
    gain = trained.gain_over(random)
    assert gain.mean > 3.0 * gain.half_width


def test_gain_is_paired():
    # every episode one better than the other: the difference is certain, though the returns are not
    parts = dict(survived=torch.ones(50), decisions=torch.ones(50), seconds=torch.ones(50), deaths={})
    returns = torch.randn(50)
    better, worse = (Evaluation(returns=x, collected=x, **parts) for x in (returns + 1.0, returns))
    assert better.gain_over(worse).mean == pytest.approx(1.0, abs=1e-6)
    assert better.gain_over(worse).half_width < 1e-6
    assert better.mean_return.half_width > 0.1
