"""Constellations are trained from Python as from the command line, those of users included."""

import pytest
import torch

import bsk_torch
from bsk_torch import ConstellationTasking, act, comm, data, dyn, formations, fsw, obs, sats, scene
from bsk_torch.presets import PRESETS
from bsk_torch.rl.marl import MAPPOConfig, shared
from bsk_torch.rl.training import PPOConfig, configure, resume, train

pytestmark = pytest.mark.compiled

FEW = dict(frames=32, seconds=None, num_envs=2, rollout=8, evaluate_episodes=2, minibatch=16)


class LinkedDynModel(dyn.ImagingDynModel, dyn.LOSCommDynModel):
    pass


class Imager(sats.ImagingSatellite):
    observation_spec = (
        obs.SatProperties(dict(prop="battery_charge_fraction")),
        obs.OpportunityProperties(dict(prop="priority"), dict(prop="opportunity_open", norm=300.0), n_ahead_observe=4),
        obs.Time(),
    )
    action_spec = (act.Charge(duration=60.0), act.Image(n_ahead_image=4))
    dyn_type = LinkedDynModel
    fsw_type = fsw.ImagingFSWModel


class Guard(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time())
    action_spec = (act.Charge(duration=60.0), act.NadirPoint(duration=40.0))
    dyn_type = LinkedDynModel
    fsw_type = fsw.ImagingFSWModel


def own(**options):
    satellites = [Imager(f"EO{k}", dict(u_max=0.4), may_see_nothing=True) for k in range(2)] + [Guard("G")]
    given = dict(
        scenario=scene.UniformTargets(200),
        rewarder=data.UniqueImageReward(),
        communicator=comm.LOSCommunication(),
        sat_arg_randomizer=formations.train_args(30.0, altitude=500.0, inc=50.0),
        time_limit=600.0,
        terminate_on_time_limit=True,
    )
    return ConstellationTasking(satellites, **(given | options))


@pytest.fixture
def preset(monkeypatch):
    monkeypatch.setitem(PRESETS, "Own-v1", own)
    return "Own-v1"


def test_own_constellations_are_trained_and_resumed(preset, tmp_path):
    config = configure(preset, **FEW)
    assert isinstance(config, MAPPOConfig)  # although own() does not say what it returns
    policy = train(config, tmp_path / "run", episodes=0)
    env = bsk_torch.make(preset, num_envs=2, seed=1)
    td = env.rollout(4, shared(policy, env))
    assert torch.isfinite(td["next", "imager", "reward"]).all()
    assert resume(tmp_path / "run", episodes=0) is not None


def test_constellations_are_trained_by_the_same_functions(tmp_path):
    options = dict(time_limit=300.0, n_satellites=3, n_targets=500)
    config = configure("Constellation-v1", network="attention", options=options, **FEW)
    assert isinstance(config, MAPPOConfig)
    train(config, tmp_path / "run", episodes=0)
    assert (tmp_path / "run" / "policy.pt").is_file()


def test_the_wrong_kind_of_settings_is_told(tmp_path):
    with pytest.raises(ValueError, match="Constellation-v1 has many satellites, and is trained by a MAPPOConfig; configure"):
        train(PPOConfig("Constellation-v1", **FEW), tmp_path / "run", episodes=0)
    with pytest.raises(ValueError, match="NadirScan-v1 has one satellite"):
        train(MAPPOConfig("NadirScan-v1", options={}, **FEW), tmp_path / "run", episodes=0)
    assert not (tmp_path / "run").exists()
