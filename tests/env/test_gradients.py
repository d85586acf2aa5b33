"""Values that require gradients are refused at every boundary: the simulation does not differentiate, and cuts none silently."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from bsk_torch import SatelliteTasking, act, data, obs, rand, sats, scene
from bsk_torch._checks import no_gradient, number
from bsk_torch.formations import walker_delta_args
from bsk_torch.sim import dyn, fsw

WORDS = r"requires a gradient, and the simulation does not differentiate; use \.detach\(\), or compute it under torch.no_grad"
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


# -- values ---------------------------------------------------------------------------------------------------------------


def test_values_without_gradients_pass():
    for value in (1.0, None, "x", torch.ones(2), [torch.ones(1), 2.0], {"a": torch.ones(1)}, TensorDict(a=torch.ones(1))):
        assert no_gradient("value", value) is value


@pytest.mark.parametrize(
    ("value", "name"),
    [(TWO, "value"), ([1.0, TWO], r"value\[1\]"), ({"a": (TWO,)}, r"value\['a'\]\[0\]"), (TensorDict(a=TWO), r"value\['a'\]")],
)
def test_gradients_are_found_and_named(value, name):
    with pytest.raises(ValueError, match=f"^{name} {WORDS}"):
        no_gradient("value", value)


@pytest.mark.parametrize(
    "call",
    [
        lambda: number("sim_rate", TWO),
        lambda: rand.Uniform(0.0, TWO),
        lambda: Pointer("A", {"mass": TWO}),
        lambda: Pointer("A", {"oe": ORBIT}),
        lambda: Pointer("A", {"oe": list(ORBIT)}),
        lambda: Pointer("A", lambda: {"mass": TWO * 100}),
        lambda: make({"mass": lambda: TWO * 100}),
        lambda: make(world_args={"planetRadius": TWO * 3e6}),
        lambda: make(world_args={"groundStationsData": [{"name": "a", "lat": TWO, "long": 0.0}]}),
        lambda: make(world_args=lambda: {"baseDensity": TWO}),
        lambda: make(sat_arg_randomizer=lambda satellites: {satellites[0]: {"mass": TWO * 100}}),
        lambda: make(time_limit=lambda: TWO * 100),
        lambda: make(sat_arg_randomizer=walker_delta_args(1, altitude=TWO * 300)),
        lambda: scene.UniformTargets(10, radius=TWO * 4e6),
        lambda: obs.SatProperties(dict(prop="omega_BN_B", norm=TWO)),
        lambda: data.ResourceReward(TWO, lambda satellite: satellite.simulator.sim_time),
    ],
)
def test_values_of_users_are_refused(call):
    with pytest.raises(ValueError, match=WORDS):
        call()


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


@pytest.mark.parametrize(
    "call",
    [
        lambda: make(kind=Seeing),
        lambda: make(kind=Telling),
        lambda: make(scenario=Priorities(5)),
        lambda: make(rewarder=Learned(), num_envs=1),
    ],
)
def test_what_functions_and_subclasses_compute_is_refused_when_the_environment_is_built(call):
    with pytest.raises(ValueError, match=WORDS):
        call()


def test_a_reward_is_refused_in_a_step():
    env = make(rewarder=Learned())
    td = env.reset()
    with pytest.raises(ValueError, match=rf"Learned.calculate_reward\(\) {WORDS}"):
        env.step(td.set("action", env.action_spec.rand()))


def test_changed_arguments_are_refused(env):
    with pytest.raises(ValueError, match=WORDS):
        env.set_sat_args({"mass": TWO * 100})


# -- calls ----------------------------------------------------------------------------------------------------------------


def test_actions_are_refused_and_leave_the_episodes_as_they_are(env):
    td = env.reset()
    before = env.get_state()
    with pytest.raises(ValueError, match=f"^action {WORDS}"):
        env.step(td.set("action", torch.zeros(2, 3, requires_grad=True)))
    assert (env.get_state() == before).all()
    env.step(td.set("action", torch.zeros(2, 3, requires_grad=True).detach()))


def test_a_rollout_needs_a_policy_without_gradients(env):
    policy = TensorDictModule(nn.Linear(3, 3), in_keys=["observation"], out_keys=["action"])
    with pytest.raises(ValueError, match=r"with torch.no_grad\(\): env.rollout\(100, policy\)"):
        env.rollout(2, policy)
    with torch.no_grad():
        assert env.rollout(2, policy).shape == (2, 2)


def test_manoeuvres_are_refused(flyer):
    with pytest.raises(ValueError, match=f"^dv_N {WORDS}"):
        flyer.simulator.thrust(torch.tensor([True, False]), torch.zeros(2, 3, requires_grad=True))


def test_written_fields_are_refused(flyer):
    value = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    with pytest.raises(ValueError, match=WORDS):
        flyer.simulator.write("omega_RN_N", torch.tensor([True, True]), value)


@pytest.mark.parametrize("restore", [lambda env, state: env.restore(state), lambda env, state: env.reset(state, set_state=True)])
def test_restored_states_are_refused(env, restore):
    env.reset()
    state = env.get_state()
    state["returns"].requires_grad_()
    with pytest.raises(ValueError, match=WORDS):
        restore(env, state if restore(env, env.get_state()) is None else TensorDict({"state": state}, env.batch_size))


# -- mode -----------------------------------------------------------------------------------------------------------------


def test_no_outputs_require_gradients_and_the_mode_of_the_caller_stays(env):
    assert torch.is_grad_enabled()
    td = env.step(env.reset().set("action", env.action_spec.rand()))
    assert torch.is_grad_enabled()
    assert not any(leaf.requires_grad for leaf in td.values(True, True))
    with torch.no_grad():
        env.reset()
        assert not torch.is_grad_enabled()
    with pytest.raises(TypeError):
        env.step(env.reset().set("action", torch.zeros(2, 3, dtype=torch.int64)))
    assert torch.is_grad_enabled()
