"""Values that require gradients are refused at every boundary: the simulation does not differentiate, and cuts none silently."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch._checks import no_gradient, number
from bsk_torch.formations import walker_delta_args
from bsk_torch.sim import dyn, fsw
from tests.support.episodes import unchanged
from tests.support.refusals import check_refusals, refusal

NAMES = "gradient", ".detach()", "torch.no_grad"
TWO = torch.tensor(2.0, requires_grad=True)
ORBIT = torch.tensor([7e6, 0.0, 0.8, 0.0, 0.0, 0.0], dtype=torch.float64, requires_grad=True)


class Pointer(sats.Satellite):
    dyn_type, fsw_type = dyn.BasicDynamicsModel, fsw.BasicFSWModel
    observation_spec = (obs.SatProperties(dict(prop="omega_BN_B")),)
    action_spec = (act.AttitudeSetpoint(control_period=10.0),)


class Flyer(Pointer):
    fsw_type = fsw.MagicOrbitalManeuverFSWModel


def make(sat_args=None, kind=Pointer, num_envs=2, **options):
    common = dict(num_envs=num_envs, time_limit=100.0, seed=0, backend="eager")
    return SatelliteTasking(kind("A", sat_args), **(common | options))


@pytest.fixture(scope="module")
def env():
    return make()


@pytest.fixture(scope="module")
def flyer():
    env = make(kind=Flyer, orbit="integrated")
    env.reset()
    return env


def test_values_without_gradients_pass():
    for value in (1.0, None, "x", torch.ones(2), [torch.ones(1), 2.0], {"a": torch.ones(1)}, TensorDict(a=torch.ones(1))):
        assert no_gradient("value", value) is value


def differentiable(call, *names):
    return refusal(call, ValueError, *names, "gradient", ".detach()", "torch.no_grad")


def test_rejects_values_of_users():
    stations = {"groundStationsData": [{"name": "a", "lat": TWO, "long": 0.0}]}
    randomized = lambda randomizer: make(sat_arg_randomizer=randomizer)
    check_refusals(
        differentiable(lambda: no_gradient("value", TWO), "value"),
        differentiable(lambda: no_gradient("value", [1.0, TWO]), "value[1]"),
        differentiable(lambda: no_gradient("value", {"a": (TWO,)}), "value['a'][0]"),
        differentiable(lambda: no_gradient("value", TensorDict(a=TWO)), "value['a']"),
        differentiable(lambda: number("sim_rate", TWO), "sim_rate"),
        differentiable(lambda: rand.Uniform(0.0, TWO), "high"),
        differentiable(lambda: Pointer("A", {"mass": TWO}), "sat_args['mass']"),
        differentiable(lambda: Pointer("A", {"oe": ORBIT}), "sat_args['oe']"),
        differentiable(lambda: Pointer("A", {"oe": list(ORBIT)}), "sat_args['oe'][0]"),
        differentiable(lambda: Pointer("A", lambda: {"mass": TWO * 100}), "sat_args['mass']"),
        differentiable(lambda: make({"mass": lambda: TWO * 100}), "sat_args", "mass[0]"),
        differentiable(lambda: make(world_args={"planetRadius": TWO * 3e6}), "world_args['planetRadius']"),
        differentiable(lambda: make(world_args=stations), "world_args['groundStationsData'][0]['lat']"),
        differentiable(lambda: make(world_args=lambda: {"baseDensity": TWO}), "world_args['baseDensity']"),
        differentiable(lambda: randomized(lambda sats: {sats[0]: {"mass": TWO * 100}}), "sat_arg_randomizer", "mass"),
        differentiable(lambda: make(time_limit=lambda: TWO * 100), "time_limit"),
        differentiable(lambda: randomized(walker_delta_args(1, altitude=TWO * 300)), "walker_delta_args", "altitude"),
        differentiable(lambda: scene.UniformTargets(10, radius=TWO * 4e6), "radius"),
        differentiable(lambda: obs.SatProperties(dict(prop="omega_BN_B", norm=TWO)), "obs.SatProperties", "norm", "omega_BN_B"),
        differentiable(lambda: data.ResourceReward(TWO, lambda satellite: satellite.simulator.sim_time), "reward_weight"),
    )


class Priorities(scene.UniformTargets):
    """Targets whose priorities a network would set."""

    def draw(self, key):
        values = super().draw(key)
        return values | {"target_priority": values["target_priority"] * TWO}


class Weighted(obs.Observation):
    """The time, by a weight that could be learned."""

    def __init__(self):
        super().__init__("weighted")

    def get_obs(self):
        return self.satellite.simulator.sim_time * TWO


class Telling(Pointer):
    observation_spec = (obs.SatProperties(dict(prop="x", fn=lambda satellite: TWO * satellite.simulator.sim_time)),)


class Seeing(Pointer):
    observation_spec = (Weighted(),)


class Learned(data.GlobalReward):
    """A reward with a weight that could be learned."""

    def calculate_reward(self, before, after):
        return (self.fleet.sim_time * TWO).double().unsqueeze(-1)


def test_actions_are_refused_and_leave_the_episodes_as_they_are(env):
    td = env.reset()
    wrong = td.clone().set("action", torch.zeros(2, 3, requires_grad=True))
    with unchanged(env):
        check_refusals(refusal(lambda: env.step(wrong), ValueError, "action", *NAMES))
    env.step(td.set("action", torch.zeros(2, 3, requires_grad=True).detach()))


def test_a_rollout_needs_a_policy_without_gradients(env):
    policy = TensorDictModule(nn.Linear(3, 3), in_keys=["observation"], out_keys=["action"])
    check_refusals(refusal(lambda: env.rollout(2, policy), ValueError, "torch.no_grad()", "env.rollout(100, policy)"))
    with torch.no_grad():
        assert env.rollout(2, policy).shape == (2, 2)


def test_no_outputs_require_gradients_and_the_mode_of_the_caller_stays(env):
    assert torch.is_grad_enabled()
    td = env.step(env.reset().set("action", env.action_spec.rand()))
    assert torch.is_grad_enabled()
    assert not any(leaf.requires_grad for leaf in td.values(True, True))
    with torch.no_grad():
        env.reset()
        assert not torch.is_grad_enabled()
    check_refusals(refusal(lambda: env.step(env.reset().set("action", torch.zeros(2, 3, dtype=torch.int64))), TypeError))
    assert torch.is_grad_enabled()


def test_rejects_what_functions_and_subclasses_compute():
    env = make(rewarder=Learned())
    td = env.reset().set("action", env.action_spec.rand())
    check_refusals(
        differentiable(lambda: make(kind=Seeing), "observation of A", "weighted"),
        differentiable(lambda: make(kind=Telling), "observation of A", "sat_props", "x"),
        differentiable(lambda: make(scenario=Priorities(5)), "Priorities.draw(key)", "target_priority"),
        differentiable(lambda: make(rewarder=Learned(), num_envs=1), "Learned.calculate_reward()"),
        differentiable(lambda: env.step(td), "Learned.calculate_reward()"),
    )


def test_rejects_calls(env, flyer):
    env.reset()
    state, rows, zeros = env.get_state(), torch.tensor([True, True]), torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    state["returns"].requires_grad_()
    start = TensorDict({"state": state}, env.batch_size)
    check_refusals(
        differentiable(lambda: env.set_sat_args({"mass": TWO * 100}), "sat_args['mass']"),
        differentiable(lambda: env.restore(state), "returns"),
        differentiable(lambda: env.reset(start, set_state=True), "returns"),
        differentiable(lambda: flyer.simulator.thrust(torch.tensor([True, False]), zeros.float()), "dv_N"),
        differentiable(lambda: flyer.simulator.write("omega_RN_N", rows, zeros), "omega_RN_N", "value"),
    )
