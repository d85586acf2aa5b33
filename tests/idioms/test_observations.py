"""Idioms of bsk_rl: observations, their dictionaries and functions, opportunities, resources."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, obs, per_environment, sats, scene
from tests.idioms.runner import Idiom, run, title


class OwnDynModel(dyn.GroundStationDynModel):
    @property
    @per_environment
    def speed(self):
        return np.linalg.norm(self.v_BN_N)


class Density(obs.Observation):
    """Written for one satellite, as in bsk_rl."""

    @per_environment
    def get_obs(self):
        return np.array([self.simulator.sim_time, len(self.satellite.find_next_opportunities(n=3, types="target"))])


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Image(2),)
    dyn_type = OwnDynModel


OPTIONS = dict(num_envs=2, time_limit=600.0, seed=1, backend="eager", dtype=torch.float64)


@pytest.fixture(scope="module")
def env():
    """An environment of which a satellite is asked."""
    env = SatelliteTasking(Imager("A"), scene.UniformTargets(200), **OPTIONS)
    env.reset()
    return env


def first(name, value):
    """Return a check of the value of the first property in environment 1."""

    def check(env, entry):
        seen = observed(env, entry)
        found = next(iter(seen.values())) if not isinstance(seen, torch.Tensor) else seen
        assert name is None or next(iter(seen)) == name
        assert np.allclose(found[1].numpy(), value(env.satellite.one(1)))

    return check


def observed(env, entry):
    entry.link_satellite(env.satellite)
    return obs.base.Reader(entry).values()


def each(name, value):
    """Return a check of the first property of every opportunity in environment 1."""

    def check(env, entry):
        seen = observed(env, entry)
        satellite = env.satellite.one(1)
        for (name_of_row, row), opp in zip(
            seen.items(), satellite.find_next_opportunities(len(seen), types=entry.type), strict=True
        ):
            assert name_of_row.startswith(entry.name + "_")
            assert next(iter(row)) == name
            assert np.allclose(row[name][1].numpy(), value(satellite, opp))

    return check


OBSERVATIONS: list[Idiom] = [
    (
        'obs.SatProperties(dict(prop="r_BN_P", module="dynamics", norm=orbital.REQ_EARTH * 1e3))',
        first("r_BN_P_normd", lambda sat: sat.dynamics.r_BN_P / 6378136.6),
    ),
    (
        'obs.SatProperties(dict(prop="v_BN_P", module="dynamics", norm=7616.5, name="velocity"))',
        first("velocity", lambda sat: sat.dynamics.v_BN_P / 7616.5),
    ),
    ('obs.SatProperties(dict(prop="speed", norm=None))', first("speed", lambda sat: sat.dynamics.speed)),
    (
        "obs.SatProperties("
        'dict(prop="wheels", fn=per_environment(lambda sat: np.linalg.norm(sat.dynamics.wheel_speeds)), norm=10))',
        first("wheels_normd", lambda sat: np.linalg.norm(sat.dynamics.wheel_speeds) / 10),
    ),
    (
        "obs.SatProperties("
        'dict(prop="sun", fn=per_environment(lambda sat: np.dot(sat.dynamics.r_BN_N, sat.simulator.world.r_SN_N))))',
        first("sun", lambda sat: np.dot(sat.dynamics.r_BN_N, sat.simulator.world.r_SN_N)),
    ),
    (
        'obs.SatProperties(dict(prop="left", fn=per_environment(lambda sat: sat.simulator.time_limit - sat.simulator.sim_time)))',
        first("left", lambda sat: 600.0),
    ),
    (
        'obs.SatProperties(dict(prop="capacity", fn=lambda sat: sat.sat_args["batteryStorageCapacity"], norm=1e5))',
        first("capacity_normd", lambda sat: sat.sat_args["batteryStorageCapacity"] / 1e5),
    ),
    (
        'obs.SatProperties(dict(prop="list", fn=lambda sat: [sat.dynamics.battery_charge_fraction, 1.0]))',
        first("list", lambda sat: [sat.dynamics.battery_charge_fraction, 1.0]),
    ),
    ('obs.SatProperties(dict(prop="one", fn=per_environment(lambda sat: 1)))', first("one", lambda sat: 1)),
    (
        'obs.SatProperties(dict(fn=per_environment(lambda s: max(o["object"].priority for o in '
        's.find_next_opportunities(3, types="target")))))',
        first("prop_0", lambda sat: max(opp["object"].priority for opp in sat.find_next_opportunities(3, types="target"))),
    ),
    (
        "obs.SatProperties("
        'dict(prop="pass", fn=per_environment(lambda sat: len(sat.upcoming_opportunities_dict(types="ground_station")))))',
        first("pass", lambda sat: len(sat.upcoming_opportunities_dict(types="ground_station"))),
    ),
    ('Density("density")', first(None, lambda sat: [0.0, 3])),
    ("obs.Eclipse(norm=5700.0)", first(None, lambda sat: np.array(sat.next_eclipse()) / 5700.0)),
    (
        'obs.OpportunityProperties(dict(prop="double", fn=lambda sat, opp: opp["object"].priority * 2.0), n_ahead_observe=3)',
        each("double", lambda sat, opp: opp["object"].priority * 2.0),
    ),
    (
        'obs.OpportunityProperties(dict(fn=lambda sat, opp: opp["window"][1] - opp["window"][0], norm=300.0), n_ahead_observe=3)',
        each("prop_0_normd", lambda sat, opp: (opp["window"][1] - opp["window"][0]) / 300.0),
    ),
    (
        "obs.OpportunityProperties("
        'dict(prop="wait", fn=per_environment(lambda s, o: o["window"][0] - s.simulator.sim_time)), n_ahead_observe=3)',
        each("wait", lambda sat, opp: opp["window"][0]),
    ),
    (
        "obs.OpportunityProperties("
        'dict(fn=per_environment(lambda s, o: np.linalg.norm(o["r_LP_P"] - s.dynamics.r_BN_P))), n_ahead_observe=3)',
        each("prop_0", lambda sat, opp: np.linalg.norm(opp["r_LP_P"] - sat.dynamics.r_BN_P)),
    ),
    (
        "obs.OpportunityProperties("
        'dict(prop="is", fn=per_environment(lambda sat, opp: float(opp["type"] == "target"))), n_ahead_observe=3)',
        each("is", lambda sat, opp: 1.0),
    ),
    (
        'obs.OpportunityProperties(dict(prop="priority", fn=lambda sat, opp: 1 - opp["object"].priority), n_ahead_observe=3)',
        each("priority", lambda sat, opp: 1 - opp["object"].priority),
    ),
    (
        'obs.OpportunityProperties(dict(prop="opportunity_open", norm=5700), type="ground_station", n_ahead_observe=1)',
        each("opportunity_open_normd", lambda sat, opp: opp["window"][0] / 5700),
    ),
    (
        'obs.OpportunityProperties(dict(prop="r_LP_P", norm=800 * 1e3), n_ahead_observe=2, type="target", name="tgt")',
        each("r_LP_P_normd", lambda sat, opp: opp["r_LP_P"] / 800e3),
    ),
]


@pytest.mark.parametrize("idiom", OBSERVATIONS, ids=title)
def test_observation(env, idiom):
    line, check = idiom
    orbital = type("orbital", (), {"REQ_EARTH": 6378.1366})
    check(env, run(line, orbital=orbital, Density=Density))


def tensor(shape):
    return lambda value: value.shape == torch.Size(shape) or pytest.fail(f"{value.shape}")


QUERIES: list[Idiom] = [
    ('sat.find_next_opportunities(n=3, pad=True, types="target")["object"].priority', tensor([2, 3])),
    ('sat.find_next_opportunities(3, types=["target"])["window"][0]', tensor([2, 3])),
    ('sat.find_next_opportunities(n=3, pad=True, max_lookahead=50, types="target")["r_LP_P"]', tensor([2, 3, 3])),
    (
        'sat.find_next_opportunities(2, types="target", filter=lambda opp: opp["object"].priority > 0.2)["object"].priority',
        tensor([2, 2]),
    ),
    ('sat.add_access_filter(lambda opp: opp["object"].priority > 0.1, types="target")', lambda value: value is None),
    (
        'sat.add_access_filter(lambda opp: opp["type"] != "target" or opp["object"].priority > 0.1, prepend=True)',
        lambda value: value is None,
    ),
    ("env.satellite.latest_target", tensor([2])),
    ('Imager("B", {}, obs_type=np.ndarray, dtype=np.float32)', lambda value: value.dtype is torch.float32),
    ('Imager("B", sat_args={}, obs_type=dict)', lambda value: value.obs_type is dict),
    ('Imager("B", obs_type=list, variable_interval=False)', lambda value: not value.variable_interval),
    (
        "data.ResourceReward(reward_weight=-1e-3, resource_fn=lambda sat: sat.simulator.sim_time)",
        lambda value: value.weight == -1e-3,
    ),
    (
        "data.ResourceReward(reward_weight=lambda: np.random.uniform(0, 1), resource_fn=lambda sat: sat.dynamics.battery_charge)",
        lambda value: callable(value.weight),
    ),
    ("obs.ResourceRewardWeight(norm=np.array([1.0, 2.0]))", lambda value: value.norm.tolist() == [1.0, 2.0]),
    ("obs.Time(norm=5700.0, name='t', observe_time_remaining=True)", lambda value: math.isclose(value.norm, 5700.0)),
]


@pytest.mark.parametrize("idiom", QUERIES, ids=title)
def test_query(env, idiom):
    line, check = idiom
    assert check(run(line, env=env, sat=env.satellite, Imager=Imager)) is not False
