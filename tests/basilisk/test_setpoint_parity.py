"""Recorded episodes of bsk_rl's ``AttitudeSetpoint``: with reaction wheels, and imposed on a spacecraft without actuators."""

import json

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, obs, rand, sats
from bsk_torch.sim import dyn, fsw
from tests.basilisk.replay import RECORDINGS

BOUNDS = {
    "setpoint_wheels": {"sigma": 3e-13, "omega": 3e-13, "wheels": 1e-10, "battery": 1e-6},
    "setpoint_imposed": {"sigma": 1e-15, "omega": 1e-15},
}
"""Largest differences: an attitude under control ten times those of a computation in NumPy, an imposed one its last digit."""

COLUMNS = {"sigma": slice(7, 10), "omega": slice(10, 13), "wheels": slice(13, 16), "battery": slice(16, 17)}


class Pointer(sats.Satellite):
    """Turns by reaction wheels."""

    dyn_type, fsw_type = dyn.BasicDynamicsModel, fsw.BasicFSWModel
    action_spec = (act.AttitudeSetpoint(control_period=60.0),)
    observation_spec = (
        obs.SatProperties(*(dict(prop=p) for p in ("sigma_BN", "omega_BN_B", "omega_BH_H", "battery_charge_fraction"))),
        obs.Time(),
    )


class Imposed(sats.Satellite):
    """Has the attitude of the set-point at once; 45.5 s last 46 ticks of a second."""

    dyn_type, fsw_type = dyn.DynamicsModel, fsw.FSWModel
    action_spec = (act.AttitudeSetpoint(control_period=45.5),)
    observation_spec = (obs.SatProperties(dict(prop="sigma_BN"), dict(prop="omega_BN_B")), obs.Time())


KINDS = {"setpoint_wheels": Pointer, "setpoint_imposed": Imposed}


def replay(name, **options):
    """Largest differences between a recording and its replay by column; durations and flags are compared exactly."""
    file = np.load(RECORDINGS / f"{name}.npz")
    starts = json.loads(str(file["ic"]))
    given = [start["sats"][0]["args"] for start in starts]
    args = {key: rand.per_env(torch.tensor([one[key] for one in given], dtype=torch.float64)) for key in given[0]}
    env = SatelliteTasking(
        KINDS[name]("sat", {**args, "oe": None}),
        num_envs=len(starts),
        world_args=dict(utc_init=rand.per_env([start["utc_init"] for start in starts])),
        time_limit=starts[0]["time_limit"],
        dtype=torch.float64,
        seed=0,
        **options,
    )
    n, steps = len(starts), int(file["length"][0])
    assert (file["length"] == steps).all()
    actions = torch.tensor(file["action"]).view(n, steps, 3)
    wanted, flags = torch.tensor(file["state"]).view(n, steps + 1, -1), torch.tensor(file["truncated"]).view(n, steps)
    observed, durations = torch.tensor(file["obs"]).view(n, steps + 1, -1), torch.tensor(file["duration"]).view(n, steps)
    found = dict.fromkeys(BOUNDS[name], 0.0)
    td = env.reset()
    for k in range(steps + 1):
        now = {"sigma": env.satellite.dynamics.sigma_BN, "omega": env.satellite.dynamics.omega_BN_B}
        if name == "setpoint_wheels":
            now |= {"wheels": env.satellite.dynamics.wheel_speeds, "battery": env.satellite.dynamics.battery_charge.unsqueeze(-1)}
        for quantity, value in now.items():
            found[quantity] = max(found[quantity], float((value - wanted[:, k, COLUMNS[quantity]]).abs().max()))
        assert (td["observation"] - observed[:, k]).abs().max() < 1e-9
        if k < steps:
            td = env.step(td.set("action", actions[:, k]))["next"]
            assert torch.equal(td["duration"].squeeze(-1), durations[:, k].round())  # recorded to rounding
            assert torch.equal(td["truncated"].squeeze(-1), flags[:, k])
    return found


@pytest.mark.parametrize("name", BOUNDS)
@pytest.mark.parametrize("backend", ["eager", "compiled"])
@pytest.mark.nightly("eager-setpoint_imposed", "eager-setpoint_wheels")
def test_set_points(name, backend):
    found = replay(name, backend=backend)
    assert all(found[quantity] <= bound for quantity, bound in BOUNDS[name].items()), found


def test_an_imposed_attitude_longer_than_one_is_shown_as_it_is():
    lengths = np.linalg.norm(np.load(RECORDINGS / "setpoint_imposed.npz")["state"][:, 7:10], axis=1)
    assert lengths.max() > 1.2  # so the comparison above covers it
