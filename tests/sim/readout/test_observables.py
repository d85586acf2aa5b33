"""Observables: the same numbers from the kernel, on tensors and as plain properties."""

import math
import random

import pytest
import torch

import bsk_torch
from bsk_torch import SatelliteTasking, act, dyn, obs, sats
from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.ephemeris import earth_orientation, sun_position
from bsk_torch.sim.dyn import Now, observable
from bsk_torch.sim.readout import observables
from bsk_torch.vec3 import Mat3, Vec3, only
from tests.support.refusals import check_refusals, refusal

READ = (
    "r_BN_N",
    "v_BN_P",
    "omega_BP_P",
    "omega_BH_H",
    "beta_angle",
    "true_anomaly",
    "wheel_speeds_fraction",
    "illumination",
    "BN",
    "HN",
)


class WatchedDynModel(dyn.BasicDynamicsModel):
    """Adds a property on planes, one on tensors, and one that no kernel can compute."""

    @observable
    def height_over_poles(now: Now):
        return torch.abs((now.PN @ now.r_BN_N).z) / now.args.min_orbital_radius

    @property
    def height_on_tensors(self):
        return self.r_BN_P[:, 2].abs() / self.satellite.sat_args["min_orbital_radius"]

    @observable
    def median_speed(now: Now) -> torch.Tensor:
        return torch.stack(list(now.v_BN_N)).median(0).values


class Watched(sats.Satellite):
    observation_spec = (obs.SatProperties(*(dict(prop=name) for name in READ), dict(prop="height_over_poles")),)
    action_spec = (act.Charge(duration=60.0),)
    dyn_type = WatchedDynModel


def flown(backend: str, satellite: type[sats.Satellite] = Watched) -> SatelliteTasking:
    env = SatelliteTasking(satellite("Watched1"), num_envs=9, seed=3, backend=backend, dtype=torch.float64)
    env.rollout(2)
    return env


@pytest.mark.compiled
def test_kernels_and_tensors_agree():
    env = flown("compiled")
    dynamics, observer = env.satellite.dynamics, env.simulator.observer
    for name in (*READ, "height_over_poles"):
        function = getattr(WatchedDynModel, name).function
        assert function in observer.wanted
        value = function(observer.now)
        expected = value.stack() if isinstance(value, Vec3 | Mat3) else value
        # fused multiply-adds; the true anomaly of a nearly circular orbit loses three digits
        torch.testing.assert_close(getattr(dynamics, name), expected, rtol=1e-9, atol=1e-9)
    assert torch.equal(dynamics.battery_valid(), dynamics.battery_charge > 0.0)
    torch.testing.assert_close(dynamics.height_over_poles, dynamics.height_on_tensors, rtol=1e-12, atol=0)


@pytest.mark.compiled
@pytest.mark.parametrize("backend", ["eager", "compiled"])
def test_frames(backend):
    """Against matrices that are computed another way; 1e-11 is the rounding of the Earth's angle."""
    env = flown(backend)
    dynamics, et = env.satellite.dynamics, env.simulator.world.et
    PN, BN = earth_orientation(et), mrp_to_dcm(Vec3.of(dynamics.sigma_BN)).stack()
    torch.testing.assert_close(dynamics.r_BN_P, (PN @ dynamics.r_BN_N.unsqueeze(-1)).squeeze(-1), rtol=0, atol=1e-3)
    torch.testing.assert_close(dynamics.BP, BN @ PN.mT, rtol=0, atol=1e-10)
    normal = torch.linalg.cross(dynamics.r_BN_N, dynamics.v_BN_N)
    sun = sun_position(et)
    cosine = (normal * sun).sum(-1) / (normal.norm(dim=-1) * sun.norm(dim=-1))
    torch.testing.assert_close(dynamics.beta_angle, torch.acos(cosine), rtol=0, atol=1e-9)


@pytest.mark.compiled
def test_values_follow_the_state():
    env = flown("compiled")
    before = env.satellite.dynamics.r_BN_N
    assert torch.equal(env.satellite.dynamics.r_BN_N, before)
    env.step(env.rand_action(env.reset()))
    assert not torch.equal(env.satellite.dynamics.r_BN_N, before)


@pytest.mark.compiled
def test_functions_without_a_kernel_are_computed_on_tensors(caplog):
    """It alone: the others stay in the kernel. One sentence names it and what has no kernel."""

    class Median(Watched):
        observation_spec = (obs.SatProperties(dict(prop="median_speed"), dict(prop="r_BN_N"), dict(prop="height_over_poles")),)

    observables.TOLD.clear()
    env = flown("compiled", Median)
    observer, dynamics = env.simulator.observer, env.satellite.dynamics
    assert list(observer.missed) == [WatchedDynModel.median_speed.function]
    assert WatchedDynModel.height_over_poles.function in observer._built().layout
    assert torch.equal(dynamics.median_speed, dynamics.v_BN_N.median(-1).values)
    (told,) = (record.getMessage() for record in caplog.records if "computed on tensors" in record.getMessage())
    assert "'median_speed'" in told
    assert "torch.stack" in told


class Counted:
    """Numbers that differ from call to call."""

    calls = 0

    @classmethod
    def next(cls) -> float:
        cls.calls += 1
        return float(cls.calls)


