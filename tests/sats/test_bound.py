"""Descriptions of satellites, and the satellites of an environment that are made of them."""

import pytest
import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, obs, sats, scene
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.sats.bound import composed


class Plain(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Image(n_ahead_image=2), act.Charge(duration=60.0))

    def __init__(self, name, threshold=0.5, **options):
        super().__init__(name, **options)
        self.threshold, self.bound = threshold, []

    def on_bind(self):
        self.bound.append((self.latest_target.tolist(), self.opportunity_types))

    def low(self):
        return self.dynamics.battery_charge_fraction < self.threshold

    def legal_actions(self):
        return torch.stack([~self.low(), ~self.low(), torch.ones_like(self.low())], -1)

    def action_mask(self):
        return super().action_mask()


def alone(described, **options):
    options = dict(num_envs=2, time_limit=600.0, backend="eager", seed=0, scenario=scene.UniformTargets(100)) | options
    return SatelliteTasking(described, **options)


def test_a_description_has_nothing_of_an_environment():
    described = Plain("A")
    env = alone(described)
    for name in ("simulator", "dynamics", "fsw", "memory", "names", "fleet", "actions", "find_next_opportunities"):
        assert hasattr(env.satellite, name)
        assert not hasattr(described, name)
    with pytest.raises(RuntimeError, match="'A' is in no environment"):
        described.action_mask()


def test_methods_of_the_user_run_on_the_satellites_of_the_environment():
    described = Plain("A", threshold=2.0)
    env = alone(described)
    satellite = env.satellite
    assert isinstance(satellite, Plain)
    assert isinstance(satellite, SatelliteGroup)
    assert isinstance(satellite, sats.BoundImagingSatellite)
    assert (type(satellite).__name__, type(satellite).__module__) == ("Plain", __name__)
    assert satellite.bound[-1] == ([-1, -1], ("target",)), "what the package declares is there before the hook, without super()"
    assert env.reset()["action_mask"].tolist() == [[False, False, True]] * 2
    satellite.threshold = 0.0
    assert satellite.action_mask().all()
    assert described.threshold == 2.0


def test_classes_are_composed_once():
    assert composed(Plain, SatelliteGroup) is composed(Plain, SatelliteGroup)
    order = [cls.__name__ for cls in composed(Plain, SatelliteGroup).__mro__]
    assert order[:3] == ["Plain", "Plain", "SatelliteGroup"]
    assert order.index("BoundImagingSatellite") < order.index("ImagingSatellite")


@pytest.mark.parametrize("cls", [sats.Satellite, sats.AccessSatellite, sats.ImagingSatellite])
def test_classes_of_the_package_need_no_subclass(cls):
    made = composed(cls, SatelliteGroup)
    assert issubclass(made, cls.bound_type)
    assert made.__mro__[1] is SatelliteGroup
    assert made.__name__ == cls.__name__


def test_types_of_a_fleet():
    """Each type has its number, and its satellites see those of the others."""
    other = type("Other", (Plain,), {})
    env = ConstellationTasking(
        [Plain("A"), other("B"), Plain("C")], scene.UniformTargets(100), num_envs=2, time_limit=600.0, backend="eager", seed=0
    )
    env.reset()
    assert [satellite.names for satellite in env.satellites] == [("A", "C"), ("B",)]
    assert [satellite.type_index for satellite in env.satellites] == [0, 1]
    assert all(env.fleet.satellites[k] is satellite for k, satellite in enumerate(env.satellites))
    seen = env.satellites[0].others["B"].dynamics.r_BN_N
    assert torch.equal(seen, env.satellites[1].dynamics.r_BN_N.repeat_interleave(2, 0))
