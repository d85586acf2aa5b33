"""Metrics of finished episodes, in every view, against the rewards of the steps."""

import gymnasium
import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import data, make
from bsk_torch.wrappers import GymVectorEnv
from bsk_torch.wrappers.general import GymJointEnv
from bsk_torch.wrappers.gymnasium import GymEnv
from bsk_torch.wrappers.metrics import EpisodeDataParallelWrapper, EpisodeDataWrapper, EpisodeMetrics
from bsk_torch.wrappers.pettingzoo import PettingZooEnv

from .constellations import EMPTY, FULL, trio

SMALL = dict(time_limit=360.0)

pytestmark = pytest.mark.compiled


def total(env):
    return {"reward": sum(env.rewarder.cum_reward.values())}


def charge(env, satellite):
    return {"charge": satellite.dynamics.battery_charge_fraction}


class Log:
    def __init__(self):
        self.values = {}

    def log_value(self, name, value, **_):
        self.values.setdefault(name, []).append(value)


def test_rewards_are_summed_for_each_satellite_and_part_without_penalties():
    parts = data.ComposedReward(
        data.ScanningTimeReward(), data.ResourceReward(resource_fn=lambda sat: sat.dynamics.battery_charge_fraction)
    )
    env = trio(charges=(FULL, EMPTY, FULL), rewarder=parts, seed=0)
    now, paid = env.reset(), torch.zeros(1, 3, dtype=torch.float64)
    for _ in range(3):
        now["agents", "action"] = torch.zeros(1, 3, dtype=torch.int64)
        now = env.step(now)["next"]
        paid += now["agents", "reward"].squeeze(-1) + 1.0 * (env.dead & (now["agents", "reward"].squeeze(-1) < -0.5))
    assert list(env.rewarder.cum_reward) == env.names
    got = torch.stack(list(env.rewarder.cum_reward.values()), 1)
    torch.testing.assert_close(got[:, [0, 2]], paid[:, [0, 2]])
    first, second = (torch.stack(list(part.cum_reward.values()), 1) for part in env.rewarder.rewarders)
    torch.testing.assert_close(first + second, got)
    saved = env.get_state()
    env.reset()
    assert not any(value.any() for value in env.rewarder.cum_reward.values())
    env.restore(saved)
    torch.testing.assert_close(torch.stack(list(env.rewarder.cum_reward.values()), 1), got)


def test_the_last_info_of_an_episode_has_metrics():
    env, log = EpisodeDataWrapper(GymEnv("NadirScan-v1", **SMALL), total, charge), Log()
    env.set_metrics_logger(log)
    env.reset(seed=0)
    rewards = []
    while True:
        _, reward, terminated, truncated, info = env.step(0)
        rewards.append(reward)
        if terminated or truncated:
            break
        assert "metrics" not in info
    assert set(info["metrics"]) == {"reward", "Scanner1/charge", "mean/charge"}
    assert info["metrics"]["reward"] == pytest.approx(sum(rewards), abs=1e-7)
    assert log.values == {name: [value] for name, value in info["metrics"].items()}


@pytest.mark.parametrize("joint", [True, False])
def test_constellations_have_metrics_of_satellites_and_their_means(joint):
    core = trio(joint=joint, seed=0)
    env = (EpisodeDataWrapper if joint else EpisodeDataParallelWrapper)(
        (GymJointEnv if joint else PettingZooEnv)(core), None, charge
    )
    env.reset()
    while True:
        *_, ends, cuts, infos = env.step((1, 1, 1) if joint else dict.fromkeys(env.agents, 1))
        if joint and (ends or cuts):
            found = infos["metrics"]
            break
        if not joint and not env.agents:
            found = infos["S0"]["metrics"]
            break
    assert found["mean/charge"] == pytest.approx(np.mean([found[f"S{k}/charge"] for k in range(3)]))


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_a_vector_has_metrics_of_the_episodes_that_end(mode):
    envs = GymVectorEnv("NadirScan-v1", 3, autoreset_mode=mode, metrics=total, **SMALL)
    envs.reset(seed=0)
    paid, found = np.zeros(3), None
    actions = np.array([0, 1, 0])
    for _ in range(3):
        _, reward, terminated, truncated, info = envs.step(actions)
        paid += reward
        if (terminated | truncated).any():
            found, ended = info["metrics"], terminated | truncated
            assert (info["_metrics"] == ended).all()
            np.testing.assert_allclose(found["reward"], np.where(ended, paid, 0.0), atol=1e-7)
            break
        assert "metrics" not in info
    assert found is not None


def test_stable_baselines3_gets_and_logs_them():
    pytest.importorskip("stable_baselines3")
    from bsk_torch.wrappers.stable_baselines3 import MetricsCallback, SB3VecEnv

    env = SB3VecEnv("NadirScan-v1", 2, metrics=total, time_limit=180.0)
    env.reset()
    _, rewards, dones, infos = env.step(np.array([0, 0]))
    assert dones.all()
    assert [info["metrics"]["reward"] for info in infos] == pytest.approx(rewards.tolist(), abs=1e-6)
    callback, recorded = MetricsCallback(), []
    callback.model = type(
        "Model", (), {"logger": type("Logger", (), {"record_mean": lambda self, *pair: recorded.append(pair)})()}
    )
    callback.locals = {"infos": infos}
    assert callback._on_step()
    assert recorded == [("episode/reward", info["metrics"]["reward"]) for info in infos]


def test_torchrl_finds_them_beside_done():
    env = make("NadirScan-v1", num_envs=2, seed=0, **SMALL)
    env.reset()
    transformed = env.append_transform(EpisodeMetrics(total))
    steps = transformed.rollout(2)
    assert transformed.observation_spec["metrics", "reward"].shape == (2, 1)
    torch.testing.assert_close(steps["next", "metrics", "reward"].float(), steps["next", "reward"].cumsum(1))


@pytest.mark.parametrize("name", ["SatelliteTasking", "GeneralSatelliteTasking", "ConstellationTasking"])
def test_rllib_makes_environments_with_a_dictionary(name):
    from bsk_torch.wrappers.rllib import unpack_config

    from .test_registration import Imager, problem

    satellites = {"satellite": Imager("A")} if name == "SatelliteTasking" else {"satellites": [Imager("A"), Imager("B")]}
    kind = unpack_config(getattr(bsk_torch, name))
    assert kind.__name__ == f"{name}_Unpacked"
    env = kind(problem(**satellites))
    env.reset(seed=0)
    assert isinstance(env, PettingZooEnv if name == "ConstellationTasking" else gymnasium.Env)


def test_env_config_may_have_callbacks_and_stays_as_it_is():
    from bsk_torch.wrappers.rllib import satellite_tasking

    from .test_registration import Imager, problem

    config = problem(satellite=Imager("A"), episode_data_callback=total)
    env = satellite_tasking(config)
    assert env.episode_data_callback is total
    assert config["episode_data_callback"] is total
