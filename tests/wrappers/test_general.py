"""The view with one commander against Gymnasium's checks and against the environment behind it."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import SyncVectorEnv

from bsk_torch import NO_ACTION
from bsk_torch.wrappers.general import GymJointEnv
from tests.support.refusals import check_refusals, refusal

from .constellations import EMPTY, FULL, check_accepted, mixed, same, trio

pytestmark = pytest.mark.compiled

PRESET = {"id": "bsk_torch/Constellation-v1", "n_satellites": 3, "n_targets": 100, "time_limit": 600.0}


def single(make=mixed, **options):
    return GymJointEnv(make, joint=True, **options)


def test_gymnasium_accepts_the_environment():
    check_accepted(gymnasium.make(gymnasium.envs.registration.EnvSpec("Mixed-v0", entry_point=single)).unwrapped)


def test_spaces_have_an_entry_for_each_satellite():
    env = single()
    observation, info = env.reset(seed=0)
    assert env.action_space == spaces.Tuple([spaces.Discrete(3), spaces.Discrete(2), spaces.Discrete(3)])
    assert [part.shape for part in observation] == [(5,), (2,), (5,)]
    assert observation in env.observation_space
    assert env.action_space.sample(info["action_mask"]) in env.action_space
    assert same({name: info[name] for name in env.core.names}, {f"S{k}": {"requires_retasking": True} for k in range(3)})


def test_steps_are_those_of_the_environment():
    """Same draws and same actions give the same numbers to the last bit; None, NO_ACTION and the core's last action are one."""
    env, core = single(), mixed(joint=True, seed=3)
    env.reset(seed=3)
    now = core.reset()
    rounds = [((0, 1, 2), (0, 1, 2)), ((None, NO_ACTION, 2), (3, 2, 2)), ((np.int64(1), 0, None), (1, 0, 3))]
    for ours, theirs in rounds:
        now["action"] = torch.tensor([theirs])
        now = core.step(now)["next"]
        observation, reward, terminated, truncated, info = env.step(ours)
        assert same(np.concatenate(observation), now["observation"][0].numpy())
        assert (reward, info["d_ts"]) == (float(now["reward"]), float(now["duration"]))
        assert (terminated, truncated) == (bool(now["terminated"]), bool(now["truncated"]))
        idle = [info[name]["requires_retasking"] for name in core.names]
        assert idle == now["members_require_retasking"][0].tolist()
    assert info["d_ts"] == 6.0


def test_the_first_death_ends_the_episode():
    env = single(trio, charges=(FULL, EMPTY, FULL), failure_penalty=-7.0)
    env.reset(seed=0)
    _, reward, terminated, truncated, _ = env.step((0, 0, 0))
    assert (reward, terminated, truncated) == (-7.0, True, False)
    check_refusals(refusal(lambda: env.step((0, 0, 0)), ResetNeeded, "reset"))


def test_rejects_wrong_actions_which_change_nothing():
    env = single()
    env.reset(seed=0)
    check_refusals(
        refusal(lambda: env.step((0, 0)), ValueError, "2 entries", "3"),
        refusal(lambda: env.step((0, 2, 0)), ValueError, "'S1' is 2", "0: action_charge", "1: action_nadir_scan", "None"),
        refusal(lambda: env.step((0, 0, 0.5)), TypeError, "'S2' is 0.5"),
    )
    assert int(env.core.simulator.ticks[0]) == 0


def test_an_episode_can_start_from_a_state():
    env = single()
    env.reset(seed=1)
    env.step((0, 0, 1))
    state = env.core.get_state()
    after = env.step((None, 1, 2))
    env.reset(seed=2)
    env.reset(options={"state": state})
    assert same(env.step((None, 1, 2)), after)
    check_refusals(refusal(lambda: env.reset(options={"states": state}), ValueError, "keys"))


def test_presets_can_be_made_by_name():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(**PRESET)
        observation, info = env.reset(seed=0)
        assert isinstance(env.unwrapped, GymJointEnv)
        assert env.step(env.action_space.sample(info["action_mask"]))[0] in env.observation_space
    batch = gymnasium.make_vec(**PRESET, num_envs=2)
    assert isinstance(batch, SyncVectorEnv)
    assert same(batch.reset(seed=0)[0][0][0], observation[0])
