"""Wrong calls of the views: what each must raise, and what its message must name."""

import numpy as np
from gymnasium.error import ResetNeeded

import bsk_torch
from bsk_torch import data
from bsk_torch.wrappers import GymEnv, GymJointEnv, GymVectorEnv, PettingZooEnv
from tests.support.refusals import check_refusals, refusal

from .constellations import trio


def test_rejects_wrong_arguments():
    batch = bsk_torch.make("NadirScan-v1", num_envs=2, backend="eager", time_limit=60.0)
    envs = GymVectorEnv(batch, metrics=lambda env: {"one": 1.0})
    envs.reset(seed=0)
    check_refusals(
        refusal(lambda: GymEnv(batch), ValueError, "num_envs=2", "GymEnv", "GymVectorEnv"),
        refusal(lambda: GymEnv(dict), TypeError, "core", "dict", "SatelliteTasking"),
        refusal(lambda: GymVectorEnv(batch, time_limit=3.0), TypeError, ["time_limit"]),
        refusal(lambda: GymVectorEnv(batch, 3), ValueError, "num_envs=3", 2),
        refusal(lambda: GymVectorEnv(batch, output="jax"), ValueError, "output", "'jax'", ["numpy", "torch"]),
        refusal(lambda: GymVectorEnv(batch, autoreset_mode="Later"), ValueError, "autoreset_mode", "'Later'", "'NextStep'"),
        refusal(lambda: envs.reset(options={"mask": None}), ValueError, "options", ["mask"], ["reset_mask", "state"]),
        refusal(lambda: envs.step(np.zeros(2, int)), TypeError, "metrics(env)['one']", [], [2]),
        refusal(lambda: data.NoReward().cum_reward, AttributeError, "cum_reward", "env.rewarder.cum_reward"),
    )
    trios = [trio(joint=joint, num_envs=n, backend="eager") for joint in (True, False) for n in (1, 2)]
    one, many = GymJointEnv(trios[0]), PettingZooEnv(trios[2])
    scan, alone = "NadirScan-v1", bsk_torch.make("NadirScan-v1", backend="eager")
    check_refusals(
        refusal(lambda: one.step((0, 0, 0)), ResetNeeded, "step()", "reset()"),
        refusal(lambda: GymJointEnv(trios[1]), ValueError, "num_envs=2", "GymJointEnv"),
        refusal(lambda: GymJointEnv(trios[2]), ValueError, "joint=False", "PettingZooEnv"),
        refusal(lambda: GymJointEnv(alone), TypeError, "core", "SatelliteTasking", "ConstellationTasking"),
        refusal(lambda: many.step({}), ResetNeeded, "step()", "reset()"),
        refusal(lambda: many.state(), ResetNeeded, "state()", "reset()"),
        refusal(lambda: PettingZooEnv(trios[3]), ValueError, "num_envs=2", "PettingZooEnv"),
        refusal(lambda: PettingZooEnv(trios[0]), ValueError, "joint=True", "GymJointEnv"),
        refusal(lambda: PettingZooEnv(scan, backend="eager"), TypeError, scan, "SatelliteTasking", "ConstellationTasking"),
        refusal(lambda: PettingZooEnv(trios[2], time_limit=3.0), TypeError, ["time_limit"]),
    )
