"""Record episodes of attitude set-points again, on Basilisk through bsk_rl.

Usage::

    python scripts/recorders/record_setpoints.py                        # every file, into tests/basilisk/recordings
    python scripts/recorders/record_setpoints.py setpoint_wheels        # only this one
    python scripts/recorders/record_setpoints.py --list

See ``recording.py`` for what it needs. Where episodes start and what is done are read from the present files: ``ic`` and
``action``, which were drawn once. Everything else is recorded again.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
from bsk_rl import SatelliteTasking, act, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from bsk_rl.utils.rso_imaging import illumination_factor
from recording import RECORDINGS, Array, record_files


class Pointer(sats.Satellite):
    """Turns by reaction wheels."""

    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel
    action_spec = [act.AttitudeSetpoint(control_period=60.0)]
    observation_spec = [
        obs.SatProperties(*(dict(prop=name) for name in ("sigma_BN", "omega_BN_B", "omega_BH_H", "battery_charge_fraction"))),
        obs.Time(),
    ]


class Imposed(sats.Satellite):
    """Has the attitude of the set-point at once."""

    dyn_type = dyn.DynamicsModel
    fsw_type = fsw.FSWModel
    action_spec = [act.AttitudeSetpoint(control_period=45.5)]
    observation_spec = [obs.SatProperties(dict(prop="sigma_BN"), dict(prop="omega_BN_B")), obs.Time()]


KINDS: dict[str, Any] = {"setpoint_wheels": Pointer, "setpoint_imposed": Imposed}


def state_of(satellite: Any) -> Array:
    """Time, position, velocity, attitude, rate, wheel speeds, charge and illumination; 0 and 1 where there are none."""
    dynamics, world = satellite.dynamics, satellite.simulator.world
    wheels, charge, light = getattr(dynamics, "wheel_speeds", np.zeros(3)), getattr(dynamics, "battery_charge", 0.0), 1.0
    if hasattr(dynamics, "eclipse_index"):
        light = illumination_factor(world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].read())
    motion = dynamics.r_BN_N, dynamics.v_BN_N, dynamics.sigma_BN, dynamics.omega_BN_B
    return np.concatenate([[satellite.simulator.sim_time], *motion, wheels, [charge, light]])


def play(name: str, ic: dict[str, Any], actions: Array) -> tuple[dict[str, list[Any]], list[str]]:
    """Rows of an episode, and the names of what is observed."""
    (given,) = ic["sats"]
    env = SatelliteTasking(
        KINDS[name](given["name"], sat_args={**given["args"], "oe": None}),
        scenario=scene.UniformNadirScanning(),
        rewarder=data.NoReward(),
        world_args=dict(utc_init=ic["utc_init"]),
        time_limit=ic["time_limit"],
        sim_rate=ic["sim_rate"],
        log_level="CRITICAL",
    )
    seen, info = env.reset(seed=0)
    rows: dict[str, list[Any]] = {"obs": [seen], "state": [state_of(env.satellite)], "retask": [info["requires_retasking"]]}

    def add(**row: Any) -> None:
        for key, value in row.items():
            rows.setdefault(key, []).append(value)

    for action in actions:
        seen, reward, terminated, truncated, info = env.step(action.copy())
        add(action=action, reward=reward, terminated=terminated, truncated=bool(truncated), duration=info["d_ts"])
        add(obs=seen, state=state_of(env.satellite), retask=info["requires_retasking"])
    names = env.satellite.observation_description
    env.close()
    return rows, names


def record(name: str) -> dict[str, Any]:
    """All episodes of a file, one after another."""
    with np.load(RECORDINGS / f"{name}.npz") as file:
        starts, ends, actions = json.loads(str(file["ic"])), np.cumsum([0, *file["length"]]), file["action"]
        length = file["length"]
    given = [actions[a:b] for a, b in itertools.pairwise(ends)]
    played = [play(name, *episode) for episode in zip(starts, given, strict=True)]
    arrays = {key: np.concatenate([np.array(rows[key]) for rows, _ in played]) for key in played[0][0]}
    return {"ic": json.dumps(starts), "length": length, "obs_names": played[0][1], **arrays}


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = dict.fromkeys(KINDS, record)


if __name__ == "__main__":
    record_files(RECORDERS)
