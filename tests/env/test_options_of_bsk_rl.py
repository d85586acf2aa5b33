"""Arguments of bsk_rl's environments: each works, or raises and names what to use instead."""

import numpy as np
import pytest
import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, comm, data, formations, obs, sats, scene
from bsk_torch.rand import first_key
from bsk_torch.sats.satellite import as_dtype
from tests.support.refusals import check_refusals, refusal


class Plain(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=3.0),)


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.OpportunityProperties({"prop": "priority"}, n_ahead_observe=2),)
    action_spec = (act.Drift(duration=3.0),)


def build(satellite=None, **options) -> SatelliteTasking:
    options = {"num_envs": 2, "backend": "eager", "time_limit": 60.0, "seed": 3} | options
    return SatelliteTasking(satellite=satellite or Plain("EO1", {}), **options)


def masses(env) -> list[float]:
    env.reset()
    return env.satellite.sat_args["mass"].tolist()


@pytest.mark.parametrize("wrap", [lambda satellite: [satellite], lambda satellite: (satellite,)], ids=["list", "tuple"])
def test_one_satellite_in_a_list_is_one_satellite(wrap):
    assert build(wrap(Plain("EO1", {"mass": 100.0}))).names == ["EO1"]


def test_arguments_are_randomized_together_for_one_satellite():
    def randomizer(satellites):
        mass = np.random.uniform(100.0, 200.0)
        return {satellites[0]: {"mass": mass, "storedCharge_Init": 1e3 * mass}}

    env = build(sat_arg_randomizer=randomizer)
    first, again = masses(env), masses(build(sat_arg_randomizer=randomizer, num_envs=3))
    assert first == again[:2]
    assert first[0] != first[1]
    assert (env.satellite.sat_args["storedCharge_Init"] == 1e3 * env.satellite.sat_args["mass"]).all()


def test_one_satellite_takes_options_of_many():
    env = build(sat_arg_randomizer=formations.walker_delta_args(1, altitude=600.0))
    env.reset()
    assert env.satellite.sat_args["oe"][:, 0].tolist() == [6971e3] * 2
    env = build(vizard_dir=None, vizard_settings=None, render_mode=None, generate_obs_retasking_only=True)
    env.reset()
    assert (env.play(torch.zeros(2, dtype=torch.int64))["observation"] > 0.0).all()
    env = ConstellationTasking((Plain("A"), Plain("B")), num_envs=1, backend="eager", dtype=np.float64, render_mode=None)
    assert env.dtype == torch.float64
    check_refusals(refusal(lambda: ConstellationTasking((Plain("A"), Plain("B")), vizard_dir="x"), TypeError, "vizard_dir"))
    assert build(dtype=np.float64).reset()["observation"].dtype == torch.float64
    assert build().reset()["observation"].dtype == torch.float32


@pytest.mark.parametrize("kind", [np.float64, "float64", np.dtype("float64"), torch.float64])
def test_types_of_numpy(kind):
    assert as_dtype(kind) is torch.float64


def test_rejects_unusable_options_at_construction():
    plain, render = [Plain("A"), Plain("B")], "env.render"
    only = lambda satellite: SatelliteTasking(satellite=satellite)
    check_refusals(
        refusal(lambda: build(vizard_dir="/tmp/viz"), TypeError, "vizard_dir", "'/tmp/viz'", render),
        refusal(lambda: build(vizard_settings={"vizard_rate": 5.0}), TypeError, "vizard_settings", {"vizard_rate": 5.0}, render),
        refusal(lambda: build(render_mode="human"), TypeError, "render_mode", "'human'", render),
        refusal(lambda: build(scenario=scene.UniformTargets), TypeError, "scenario", "UniformTargets", "parentheses"),
        refusal(lambda: build(communicator=comm.FreeCommunication), TypeError, "communicator", "CommunicationMethod"),
        refusal(lambda: build(rewarder=data.ScanningTimeReward), TypeError, "rewarder", "ScanningTimeReward", "parentheses"),
        refusal(lambda: build(rewarder=[data.NoReward(), 3]), TypeError, "rewarder=3"),
        refusal(lambda: build(sat_arg_randomizer=lambda satellites: None), TypeError, "sat_arg_randomizer", None),
        refusal(lambda: build(max_step_duration=0.0), ValueError, "max_step_duration", 0.0, 1e-09),
        *(refusal(lambda s=s: only(s), ValueError, f"satellite={s}", "ConstellationTasking") for s in (plain, [], Plain)),
        *(refusal(lambda t=t: as_dtype(t), ValueError, "dtype", t, "torch.float32") for t in (np.int32, torch.int64, "decimal")),
    )


@pytest.mark.parametrize("rewarders", [(data.NoReward(),), iter([data.NoReward()])])
def test_rewarders_of_any_collection_are_added(rewarders):
    assert build(rewarder=rewarders).rewarder.rewarders


def test_time_limits_may_be_functions_that_use_numpy():
    limits = [build(num_envs=n, time_limit=lambda: np.random.uniform(50.0, 500.0)) for n in (2, 3)]
    for env in limits:
        env.reset()
    assert torch.equal(limits[0].time_limit, limits[1].time_limit[:2])
    assert len(limits[1].time_limit.unique()) == 3


def test_without_targets_a_satellite_that_looks_for_none_flies():
    class Blind(Imager):
        observation_spec = (obs.Time(),)

    env = SatelliteTasking(Blind("EO1", {}), scene.UniformTargets(0), data.UniqueImageReward(), backend="eager")
    env.reset()
    assert not env.scenario.available.any()
    assert env.play(torch.zeros(1, dtype=torch.int64))["reward"].tolist() == [[0.0]]


def test_without_targets_a_satellite_that_looks_for_some_raises_as_in_bsk_rl_unless_it_may_see_nothing(monkeypatch):
    monkeypatch.setattr("bsk_torch.sim.access.lookahead.MAX_SEGMENTS", 1)

    def fly(**options):
        satellite = Imager("EO1", {}, **options)
        return SatelliteTasking(
            satellite, scene.UniformTargets(0), data.UniqueImageReward(), backend="eager", time_limit=60.0
        ).reset()

    check_refusals(refusal(lambda: fly(), RuntimeError, "target", "environments"))
    assert (fly(may_see_nothing=True)["observation"] == 0.0).all()


def test_some_environments_without_targets():
    assert not scene.UniformTargets((0, 1)).draw(first_key(2))["target_exists"].any()
    exists = scene.UniformTargets((0, 3)).draw(first_key(64))["target_exists"]
    assert set(exists.sum(1).tolist()) == {0.0, 1.0, 2.0}


def test_rates_that_ticks_cannot_resolve_are_flown_as_in_bsk_rl(caplog):
    class Spinning(sats.Satellite):
        observation_spec = (obs.SatProperties(dict(prop="omega_BN_B")),)
        action_spec = (act.Drift(duration=20.0),)

    def make(compat):
        args = dict(omega_init=[0.0, 0.7, 0.0], wheelSpeeds=[0.0, 0.0, 0.0])
        return SatelliteTasking(Spinning("Top", args), sim_rate=5.0, backend="eager", num_envs=1, compat=compat)

    check_refusals(refusal(lambda: make(None), ValueError, "sim_rate=5"))
    env = make("bsk_rl")
    assert "rad in a tick of sim_rate=5 s" in caplog.text
    assert env.reset()["observation"].flatten().tolist() == pytest.approx([0.0, 0.7, 0.0])
