"""Record episodes of inspection again: a resident space object (RSO) and its inspectors, on Basilisk through bsk_rl.

Usage::

    python scripts/recorders/record_inspection.py                         # every file, into tests/basilisk/recordings
    python scripts/recorders/record_inspection.py inspection_dark         # only this one
    python scripts/recorders/record_inspection.py --list

See ``recording.py`` for what it needs. Where episodes start and what is done in them is read from the present files: ``ic``,
``action`` and ``rso_action``, which were drawn once (inspectors that fly to random places near the RSO, and what each file is
for). Everything else is recorded again. Actions are float64, so no single precision is in them.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from bsk_rl import ConstellationTasking, act, data, obs, sats, scene
from bsk_rl.obs.relative_observations import rso_imaged_regions
from bsk_rl.sim import dyn, fsw
from bsk_rl.utils.orbital import fibonacci_sphere
from bsk_rl.utils.rso_imaging import illumination_factor
from recording import RECORDINGS, Array, record_files

CASES = ("one", "three", "fine", "steer", "collision", "range", "fuel", "complete", "dark", "collide3", "tumble")

TICKS = "fine"
"""The case of which every tick is recorded, too."""


def sun_hat_chief(satellite: Any, chief: Any) -> Array:
    """Direction of the Sun in the chief's Hill frame."""
    return chief.dynamics.HN @ (sun(satellite) / np.linalg.norm(sun(satellite)))


def sun(satellite: Any) -> Array:
    """Position of the Sun, m."""
    world = satellite.simulator.world
    return np.array(world.gravFactory.spiceObject.planetStateOutMsgs[world.sun_index].read().PositionVector)


class Inspector(sats.Satellite):
    """Flies about the RSO."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="dv_available", norm=10),
            dict(prop="inclination", norm=np.pi),
            dict(prop="eccentricity", norm=0.1),
            dict(prop="semi_major_axis", norm=7000),
            dict(prop="ascending_node", norm=2 * np.pi),
            dict(prop="argument_of_periapsis", norm=2 * np.pi),
            dict(prop="true_anomaly", norm=2 * np.pi),
            dict(prop="beta_angle", norm=np.pi),
        ),
        obs.ResourceRewardWeight(),
        obs.RelativeProperties(
            dict(prop="r_DC_N"),
            dict(prop="v_DC_N"),
            dict(prop="r_DC_Hc", norm=500),
            dict(prop="v_DC_Hc", norm=5),
            dict(prop="rso_sigma_BH"),
            dict(prop="rso_omega_BH"),
            dict(prop="six_hill", fn=rso_imaged_regions),
            dict(prop="six_body", fn=partial(rso_imaged_regions, frame="chief_body")),
            dict(prop="fifteen_hill", fn=partial(rso_imaged_regions, region_centers=fibonacci_sphere(15))),
            dict(prop="sun_hat_Hc", fn=sun_hat_chief),
            chief_name="RSO",
        ),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    ]
    action_spec = [act.ImpulsiveThrustHill("RSO", max_dv=1.0, max_drift_duration=11400.0, fsw_action="action_inspect_rso")]
    dyn_type = (dyn.MaxRangeDynModel, dyn.ConjunctionDynModel, dyn.RSOInspectorDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.RSOInspectorFSWModel)


class SteeringInspector(Inspector):
    """The same with MRP steering."""

    _dyn_type = _fsw_type = None  # bsk_rl keeps composed types on the class, where subclasses find them
    fsw_type = (fsw.SteeringFSWModel, fsw.MagicOrbitalManeuverFSWModel, fsw.RSOInspectorFSWModel)


class RSO(sats.Satellite):
    """The inspected spacecraft."""

    observation_spec = [obs.SatProperties(dict(prop="one", fn=lambda _: 1.0))]
    action_spec = [act.NadirPoint(duration=1e9)]
    dyn_type = (dyn.ConjunctionDynModel, dyn.RSODynModel)
    fsw_type = fsw.FSWModel


class FreeFSWModel(fsw.FSWModel):
    """Leaves the spacecraft to its torques: bsk_rl's model imposes an attitude on it."""

    class MRPControlTask(fsw.FSWModel.MRPControlTask):
        """The task without its link to the spacecraft."""

        def setup_automatic_pointing(self) -> None:
            """Link nothing."""


