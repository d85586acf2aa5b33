"""Environments of a user's own satellites in Gymnasium's registry, under bsk_rl's names."""

import sys

import gymnasium
import numpy as np
import pytest
import torch

from bsk_torch import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking, act, data, obs, sats, scene
from bsk_torch._listed import MANY
from bsk_torch.presets import PRESETS
from bsk_torch.presets.own import enter
from bsk_torch.wrappers.registration import OWN, register
from tests.support.refusals import check_refusals, refusal


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time())
    action_spec = (act.Charge(duration=30.0), act.Image(n_ahead_image=2))


def problem(**options):
    return dict(scenario=scene.UniformTargets(40), rewarder=data.UniqueImageReward(), time_limit=90.0, backend="eager") | options


@pytest.mark.parametrize("env_id", ["bsk_torch/SatelliteTasking-v1"])
def test_one_satellite_of_ones_own(env_id):
    env = gymnasium.make(env_id, satellite=Imager("EO1"), **problem())
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert info["d_ts"] == 0.0
    *_, info = env.step(0)
    assert (info["d_ts"], info["requires_retasking"]) == (30.0, True)


def test_a_vector_of_ones_own():
    envs = gymnasium.make_vec("bsk_torch/SatelliteTasking-v1", num_envs=3, satellite=Imager("EO1"), **problem())
    envs.reset(seed=1)
    *_, info = envs.step(np.zeros(3, int))
    assert (info["d_ts"].tolist(), envs.unwrapped.satellite.dynamics.r_BN_N.shape) == ([30.0] * 3, (3, 3))


def test_all_satellites_under_one_agent():
    env = gymnasium.make("bsk_torch/GeneralSatelliteTasking-v1", satellites=[Imager("A"), Imager("B")], **problem())
    observations, _ = env.reset(seed=1)
    assert env.observation_space.contains(observations)
    *_, info = env.step((0, 1))
    assert [info["A"]["requires_retasking"], info["B"]["requires_retasking"], info["d_ts"]] == [True, False, 30.0]


def test_separate_agents_are_refused_with_the_view_that_has_them(monkeypatch):
    monkeypatch.setitem(PRESETS, "Own-v1", lambda **options: None)
    name, views = "bsk_torch/ConstellationTasking-v1", ("pettingzoo.parallel_env", "GeneralSatelliteTasking-v1")
    pair = dict(satellites=[Imager("A"), Imager("B")])
    docking = lambda: gymnasium.make("bsk_torch/CWDocking-v1", deputies=2, backend="eager")
    check_refusals(
        refusal(lambda: gymnasium.make(name, **pair), gymnasium.error.Error, "ConstellationTasking", *views),
        refusal(lambda: gymnasium.make_vec(name, num_envs=2, **pair), gymnasium.error.Error, "ConstellationTasking", *views),
        refusal(docking, TypeError, "'CWDocking-v1'", "ConstellationTasking", "SatelliteTasking", "parallel_env", "GymJointEnv"),
        refusal(lambda: register(), TypeError, "'Own-v1'", "return annotation", "SatelliteTasking"),
    )


def test_environments_that_a_training_entered_are_not_registered():
    name = enter(lambda num_envs: None)
    try:
        register()
        assert f"bsk_torch/{name}" not in gymnasium.registry
    finally:
        del PRESETS[name]


def test_general_satellite_tasking_is_a_batched_constellation_with_one_agent():
    env = GeneralSatelliteTasking([Imager("A"), Imager("B")], num_envs=2, **problem(seed=3))
    other = ConstellationTasking([Imager("A"), Imager("B")], num_envs=2, joint=True, **problem(seed=3))
    assert env.joint
    torch.testing.assert_close(env.reset()["observation"], other.reset()["observation"])
    with pytest.raises(ValueError, match="joint=False is a ConstellationTasking"):
        GeneralSatelliteTasking([Imager("A")], joint=False)


@pytest.mark.parametrize("there", [True, False])
def test_bare_names_are_left_to_bsk_rl_where_it_is_there(there, monkeypatch):
    for name in OWN:
        monkeypatch.delitem(gymnasium.registry, name, raising=False)
    if there:
        monkeypatch.setitem(sys.modules, "bsk_rl", sys)
    register()
    assert all(f"bsk_torch/{name}" in gymnasium.registry for name in OWN)
    assert [name in gymnasium.registry for name in OWN] == [not there] * len(OWN)


def either(**options) -> GeneralSatelliteTasking | SatelliteTasking: ...


def test_a_preset_of_two_classes_is_registered_as_the_first(monkeypatch):
    monkeypatch.setitem(PRESETS, "Own-v1", either)
    monkeypatch.delitem(gymnasium.registry, "bsk_torch/Own-v1", raising=False)
    register()
    assert gymnasium.registry.pop("bsk_torch/Own-v1").entry_point == MANY["entry_point"]
