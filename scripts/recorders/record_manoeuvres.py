"""Record episodes with impulsive maneuvers again: imagers and scanners, on Basilisk through bsk_rl.

Usage::

    python scripts/recorders/record_manoeuvres.py                        # every file, into tests/basilisk/recordings
    python scripts/recorders/record_manoeuvres.py manoeuvre_scan         # only this one
    python scripts/recorders/record_manoeuvres.py --list

See ``recording.py`` for what it needs. Where episodes start, what targets there are and what is done are read from the present
files: ``ic``, ``targets`` and ``action``, which were drawn once. Everything else is recorded again.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from Basilisk.utilities.orbitalMotion import REQ_EARTH
from bsk_rl import SatelliteTasking, act, data, obs, sats, scene
from bsk_rl.scene.targets import Target, UniformTargets
from bsk_rl.sim import dyn, fsw
from bsk_rl.utils.rso_imaging import illumination_factor
from gymnasium import spaces
from recording import RECORDINGS, Array, record_files

EARTH_RADIUS = REQ_EARTH * 1e3


def stations(count: int) -> obs.OpportunityProperties:
    """When the next ground stations come into view."""
    times = (dict(prop=f"opportunity_{end}", norm=5700.0) for end in ("open", "close"))
    return obs.OpportunityProperties(*times, type="ground_station", n_ahead_observe=count)


class ThrustImage(act.ImpulsiveThrust):
    """Thrust, then image the upcoming target whose number follows, or drift if that is negative."""

    @property
    def space(self) -> spaces.Box:
        """Change of velocity, longest duration and number of the target."""
        return spaces.Box(np.full(5, -1e4), np.full(5, 1e4), dtype=np.float64)

    def set_action(self, action: Array) -> None:
        """Carry it out."""
        super().set_action(action[:4])
        if action[4] >= 0:
            target = self.satellite.parse_target_selection(int(action[4]))
            self.satellite.task_target_for_imaging(target, max_duration=float(action[3]))


class Kicker(sats.ImagingSatellite):
    """The imager."""

    dyn_type = (dyn.ImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ImagingFSWModel)
    action_spec = [ThrustImage(max_dv=60.0, max_drift_duration=600.0)]
    observation_spec = [
        obs.SatProperties(
            dict(prop="dv_available", norm=100.0),
            dict(prop="r_BN_P", norm=EARTH_RADIUS),
            dict(prop="semi_major_axis", norm=7e6),
            dict(prop="c_hat_P"),
        ),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_open", norm=300.0),
            dict(prop="opportunity_close", norm=300.0),
            dict(prop="target_angle", norm=math.pi),
            n_ahead_observe=4,
        ),
        stations(1),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    ]


class Scanner(sats.AccessSatellite):
    """The scanner."""

    dyn_type = (dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ContinuousImagingFSWModel)
    action_spec = [act.ImpulsiveThrust(max_dv=30.0, max_drift_duration=2000.0, fsw_action="action_nadir_scan")]
    observation_spec = [
        obs.SatProperties(
            dict(prop="r_BN_P", norm=EARTH_RADIUS), dict(prop="v_BN_P", norm=7600.0), dict(prop="storage_level_fraction")
        ),
        stations(2),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    ]


class Fixed(UniformTargets):
    """Given targets: positions, m, and priorities, [n, 4]."""

    def __init__(self, table: Array) -> None:
        super().__init__(len(table))
        self.table = table

    def regenerate_targets(self) -> None:
        """Make the targets."""
        self.targets = [Target(f"t{k}", row[:3], row[3]) for k, row in enumerate(self.table)]


def make_env(ic: dict[str, Any], table: Array | None) -> SatelliteTasking:
    """The environment of an episode: of the imager with a table of targets, of the scanner without."""
    (given,) = ic["sats"]
    images = table is not None
    return SatelliteTasking(
        (Kicker if images else Scanner)(given["name"], sat_args={**given["args"], "oe": None}),
        scenario=Fixed(table) if images else scene.UniformNadirScanning(),
        rewarder=data.UniqueImageReward() if images else data.ScanningTimeReward(),
        world_args=dict(utc_init=ic["utc_init"]),
        time_limit=ic["time_limit"],
        sim_rate=ic["sim_rate"],
        log_level="CRITICAL",
    )


def state_of(satellite: Any) -> Array:
    """Time, position, velocity, attitude, rate, wheel speeds, charge and illumination."""
    dynamics, world = satellite.dynamics, satellite.simulator.world
    light = illumination_factor(world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].read())
    parts = dynamics.r_BN_N, dynamics.v_BN_N, dynamics.sigma_BN, dynamics.omega_BN_B, dynamics.wheel_speeds
    return np.concatenate([[satellite.simulator.sim_time], *parts, [dynamics.battery_charge, light]])


def extra_of(satellite: Any, images: bool) -> list[float]:
    """Fuel and data in the store; images taken and missed, and access to the target, or the number of stations in view."""
    dynamics = satellite.dynamics
    if images:
        access = dynamics.imagingTarget.accessOutMsgs[-1].read().hasAccess
        return [satellite.fsw.dv_available, dynamics.storage_level, satellite.imaged, satellite.missed, access]
    stations = satellite.simulator.world.groundStations
    in_view = sum(message.read().hasAccess for station in stations for message in station.accessOutMsgs)
    return [satellite.fsw.dv_available, dynamics.storage_level, in_view, 0, 0]


def windows_of(satellite: Any) -> list[list[Any]]:
    """The windows that are known: place, opening and closing."""
    known = satellite.opportunities
    return [[w["object"].name if w["type"] == "target" else str(w["object"]), *map(float, w["window"])] for w in known]


def play(ic: dict[str, Any], actions: Array, table: Array | None) -> tuple[dict[str, list[Any]], list[Any], list[str]]:
    """Rows of an episode, the windows known at its beginning and at its end, and the names of what is observed."""
    env = make_env(ic, table)
    seen, info = env.reset(seed=0)
    satellite, rows = env.satellite, {}  # type: Any, dict[str, list[Any]]

    def add(**row: Any) -> None:
        for name, value in row.items():
            rows.setdefault(name, []).append(value)

    def add_present() -> None:
        extra = extra_of(satellite, table is not None)
        add(obs=seen, state=state_of(satellite), retask=info["requires_retasking"], extra=extra)

    add_present()
    windows = [windows_of(satellite)]
    for action in actions:
        seen, reward, terminated, truncated, info = env.step(action.copy())
        add(action=action, reward=reward, terminated=terminated, truncated=bool(truncated), duration=info["d_ts"])
        add_present()
    windows.append(windows_of(satellite))
    names = satellite.observation_description
    env.close()
    return rows, windows, names


def record(name: str) -> dict[str, Any]:
    """All episodes of a file, one after another."""
    with np.load(RECORDINGS / f"{name}.npz") as file:
        old = {key: file[key] for key in file.files}
    starts, ends = json.loads(str(old["ic"])), np.cumsum([0, *old["length"]])
    tables = old.get("targets", [None] * len(starts))
    given = [old["action"][a:b] for a, b in itertools.pairwise(ends)]
    played = [play(*episode) for episode in zip(starts, given, tables, strict=True)]
    arrays = {key: np.concatenate([np.array(rows[key]) for rows, _, _ in played]) for key in played[0][0]}
    arrays |= {"targets": old["targets"]} if "targets" in old else {}
    windows = json.dumps([known for _, known, _ in played])
    return {"ic": json.dumps(starts), "length": old["length"], "obs_names": played[0][2], "windows": windows, **arrays}


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = {"manoeuvre_kick": record, "manoeuvre_scan": record}


if __name__ == "__main__":
    record_files(RECORDERS)