class FickleDynModel(dyn.BasicDynamicsModel):
    """Observables that follow from more than the present."""

    @observable
    def random_speed(now: Now):
        return now.v_BN_N.norm() * random.random()

    @observable
    def counted_speed(now: Now):
        return now.v_BN_N.norm() + Counted.next()

    @observable
    def backend(now: Now):
        """Another value on tensors than in a kernel."""
        return now.v_BN_N.norm() * (2.0 if isinstance(now.v_BN_N.x, torch.Tensor) else 1.0)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("name", "why"), [("random_speed", "two calls"), ("counted_speed", "two calls"), ("backend", "other values than torch")]
)
def test_functions_of_more_than_the_present_are_not_traced(name, why, caplog):
    class Fickle(Watched):
        observation_spec = (obs.SatProperties(dict(prop=name), dict(prop="r_BN_N")),)
        dyn_type = FickleDynModel

    observables.TOLD.clear()
    observer = flown("compiled", Fickle).simulator.observer
    assert getattr(FickleDynModel, name).function in observer.missed
    assert FickleDynModel.r_BN_N.function not in observer.missed
    assert sum(why in record.getMessage() and name in record.getMessage() for record in caplog.records) == 1


@pytest.mark.compiled
def test_one_kernel_computes_what_functions_of_users_read():
    """Properties of models, functions and classes of observations read observables that they need not list."""

    class Radii(obs.Observation):
        def get_obs(self):
            return self.satellite.dynamics.r_BN_P.norm(dim=-1)

    class Reading(Watched):
        observation_spec = (
            obs.SatProperties(
                dict(prop="height_on_tensors"), dict(prop="energy", fn=lambda sat: sat.dynamics.v_BN_P.square().sum(-1) / 2)
            ),
            Radii(),
        )

    env, eager = flown("compiled", Reading), flown("eager", Reading)
    assert not env.simulator.observer.missed
    assert set(eager.simulator.observer.missed) > {WatchedDynModel.r_BN_P.function, WatchedDynModel.v_BN_P.function}
    torch.testing.assert_close(env.observe()["observation"], eager.observe()["observation"], rtol=1e-10, atol=0)
    alone = SatelliteTasking(Reading("Watched1"), num_envs=1, seed=3, dtype=torch.float64)
    alone.rollout(2)
    wanted = [[function.__name__ for function in each.simulator.observer.wanted] for each in (alone, env)]
    assert wanted[0] == wanted[1]


@pytest.mark.compiled
def test_properties_read_together_equal_those_read_one_by_one():
    """Bit for bit: vectors and matrices, norms of each component, masks, and properties that no kernel computes in between."""

    class MaskedDynModel(WatchedDynModel):
        @observable
        def above_equator(now: Now):
            return (now.PN @ now.r_BN_N).z > 0.0

    class Mixed(Watched):
        dyn_type = MaskedDynModel
        observation_spec = (
            obs.SatProperties(
                dict(prop="r_BN_N", norm=[7e6, 8e6, 9e6]),
                dict(prop="BN", norm=[[2.0, 3.0, 5.0]]),
                dict(prop="beta_angle", norm=math.pi),
                dict(prop="height_on_tensors", norm=0.7),
                dict(prop="true_anomaly", norm=0.3),
                dict(prop="battery_charge"),
            ),
            obs.SatProperties(dict(prop="beta_angle", norm=0.7), dict(prop="above_equator", norm=0.3), name="masks"),
            obs.SatProperties(dict(prop="median_speed", norm=0.7), dict(prop="v_BN_P", norm=0.3), name="missed"),
        )

    env = flown("compiled", Mixed)
    observations, observer = env.satellite.observations, env.simulator.observer
    expected = observations.vector(observations.get_dict(), torch.float64)
    assert torch.equal(observations.get_vector(torch.float64), expected)
    together = [MaskedDynModel.r_BN_N.function, MaskedDynModel.BN.function]
    assert observer.read_together(tuple(together)).shape == (9, 12)
    assert observer.read_together((MaskedDynModel.above_equator.function, *together)) is None
    assert observer.read_together((MaskedDynModel.above_equator.function,), bool).dtype == torch.bool
    assert flown("eager", Mixed).simulator.observer.read_together(tuple(together)) is None
    dynamics = env.satellite.dynamics
    assert all(torch.equal(valid, getattr(dynamics, name)()) for name, valid in dynamics.aliveness().items())


def test_rejects_an_unknown_argument():
    typo = type("Typo", (dyn.BasicDynamicsModel,), {"wrong": observable(lambda now: now.args.batteryStorageCapcity)})
    wrong = type("Wrong", (Watched,), {"observation_spec": (obs.SatProperties(dict(prop="wrong")),), "dyn_type": typo})
    names = "'batteryStorageCapcity'", "'batteryStorageCapacity'"
    check_refusals(refusal(lambda: SatelliteTasking(wrong("Wrong1"), backend="eager"), AttributeError, *names))


def test_only_chooses_parts_of_trees():
    mask = torch.tensor([True, False])
    one, two = torch.ones(2), torch.full((2,), 2.0)
    vector, (plane, pair) = only(mask, lambda: (Vec3(one, one, one), (one, (one, one))), (Vec3(two, two, two), (two, (two, two))))
    assert isinstance(vector, Vec3)
    for part in (*vector, plane, *pair):
        assert part.tolist() == [1.0, 2.0]


def test_presets_read_nothing_but_observables():
    """What the paper's agent sees of its satellite comes from one kernel."""
    env = bsk_torch.make("NadirScan-v1", num_envs=1, backend="eager")
    env.reset()
    names = [entry["prop"] for entry in env.satellite.observations.entries[0].entries]
    models = type(env.satellite.dynamics), type(env.satellite.fsw)
    assert all(any(isinstance(getattr(model, name, None), observable) for model in models) for name in names)
    assert env.satellite.dynamics.instrument_pointing_error.max() <= math.pi
