"""Record episodes of imaging of resident space objects (RSO) again: imagers and the targets of a catalog, on Basilisk.

Usage::

    python scripts/recorders/record_rso_imaging.py                       # every file, into tests/basilisk/recordings
    python scripts/recorders/record_rso_imaging.py rso_imaging_two       # only this one
    python scripts/recorders/record_rso_imaging.py --list

See ``recording.py`` for what it needs. Where episodes start and what is done in them is read from the present files: ``ic`` and
``action``, which were drawn once. Everything else is recorded again.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
from bsk_rl import ConstellationTasking, act, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from bsk_rl.utils.rso_imaging import candidate_snapshot, illumination_factor
from recording import RECORDINGS, Array, record_files

CASES = ("one", "two", "per")


class Imager(sats.AccessSatellite):
    """Images the targets."""

    dyn_type = (dyn.SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = fsw.SpaceToSpaceImagingFSWModel
    observation_spec = [
        obs.SatProperties(
            dict(prop="storage_level_fraction"), dict(prop="battery_charge_fraction"), dict(prop="wheel_speeds_fraction")
        ),
        obs.Eclipse(norm=5700.0),
        obs.RSOTargetProperties(
            dict(prop="valid"),
            dict(prop="priority", norm=2),
            dict(prop="target_elevation_angle", norm=90),
            dict(prop="rel_pos_vector_r_BR_H", norm=15960e3),
            dict(prop="rel_vel_vector_v_BR_H", norm=16000),
            dict(prop="angle_to_target", norm=90),
            dict(prop="target_distance", norm=15960e3),
            dict(prop="target_illumination_factor"),
            n_ahead_observe=3,
        ),
        obs.RSOTargetProperties(n_ahead_observe=1, name="default_row"),
        obs.Time(),
    ]
    action_spec = [act.Charge(duration=60.0), act.Downlink(duration=90.0), act.Desat(duration=60.0), act.ImageRSO(3)]


class Passive(sats.Satellite):
    """A target."""

    dyn_type, fsw_type = dyn.RSOTargetDynModel, fsw.FSWModel
    observation_spec, action_spec = [obs.Time()], [act.Drift(duration=1e9)]


def make_env(ic: dict[str, Any]) -> ConstellationTasking:
    """The environment of an episode, with every initial condition pinned."""

    class Camera(Imager):
        action_spec = [*Imager.action_spec[:3], act.ImageRSO(3, **ic["image"])]

    given = dict(ic["reward"])
    taken, delivered = given.pop("acquisition"), given.pop("delivery")
    satellites = [
        Camera(each["name"], sat_args={**each["args"], "oe": None}) if each["name"] in ic["imagers"] else Passive(each["name"])
        for each in ic["sats"]
    ]
    catalog = scene.RSOTargetCatalog.from_dict(ic["catalog"])
    return ConstellationTasking(
        satellites=satellites,
        scenario=scene.RSOTargets(catalog, ic["imagers"], block_pending_targets=ic["block_pending_targets"]),
        rewarder=data.RSOImageReward(
            acquisition_reward_fn=lambda record, target: taken * target.priority,
            delivery_reward_fn=lambda record, target: delivered * target.priority,
            **given,
        ),
        world_args=dict(utc_init=ic["utc_init"], **ic["world"]),
        time_limit=ic["time_limit"],
        sim_rate=ic["sim_rate"],
        log_level="CRITICAL",
    )


def state_of(satellite: Any) -> Array:
    """Time, position, velocity, attitude, rate, wheel speeds, battery, illumination."""
    dynamics, world = satellite.dynamics, satellite.simulator.world
    light = illumination_factor(world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].read())
    parts = dynamics.r_BN_N, dynamics.v_BN_N, dynamics.sigma_BN, dynamics.omega_BN_B, dynamics.wheel_speeds
    return np.concatenate([[satellite.simulator.sim_time], *parts, [dynamics.battery_charge, light]])


class Boundaries:
    """What is seen of an environment at the reset and after every step."""

    def __init__(self, env: ConstellationTasking, imagers: list[str], width: int) -> None:
        self.env, self.imagers, self.width = env, imagers, width
        self.cameras, self.ids = env.satellites[: len(imagers)], list(env.scenario.targets_by_id)
        self.rows: dict[str, list[Any]] = {}

    def partitions(self, camera: Any) -> list[float]:
        """Data of each target, bit."""
        message = camera.dynamics.storageUnit.storageUnitDataOutMsg.read()
        levels = dict(zip(message.storedDataName, message.storedData, strict=False))
        return [levels.get(self.env.scenario.partition_name(key), 0.0) for key in self.ids]

    def add(self, seen: dict[str, Array], info: dict[str, Any]) -> None:
        """Record the present."""
        scenario, cameras, nothing = self.env.scenario, self.cameras, np.full(self.width, np.nan)
        candidates = [candidate_snapshot(camera, 3).targets for camera in cameras]
        gates = [camera.fsw.rso_capture for camera in cameras]
        row = dict(
            obs=[seen.get(name, nothing) for name in self.imagers],
            retask=[int(info[name]["requires_retasking"]) if name in info else -1 for name in self.imagers],
            candidates=[[-1 if t is None else self.ids.index(t.id) for t in listed] for listed in candidates],
            state=[state_of(satellite) for satellite in self.env.satellites],
            storage=[self.partitions(camera) for camera in cameras],
            hold=[[gate.held_s, gate.previous_valid, gate.completed] for gate in gates],
            access=[[c.dynamics.rso_access_messages[key].read().hasAccess for key in self.ids] for c in cameras],
            priority=[scenario.targets_by_id[key].priority for key in self.ids],
            pending=[len(scenario.pending.get(key, ())) for key in self.ids],
            cooldown=[scenario.cooldown_until.get(key, -np.inf) for key in self.ids],
        )
        for key, value in row.items():
            self.rows.setdefault(key, []).append(value)


def play(ic: dict[str, Any], actions: Array) -> tuple[dict[str, Any], list[Any], list[str]]:
    """Arrays of an episode, its images, and the names of what is observed."""
    env, names = make_env(ic), ic["imagers"]
    seen, info = env.reset(seed=0)
    boundaries = Boundaries(env, names, len(seen[names[0]]))
    boundaries.add(seen, info)
    passive = [each["name"] for each in ic["sats"] if each["name"] not in names]
    steps: dict[str, list[Any]] = {}
    for k, action in enumerate(actions):
        given = {name: int(a) for name, a in zip(names, action, strict=True) if a >= 0}
        given |= dict.fromkeys(passive, 0) if k == 0 else {}
        seen, reward, terminated, truncated, info = env.step(given)
        parts = env.rewarder.last_reward_components
        row = dict(
            action=action,
            reward=[reward.get(name, np.nan) for name in names],
            terminated=[int(terminated.get(name, -1)) for name in names],
            truncated=[int(truncated.get(name, -1)) for name in names],
            duration=info["__common__"]["d_ts"],
            credit=[[parts["acquisition"][name], parts["delivery"][name]] for name in names],
        )
        for key, value in row.items():
            steps.setdefault(key, []).append(value)
        boundaries.add(seen, info)
    images = []
    for camera in boundaries.cameras:
        store = camera.data_store.data
        for image in {**store.captures, **store.deliveries}.values():
            of = names.index(camera.name), boundaries.ids.index(image.target_id)
            images.append([*of, image.capture_time, image.size_bits, image.quality, image.hold_valid_time_s, image.delivery_time])
    observed = env.satellites[0].observation_description
    env.close()
    return steps | boundaries.rows, images, observed


def record(name: str) -> dict[str, Any]:
    """All episodes of a file, one after another."""
    with np.load(RECORDINGS / f"{name}.npz") as old:
        starts, lengths = json.loads(str(old["ic"])), old["length"]
        actions = [old["action"][a:b] for a, b in itertools.pairwise(np.cumsum([0, *lengths]))]
    played = [play(ic, each) for ic, each in zip(starts, actions, strict=True)]
    episodes, images, names = ([part[k] for part in played] for k in range(3))
    arrays = {key: np.concatenate([np.array(episode[key]) for episode in episodes]) for key in episodes[0]}
    return {
        "ic": json.dumps(starts),
        "length": lengths,
        "obs_names": json.dumps(names[0]),
        "images": json.dumps(images),
        **arrays,
    }


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = {f"rso_imaging_{case}": record for case in CASES}


if __name__ == "__main__":
    record_files(RECORDERS)