class TumblingRSO(RSO):
    """The same, turning freely from its initial rate."""

    _dyn_type = _fsw_type = None
    action_spec = [act.Drift(duration=1e9)]
    fsw_type = FreeFSWModel


def fuel_of(satellite: Any) -> float:
    """Fuel of a satellite, m/s; 0 without a tank."""
    return satellite.fsw.dv_available if isinstance(satellite.fsw, fsw.MagicOrbitalManeuverFSWModel) else 0.0


def make_env(ic: dict[str, Any]) -> ConstellationTasking:
    """The environment of an episode, with every initial condition pinned."""
    chief = TumblingRSO if any(ic["sats"][0]["omega_init"]) else RSO
    satellites = [chief("RSO", sat_args={**ic["sats"][0], "oe": None})]
    for k, given in enumerate(ic["sats"][1:], 1):
        kind = SteeringInspector if "servo_P" in given else Inspector
        satellites.append(kind(f"Inspector{k}", sat_args={**given, "oe": None}))
    return ConstellationTasking(
        satellites=satellites,
        scenario=scene.SphericalRSO(**ic["scenario"]),
        rewarder=(
            data.RSOInspectionReward(**ic["reward"]),
            data.ResourceReward(resource_fn=fuel_of, reward_weight=ic["fuel_weight"]),
        ),
        world_args=dict(utc_init=ic["utc_init"]),
        time_limit=ic["time_limit"],
        sim_rate=ic["sim_rate"],
        log_level="CRITICAL",
    )


def state_of(satellite: Any) -> Array:
    """Time, position, velocity, attitude, rate, illumination, fuel and data in the store."""
    dynamics, world = satellite.dynamics, satellite.simulator.world
    light = illumination_factor(world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].read())
    stored = 0.0 if isinstance(satellite, RSO) else dynamics.storage_level
    parts = dynamics.r_BN_N, dynamics.v_BN_N, dynamics.sigma_BN, dynamics.omega_BN_B
    return np.concatenate([[satellite.simulator.sim_time], *parts, [light, fuel_of(satellite), stored]])


class Boundaries:
    """What is seen of an environment at the reset and after every step."""

    def __init__(self, env: ConstellationTasking, width: int) -> None:
        self.env, self.width, self.points = env, width, env.scenario.rso_points
        self.names = [satellite.name for satellite in env.satellites]
        self.rows: dict[str, list[Any]] = {}

    def add(self, seen: dict[str, Array], info: dict[str, Any]) -> None:
        """Record the present."""
        env, inspectors, nothing = self.env, self.env.satellites[1:], np.full(self.width, np.nan)
        stores = [satellite.data_store.data for satellite in inspectors]
        row = dict(
            obs=[seen.get(name, nothing) for name in self.names[1:]],
            retask=[int(info[name]["requires_retasking"]) if name in info else -1 for name in self.names],
            state=[state_of(satellite) for satellite in env.satellites],
            alive=[satellite.is_alive() for satellite in env.satellites],
            agents=[name in env.agents for name in self.names],
            wheels=[[*s.dynamics.wheel_speeds, s.dynamics.battery_charge] for s in inspectors],
            sun=sun(env.satellites[0]),
            inspected=[[store.point_inspect_status.get(p, False) for p in self.points] for store in stores],
            illuminated=[[store.point_illuminate_status.get(p, False) for p in self.points] for store in stores],
        )
        for key, value in row.items():
            self.rows.setdefault(key, []).append(value)


