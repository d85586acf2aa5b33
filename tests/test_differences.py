"""Rows of docs/migration_reference.md, "What differs", that no other test shows."""

import pytest
import torch

from bsk_torch import SatelliteTasking, act, obs, sats


class Drifter(sats.Satellite):
    observation_spec = (obs.Time(observe_time_remaining=True), obs.SatProperties(dict(prop="true_anomaly")))
    action_spec = (act.Drift(duration=60.0),)


def make(sat_args=None):
    return SatelliteTasking(Drifter("Sat", sat_args), num_envs=2, seed=0, backend="eager", dtype=torch.float64)


def test_without_a_limit_all_of_the_time_remains_and_elements_are_those_of_the_moment():
    env = make()
    rollout = env.rollout(2)["next", "observation"]
    assert rollout[..., 0].tolist() == [[1.0, 1.0]] * 2
    assert (rollout[:, 0, 1] != rollout[:, 1, 1]).all()


def test_the_epoch_is_an_argument_of_the_world():
    with pytest.raises(KeyError, match="utc_init"):
        make(dict(utc_init="2018 JUN 27 12:00:00.0 (UTC)"))
