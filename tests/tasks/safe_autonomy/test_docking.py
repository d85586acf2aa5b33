"""CWDocking-v1 against episodes of AFRL's ``docking_v0``, recorded by scripts/recorders/record_afrl_docking.py."""

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import rand
from tests.tasks.safe_autonomy.replay import play, read

pytestmark = pytest.mark.compiled
ENDS = {
    "dock": "Success",
    "dock quickly": "Success",
    "crash": "Crash",
    "noise": "Max Velocity Violation",
    "away": "Out of Bounds",
    "still": "Timeout",
}
POSITION, VELOCITY = 1e-9, 1e-12
"""Largest differences, m and m/s. The original integrates by RK45, which leaves terms of the sixth order of n t = 1e-3, and both
round: 2,000 steps of 1 s add up 1e-16 of 1e4 m in each."""


@pytest.fixture(scope="module")
def episodes():
    recorded = read("docking.npz")
    starts = torch.as_tensor(np.array([case["states"][0] for case in recorded.values()]))
    env = bsk_torch.make(
        "CWDocking-v1",
        num_envs=len(recorded),
        seed=0,
        dtype=torch.float64,
        sat_args=dict(relative_position=rand.per_env(starts[:, :3]), relative_velocity=rand.per_env(starts[:, 3:])),
    )
    return recorded, play(env, recorded)


@pytest.mark.parametrize("name", ENDS)
def test_recorded_episodes(name, episodes):
    recorded, played = (each[name] for each in episodes)
    assert str(recorded["status"]) == ENDS[name]
    difference = np.abs(played.states[recorded["rows"]] - recorded["states"])
    assert difference[:, :3].max() < POSITION
    assert difference[:, 3:].max() < VELOCITY
    # recorded in float32, in which the original also sums up rewards
    np.testing.assert_allclose(played.observations[recorded["rows"]], recorded["observations"], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(played.rewards, recorded["rewards"], rtol=3e-7, atol=1e-8)
    done = played.terminated | played.truncated
    if name != "away":  # the original was recorded without the limit of excess speeds
        assert done.tolist() == [False] * (len(done) - 1) + [True]
    assert [played.terminated[-1], played.truncated[-1]] == recorded["flags"].tolist()
    assert played.counts["docked"] == (ENDS[name] == "Success")
    assert played.dead == (ENDS[name] == "Crash")