class TickRecorder:
    """Messages at the end of every tick."""

    def __init__(self, env: ConstellationTasking) -> None:
        rso, inspector = env.satellites
        sim, dynamics = env.simulator, rso.dynamics
        self.bodies = [satellite.dynamics.scObject.scStateOutMsg.recorder() for satellite in env.satellites]
        self.store = inspector.dynamics.storageUnit.storageUnitDataOutMsg.recorder()
        self.light = sim.world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].recorder()
        self.points = [point.accessOutMsgs[0].recorder() for point in dynamics.rso_points]
        for message in (*self.bodies, self.store, self.light, *self.points):
            sim.AddModelToTask(dynamics.rso_task_name, message, ModelPriority=-9)  # after everything else

    def arrays(self) -> dict[str, Any]:
        """Rows of ticks."""
        rso, inspector = (np.hstack([m.r_BN_N, m.v_BN_N, m.sigma_BN, m.omega_BN_B]) for m in self.bodies)
        return dict(
            tick_time=self.bodies[0].times() * 1e-9,
            tick_rso=np.c_[rso, self.light.illuminationFactor],
            tick_sat=np.c_[inspector, self.store.storageLevel],
            tick_access=np.array([point.hasAccess for point in self.points]).T.astype(bool),
            tick_lit=np.array([point.hasIllumination for point in self.points]).T.astype(bool),
        )


def play(ic: dict[str, Any], actions: Array, rso_actions: Array, ticks: bool) -> tuple[dict[str, Any], dict[str, Any], list[str]]:
    """Arrays of an episode, those of its ticks, and the names of what is observed."""
    env = make_env(ic)
    seen, info = env.reset(seed=0)
    names = [satellite.name for satellite in env.satellites]
    env.action_space(names[1])
    recorder = TickRecorder(env) if ticks else None
    boundaries = Boundaries(env, len(seen[names[1]]))
    boundaries.add(seen, info)
    steps: dict[str, list[Any]] = {}
    for action, of_rso in zip(actions, rso_actions, strict=True):
        given = {name: row.copy() for name, row in zip(names[1:], action, strict=True) if not np.isnan(row).any()}
        if of_rso >= 0:
            given["RSO"] = int(of_rso)
        before = [dict(part.cum_reward) for part in env.rewarder.rewarders]
        seen, reward, terminated, truncated, info = env.step(given)
        parts = [
            [part.cum_reward[name] - old[name] for name in names]
            for part, old in zip(env.rewarder.rewarders, before, strict=True)
        ]
        row = dict(
            action=action,
            rso_action=of_rso,
            reward=[reward.get(name, np.nan) for name in names],
            inspection=parts[0],
            fuel=parts[1],
            duration=info["__common__"]["d_ts"],
            terminated=[int(terminated[name]) if name in terminated else -1 for name in names],
            truncated=[int(truncated[name]) if name in truncated else -1 for name in names],
        )
        for key, value in row.items():
            steps.setdefault(key, []).append(value)
        boundaries.add(seen, info)
    bonus = env.rewarder.bonus_reward_time
    ends = dict(
        bonus_time=np.nan if bonus is None else bonus,
        death=[np.nan if s.time_of_death is None else s.time_of_death for s in env.satellites],
    )
    observed = env.satellites[1].observation_description
    found = {} if recorder is None else recorder.arrays()
    env.close()
    return steps | boundaries.rows | {"ends": ends}, found, observed


def record(name: str) -> dict[str, Any]:
    """All episodes of a file, one after another."""
    with np.load(RECORDINGS / f"{name}.npz") as old:
        starts, lengths = json.loads(str(old["ic"])), old["length"]
        ends = np.cumsum([0, *lengths])
        given = [(old["action"][a:b], old["rso_action"][a:b]) for a, b in itertools.pairwise(ends)]
    ticks = name == f"inspection_{TICKS}"
    played = [play(ic, *actions, ticks) for ic, actions in zip(starts, given, strict=True)]
    episodes, ticked, names = ([part[k] for part in played] for k in range(3))
    last = [episode.pop("ends") for episode in episodes]
    arrays = {key: np.concatenate([np.array(episode[key]) for episode in episodes]) for key in episodes[0]}
    arrays |= {key: np.concatenate([each[key] for each in ticked]) for key in ticked[0]}
    if ticks:
        arrays["tick_length"] = [len(each["tick_time"]) for each in ticked]
    arrays |= {key: [end[key] for end in last] for key in last[0]}
    return {"ic": json.dumps(starts), "length": lengths, "obs_names": json.dumps(names[0]), **arrays}


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = {f"inspection_{case}": record for case in CASES}


if __name__ == "__main__":
    record_files(RECORDERS)
