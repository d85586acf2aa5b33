"""The learning recipe: semi-Markov advantages, the rule, and a run from end to end."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.modules import ValueOperator

import bsk_torch
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.marl.runs import configure
from bsk_torch.rl.networks.normaliser import OWN
from bsk_torch.rl.policies.files import policy_of_file
from bsk_torch.rl.rules.baselines import ScanRule, random_policy
from bsk_torch.rl.training import train
from bsk_torch.rl.training.advantages import write_advantages
from bsk_torch.rl.training.config import PPOConfig

FLOAT32_SUMS = dict(atol=5e-5, rtol=1e-5)
"""A dozen numbers of order one, each good to 1e-7 of the largest, multiplied and added up in float32 in another order."""

SHORT = {"backend": "eager", "time_limit": 400.0}


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=3, seed=0, **SHORT)


def brute_force(reward, seconds, done, value, next_value, gamma, lmbda, reward_time):
    """Advantages [T] by the definition, cut at the end of an episode.

    With g = gamma^t, A = g (r + V') - V + g lambda A' where rewards come at the end, else A = r + g V' - V + g lambda A'.
    """
    advantage, following = [], 0.0
    for r, t, d, v, w in reversed(list(zip(reward, seconds, done, value, next_value, strict=True))):
        discount = gamma**t
        earned = discount * r if reward_time == "end" else r
        following = earned + discount * w * (not d) - v + discount * lmbda * following * (not d)
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


@pytest.mark.parametrize("reward_time", ["end", "start"])
def test_advantages_discount_by_elapsed_time(reward_time):
    batch, gamma, lmbda = batch_of_decisions(3, 12), 0.999, 0.9
    critic = ValueOperator(torch.nn.Linear(2, 1), in_keys=[OWN])
    reward = batch["next", "reward"].clone()
    write_advantages(batch, critic, gamma, lmbda, reward_time)
    with torch.no_grad():
        value, following = (critic.module(x[OWN]).squeeze(-1) for x in (batch, batch["next"]))
    for i in range(3):
        row = [batch["next", key][i, :, 0].double().tolist() for key in ("reward", "duration", "done")]
        expected = brute_force(*row, value[i].tolist(), following[i].tolist(), gamma, lmbda, reward_time)
        torch.testing.assert_close(batch["advantage"][i, :, 0], expected.float(), **FLOAT32_SUMS)
        torch.testing.assert_close(batch["value_target"][i, :, 0], (expected + value[i]).float(), **FLOAT32_SUMS)
    assert torch.equal(batch["next", "reward"], reward)


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


def test_random_policy_obeys_the_mask_and_its_seed(env):
    mask = torch.tensor([[True, False, True, False]]).expand(200, 4)
    first, again = (random_policy(env, 3)(TensorDict({"action_mask": mask}, [200]))["action"] for _ in range(2))
    assert torch.equal(first, again)
    assert set(first.tolist()) == {0, 2}


def test_recipes_can_be_changed():
    config = configure("AEOS-v1", "attention", seconds=5.0, num_envs=7, options={"n_targets": 10})
    assert (config.num_envs, config.seconds, config.gamma) == (7, 5.0, 0.997)
    assert config.options == {"as_set": True, "n_targets": 10}
    assert configure("NadirScan-v1").hidden == PPOConfig().hidden
    config = configure("MultiInspection-v1", frames=10, options={"n_inspectors": 2})
    assert (config.num_envs, config.gamma, config.frames) == (128, 0.99999, 10)
    assert config.options == {"actions": "waypoints", "n_inspectors": 2}
    assert configure("RSOInspection-v1", options={"actions": "thrust"}).options == {"actions": "thrust"}
    assert configure("RSOInspection-v1").options == {"actions": "waypoints"}  # the recipe itself stays as it is
    assert configure("Constellation-v1").options == {"as_set": True}
    relayed = configure("RelayConstellation-v1")
    assert (relayed.imitate, relayed.gamma, relayed.options) == ("nearest", 0.999, {"as_set": True})


@pytest.mark.compiled
@pytest.mark.parametrize("network", ["mlp", "attention"])
@pytest.mark.nightly("attention")
def test_a_short_training_beats_random_choice_of_targets(tmp_path, network):
    world = {"n_targets": 3000, "time_limit": 1500.0}
    config = configure(
        "AEOS-v1", network, options=world, frames=8192, seconds=None, num_envs=16, rollout=32, minibatch=128, epochs=2
    )  # fmt: skip
    train(config, tmp_path, episodes=0)
    env = bsk_torch.make("AEOS-v1", num_envs=64, seed=0, **config.options)
    trained = evaluate(policy_of_file(tmp_path / "policy.pt"), env, seed=7)
    random = evaluate(random_policy(env, 0), env, seed=7)
    gain = trained.gain_over(random)
    assert gain.mean > 3.0 * gain.half_width
