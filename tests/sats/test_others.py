"""Satellites see the others of their episode by name, each row those of its own environment."""

import numpy as np
import pytest
import torch

from bsk_torch import ConstellationTasking, act, dyn, fsw, obs, sats
from tests.support.refusals import check_refusals, refusal


class Small(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=20.0),)
    dyn_type, fsw_type = dyn.DynamicsModel, fsw.FSWModel


class Chief(Small):
    action_spec = (act.Drift(duration=30.0),)


class Wheeled(Small):
    dyn_type, fsw_type = dyn.BasicDynamicsModel, fsw.BasicFSWModel


NAMES = ("A", "RSO", "B", "W", "C")


def satellites():
    kinds = {"RSO": Chief, "W": Wheeled}
    return [kinds.get(name, Small)(name) for name in NAMES]


@pytest.fixture(scope="module")
def env():
    env = ConstellationTasking(satellites(), num_envs=3, seed=2, backend="eager", time_limit=100.0, dtype=torch.float64)
    env.reset()
    env.rand_step()
    return env


def of_name(env, name):
    """The positions [N, 3] of a satellite, read from its own type's rows."""
    k, number = env.fleet.places[name]
    return env.satellites[k].dynamics.r_BN_N.view(3, -1, 3)[:, number]


@pytest.mark.parametrize("name", NAMES)
def test_a_satellite_is_seen_beside_every_row_of_its_own_environment(env, name):
    for satellite in env.satellites:
        other, count = satellite.others[name], satellite.simulator.count
        assert other.name == name
        assert torch.equal(other.dynamics.r_BN_N.view(3, count, 3), of_name(env, name).unsqueeze(1).expand(-1, count, -1))
    assert torch.equal(env.fleet.satellite(name).dynamics.r_BN_N, of_name(env, name))


def test_everything_that_is_read_has_the_rows_of_the_satellite_that_asks(env):
    asking = env.satellites[0]
    rows = asking.simulator.state.rows
    assert rows == 9
    other = asking.others["W"]
    assert other.dynamics.battery_charge.shape == (rows,)
    assert (other.dynamics.elements.a.shape, other.dynamics.HN.shape) == ((rows,), (rows, 3, 3))
    assert other.dynamics.battery_valid().shape == (rows,)
    assert other.is_alive().all()
    assert (other.is_alive().shape, other.sat_args["wheelSpeeds"].shape) == ((rows,), (rows, 3))
    assert other.simulator.world.r_SN_N.shape == (rows, 3)
    assert other.simulator.sim_time.tolist() == asking.simulator.sim_time.tolist()
    assert {name: check.shape for name, check in other.aliveness().items()}["battery_valid"] == (rows,)
    assert other.fsw.simulator.h == 1.0


def test_one_satellite_sees_one(env):
    one = env.satellites[0].one(7)  # the second of three of its type in the last environment
    assert one.name == "B"
    for name in NAMES:
        np.testing.assert_array_equal(one.others[name].dynamics.r_BN_N, of_name(env, name)[2].numpy())
        assert one.others[name].name == one.simulator.get_satellite(name).name == name
    assert list(one.others) == list(env.satellites[0].others) == list(NAMES)
    assert len(one.others) == len(env.satellites[0].others) == 5


class Nearest(obs.Observation):
    """Distance to the second satellite of the same type, as an observation of a user's own would read it."""

    def get_obs(self):
        return (self.satellite.dynamics.r_BN_N - self.satellite.others["C"].dynamics.r_BN_N).norm(dim=-1)


class TooEarly(Nearest):
    def link_satellite(self, satellite):
        super().link_satellite(satellite)
        self.chief = satellite.others["C"]


class Seeing(Small):
    observation_spec = (Nearest("distance"),)


def test_an_observation_of_a_users_own_sees_others_of_its_type():
    env = ConstellationTasking([Seeing("A"), Seeing("C")], num_envs=2, seed=1, backend="eager", dtype=torch.float64)
    seen = env.reset()["agents", "observation"].squeeze(-1)
    between = (of_pair(env, 0) - of_pair(env, 1)).norm(dim=-1)
    assert torch.equal(seen, torch.stack([between, torch.zeros(2)], 1))


def of_pair(env, number):
    return env.satellites[0].dynamics.r_BN_N.view(2, 2, 3)[:, number]


def test_rejects_wrong_names_changes_and_looks_that_come_too_early(env):
    early = type("Early", (Small,), {"observation_spec": (TooEarly("distance"),)})
    first, one = env.satellites[0].others, env.satellites[1].one(0).others
    check_refusals(
        refusal(lambda: first["RS0"], KeyError, "'RS0'", "'RSO'"),
        refusal(lambda: one["RS0"], KeyError, "'RS0'", "'RSO'"),
        refusal(lambda: env.fleet.satellite("rs0"), KeyError, "'rs0'", "'RSO'"),
        refusal(lambda: setattr(first["RSO"], "name", "other"), AttributeError, "'name'", "another satellite"),
        refusal(lambda: ConstellationTasking([early("A"), early("C")], backend="eager"), RuntimeError, "'C'", "get_obs()"),
    )
