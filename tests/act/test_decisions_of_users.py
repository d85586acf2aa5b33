"""Durations and modes that users' actions return are checked."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import SatelliteTasking, act, obs, sats


def environment(**hooks) -> SatelliteTasking:
    class Satellite(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.Drift(duration=10.0), type("Mine", (act.Action,), hooks)("mine"))

    env = SatelliteTasking(Satellite("A"), num_envs=2, time_limit=60.0, seed=0, backend="eager")
    env.reset()
    return env


def play(env: SatelliteTasking) -> torch.Tensor:
    return env.step(TensorDict({"action": torch.ones(2, dtype=torch.int64)}, [2]))["next", "duration"].flatten()


def deciding(seconds: float, mode: int = 1):
    def decide(self, index, mask, action, previous):
        duration = torch.full((2,), seconds, dtype=torch.float64)
        return act.Decision(torch.full_like(action, mode), action != previous, duration, action, duration)

    return decide


@pytest.mark.parametrize("seconds", [math.nan, -1.0, 0.0, 1e-12])
def test_durations_that_are_not_positive(seconds):
    with pytest.raises(
        ValueError, match=r"Mine\.decide\(\.\.\.\)\.duration is .* for environment 0; it must be at least 1e-09 s"
    ):
        play(environment(decide=deciding(seconds)))


@pytest.mark.parametrize("seconds", [math.inf, 1e300])
def test_endless_durations_last_until_the_episode_ends(seconds):
    assert play(environment(decide=deciding(seconds))).tolist() == [60.0, 60.0]


@pytest.mark.parametrize("mode", [-1, 99])
def test_modes_that_do_not_exist(mode):
    with pytest.raises(ValueError, match=rf"Mine\.decide\(\.\.\.\)\.mode is {mode}; it must be from 0 to"):
        play(environment(decide=deciding(5.0, mode)))

    def table(self):
        rows = len(self.satellite.simulator.ticks)
        return act.ActionTable(torch.full((rows, 1), mode), torch.zeros(1, dtype=torch.bool), torch.ones(1, dtype=torch.float64))

    with pytest.raises(ValueError, match=rf"Mine\.table\(\)\.mode is {mode}; it must be from 0 to"):
        play(environment(table=table))


def test_steps_of_no_length():
    with pytest.raises(ValueError, match="duration=1e-12 must be a number in"):
        act.Charge(duration=1e-12)
    with pytest.raises(ValueError, match="max_step_duration=1e-12 must be a number in"):
        SatelliteTasking(sats.Satellite("A"), max_step_duration=1e-12)


def test_writes_of_wrong_shapes():
    env = environment(decide=deciding(5.0))
    everyone = torch.ones(2, dtype=torch.bool)
    for value in (1.0, torch.ones(17), torch.ones(1)):
        with pytest.raises(ValueError, match=r"value of write\('r_BN_N', rows, value\) is|would be lost"):
            env.simulator.write("r_BN_N", everyone, value)
