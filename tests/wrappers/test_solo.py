"""The view of a constellation in which one satellite decides, against the constellation itself."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env

import bsk_torch
from bsk_torch.wrappers import GymEnv, GymVectorEnv
from bsk_torch.wrappers.stable_baselines3 import SB3VecEnv

pytestmark = pytest.mark.compiled

PRESET, SHORT = "RSOInspection-v1", dict(time_limit=4000.0)


@pytest.mark.parametrize("actions", ["thrust", "waypoints"])
def test_checker_of_stable_baselines3_accepts_the_inspector(actions):
    env = gymnasium.make(f"bsk_torch/{PRESET}", actions=actions, **SHORT).unwrapped
    check_env(env, warn=False)
    assert env.observation_space.shape == (61,)
    assert env.action_space == spaces.Discrete(96) if actions == "waypoints" else env.action_space.shape == (4,)


def test_steps_are_those_of_the_constellation():
    """Numbers of the view are those of the joint agent, whose other satellite does the only thing that it can."""
    view = GymEnv(PRESET, seed=3, **SHORT)
    team = bsk_torch.make(PRESET, joint=True, num_envs=1, seed=3, **SHORT)
    seen, _ = view.reset(seed=3)
    now = team.reset()
    parts = dict(
        zip(team.names, now["observation"].split([len(s.observation_description) for s in team.satellites], -1), strict=True)
    )
    assert seen.tolist() == parts["Inspector1"][0].tolist()
    for thrust in ([0.1, -0.2, 0.3, 400.0], [0.0, 0.1, 0.0, 300.0]):
        idle = torch.where(team.requires_retasking[:, team.names.index("RSO")], 0, bsk_torch.NO_ACTION)
        now = team.play([{"RSO": idle, "Inspector1": torch.tensor([thrust])}], torch.ones(1, dtype=torch.bool))
        seen, reward, terminated, truncated, info = view.step(np.array(thrust, dtype=np.float32))
        assert (reward, info["duration"]) == (float(now["reward"]), float(now["duration"]))
        assert (terminated, truncated) == (bool(now["terminated"]), bool(now["truncated"]))


def test_rows_that_end_begin_again_and_the_others_go_on():
    one, many = (GymVectorEnv(PRESET, n, actions="waypoints", autoreset_mode="SameStep", **SHORT) for n in (1, 3))
    one.reset(seed=4)
    many.reset(seed=4)
    for k in range(8):
        theirs, ours = many.step(np.array([k, 95 - k, 40 + k])), one.step(np.array([k]))
        assert theirs[0][0].tolist() == pytest.approx(ours[0][0].tolist(), abs=1e-5)
        assert [part[0] for part in theirs[1:4]] == [part[0] for part in ours[1:4]]


def test_stable_baselines3_trains_the_inspector_but_not_several():
    env = SB3VecEnv(PRESET, num_envs=2, **SHORT)
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(32)
    assert model.num_timesteps == 32
    with pytest.raises(TypeError, match="needs a SatelliteTasking"):
        GymEnv("MultiInspection-v1")


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"])
def test_copies_continue_the_same_episode(copied):
    env = GymEnv(PRESET, **SHORT)
    env.reset(seed=0)
    thrust = np.array([0.1, -0.2, 0.3, 400.0], dtype=np.float32)
    env.step(thrust)
    other = copied(env)
    assert env.step(thrust)[0].tolist() == other.step(thrust)[0].tolist()
