"""A subclass's observation is observed, as a vector and by name."""

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, obs, per_environment, sats, scene

PLACES = dict(fn=lambda satellite, targets: targets.place.double(), name="place")


class Two(obs.OpportunityProperties):
    """Overrides only get_obs, of a class that has a faster vector."""

    def get_obs(self):
        return {"target_0": super().get_obs()["target_0"], "two": torch.full((len(self.simulator.ticks),), 2.0)}


class Constant(obs.Observation):
    value = None

    @per_environment
    def get_obs(self):
        return self.value


def make(*spec, obs_type=torch.Tensor, num_envs=2):
    attributes = {"observation_spec": spec, "action_spec": (act.Image(2),)}
    satellite = type("Imager", (sats.ImagingSatellite,), attributes)("A", obs_type=obs_type)
    options = dict(num_envs=num_envs, time_limit=600.0, seed=1, backend="eager", dtype=torch.float64)
    return SatelliteTasking(satellite, scene.UniformTargets(400), **options)


def constant(value):
    return type("Mine", (Constant,), {"value": value})("mine")


def test_a_subclass_that_overrides_only_get_obs_is_observed():
    entry = Two(dict(prop="priority"), PLACES, n_ahead_observe=3)
    named, vector = make(entry, obs_type=dict).reset()["observation"], make(entry).reset()["observation"]
    assert vector.shape == (2, 3)
    assert (vector[:, 2] == 2.0).all()
    assert torch.equal(vector[:, 0], named["target", "target_0", "priority"])
    assert torch.equal(vector[:, 1], named["target", "target_0", "place"])


def test_a_subclass_may_have_a_vector_of_its_own():
    class Fast(Constant):
        def get_obs(self):
            ones = torch.ones(len(self.simulator.ticks))
            return {"a": ones, "b": 2 * ones}

        def get_vector(self):
            return torch.tensor([[1.0, 2.0]]).expand(len(self.simulator.ticks), -1)

    assert make(Fast("mine")).reset()["observation"].tolist() == [[1.0, 2.0]] * 2
    narrow = type("Narrow", (Fast,), {"get_obs": Fast.get_obs, "get_vector": lambda self: Fast.get_vector(self)[:, :1]})
    env = make(narrow("mine"))
    with pytest.raises(
        TypeError, match=r"Narrow.get_vector\(\) is a tensor of shape \[2, 1\] .* must be a tensor of shape \[2, 2\]"
    ):
        env.reset()


@pytest.mark.parametrize("value", [1.0, torch.tensor(1.0), torch.ones(1), torch.ones(2), np.ones(3), [1.0, 2.0]])
def test_observations_of_one_satellite_are_those_of_each(value):
    """Shapes [1] and [2] fit trials of one environment, and batches of two."""
    observation = make(constant(value)).reset()["observation"]
    assert torch.equal(observation, torch.as_tensor(value).double().reshape(1, -1).expand(2, -1))


def test_observations_are_named_after_their_class():
    class SunAngle(obs.Observation):
        def get_obs(self):
            return self.satellite.dynamics.battery_charge_fraction

    attributes = {"observation_spec": [SunAngle(), SunAngle(), SunAngle("other")], "action_spec": [act.Charge()]}
    env = SatelliteTasking(type("Plain", (sats.Satellite,), attributes)("One"), num_envs=1, backend="eager")
    assert env.satellite.observation_description == ["sun_angle", "sun_angle_2", "other"]
