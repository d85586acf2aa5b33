"""Rewards for resources: weights that every episode draws, resources as functions."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from bsk_torch import SatelliteTasking, act, data, obs, rand, sats


def elapsed(sat):
    return sat.simulator.sim_time


def squared(sat):
    return (sat.dynamics.r_BN_N**2).sum(-1)


class Drifter(sats.Satellite):
    observation_spec = (obs.ResourceRewardWeight(), obs.Noisy(obs.ResourceRewardWeight("half", norm=[2.0, 1.0]), 0.0))
    action_spec = (act.Drift(duration=60.0),)


def make(num_envs=3, rewarder=None, spec=None, **options):
    satellite = Drifter("A") if spec is None else type("Own", (Drifter,), {"observation_spec": spec})("A")
    rewarder = rewarder or (
        data.ResourceReward(reward_weight=lambda: np.random.uniform(1.0, 2.0), resource_fn=elapsed),
        data.ComposedReward(data.NoReward(), data.ResourceReward(rand.Uniform(-2.0, -1.0), squared)),
    )
    given = dict(time_limit=600.0, seed=1, backend="eager", dtype=torch.float64) | options
    return SatelliteTasking(satellite, rewarder=rewarder, num_envs=num_envs, **given)


def step(env):
    return env.step(TensorDict({"action": torch.zeros(env.num_envs, dtype=torch.int64)}, [env.num_envs]))["next"]


@pytest.fixture(scope="module")
def env():
    return make()


def weights(env):
    env.set_seed(1)
    return env.reset()["observation"]


def test_weights_are_drawn_for_every_episode_and_observed_in_order(env):
    first, second = weights(env), env.reset()["observation"]
    assert len(torch.cat([first[:, :2], second[:, :2]]).unique()) == 12
    assert ((first[:, 0] > 1.0) & (first[:, 0] < 2.0) & (first[:, 1] < -1.0) & (first[:, 1] > -2.0)).all()
    assert torch.equal(first[:, 2:], first[:, :2] / torch.tensor([2.0, 1.0]))
    assert torch.equal(weights(env), first)


def test_weights_do_not_depend_on_the_batch_or_on_numpys_generator(env):
    whole = weights(env)
    np.random.seed(5)
    before = np.random.get_state()[1].copy()
    alone = make(1, env_ids=[2])
    assert torch.equal(alone.reset()["observation"][0], whole[2])
    assert np.array_equal(np.random.get_state()[1], before)


def test_rewards_are_weights_times_growth(env):
    weight = weights(env)
    before = (env.satellite.dynamics.r_BN_N**2).sum(-1)
    reward = step(env)["reward"].squeeze(-1)
    growth = (env.satellite.dynamics.r_BN_N**2).sum(-1) - before
    assert torch.allclose(reward, weight[:, 0] * 60.0 + weight[:, 1] * growth)
    env = make(2, data.ResourceReward(3.0, elapsed), (obs.ResourceRewardWeight(),))
    assert env.reset()["observation"].tolist() == [[3.0], [3.0]]
    assert torch.allclose(step(env)["reward"], torch.full((2, 1), 180.0, dtype=torch.float64))


def test_copies_of_an_episode_have_its_weights(env):
    weight, other = weights(env), make(1)
    other.reset()
    other.restore(env, torch.tensor([0]), torch.tensor([2]))
    assert torch.equal(step(other)["observation"][0], weight[2])
