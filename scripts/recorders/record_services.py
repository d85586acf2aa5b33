"""Record episodes of imaging with services: images in the first valid tick, verified on the ground, on Basilisk.

Usage::

    python scripts/recorders/record_services.py            # into tests/basilisk/recordings

See ``recording.py`` for what it needs. Where episodes start and what is done in them is read from the present file: ``ic`` and
``action``, which were drawn once. Everything else is recorded again.

A research branch of bsk_rl's authors has such imagers. Classes derived from those of bsk_rl 1.3.8 do here what it does: flight
software whose controller commands the instrument, actions that check the hold after the exposure and that end a downlink with the
store, and a rewarder with lists of records.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.utilities import macros
from Basilisk.utilities.orbitalMotion import MU_EARTH
from bsk_rl import ConstellationTasking, act, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from bsk_rl.sim.fsw.base import action as command
from bsk_rl.utils.functional import default_args
from bsk_rl.utils.orbital import rv2HN
from bsk_rl.utils.rso_imaging import candidate_snapshot, illumination_factor
from record_rso_imaging import Passive, state_of
from recording import RECORDINGS, Array, record_files

FILE, SLOTS = "services", 3


class OneShotFSWModel(fsw.SpaceToSpaceImagingFSWModel):
    """Commands one image in the first tick in which pointing is right and the target in sight."""

    def _set_gateway_msgs(self) -> None:
        super()._set_gateway_msgs()
        self.dynamics.instrument.nodeStatusInMsg.subscribeTo(self.insControl.deviceCmdOutMsg)

    class LocPointTask(fsw.SpaceToSpaceImagingFSWModel.LocPointTask):
        """The same with the controller in its task."""

        @default_args(imageAttErrorRequirement=0.01, imageRateErrorRequirement=None)
        def setup_instrument_controller(self, **kwargs: Any) -> None:
            """Set the tolerances, and run the controller after the guidance."""
            super().setup_instrument_controller(**kwargs)
            self.no_access = messaging.AccessMsg().write(messaging.AccessMsgPayload())
            self.insControl.attGuidInMsg.subscribeTo(self.fsw.attGuidMsg)
            self.insControl.locationAccessInMsg.subscribeTo(self.no_access)
            self._add_model_to_task(self.insControl, priority=987)

    @command
    def action_expose(self, target: Any) -> None:
        """Track a target, and take one image of it."""
        self.locPoint.scTargetInMsg.subscribeTo(target.target_spacecraft.dynamics.simpleNavObject.transOutMsg)
        self.dynamics.instrument.nodeDataName = self.dynamics.rso_partition_names[target.id]
        self.dynamics.instrumentPowerSink.powerStatus = 1
        self.insControl.locationAccessInMsg.subscribeTo(self.dynamics.rso_access_messages[target.id])
        self.insControl.controllerStatus, self.insControl.imaged = 1, 0
        self.simulator.enableTask(self.LocPointTask.name + self.satellite.name)


def level_of(satellite: Any, target: Any) -> float:
    """Data of a target in the store, bit."""
    message = satellite.dynamics.storageUnit.storageUnitDataOutMsg.read()
    levels = dict(zip(message.storedDataName, message.storedData, strict=False))
    return levels.get(satellite.dynamics.rso_partition_names[target.id], 0.0)


def light_of(target: Any) -> float:
    """Visible fraction of the Sun at a target."""
    dynamics = target.target_spacecraft.dynamics
    return illumination_factor(dynamics.world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].read())


class Expose(act.ImageRSO):
    """Image a candidate; the hold is checked at every tick, and ends the step when it is complete and the image stored."""

    def _task(self, target: Any) -> str:
        satellite, sim = self.satellite, self.simulator
        if self.event_name in sim.eventMap:
            sim.delete_event(self.event_name)
        satellite.fsw.action_expose(target)
        satellite.staged = None
        self.attempt = dict(held=0.0, lit=0.0, time=sim.sim_time, level=level_of(satellite, target), captured=None)
        self.event_name = f"exposed_{satellite.name}"
        sim.createNewEvent(
            self.event_name,
            macros.sec2nano(satellite.fsw.fsw_rate),
            True,
            conditionFunction=lambda sim: self._complete(target, float(sim.sim_time)),
            actionFunction=lambda sim: setattr(satellite, "requires_retasking", True),
            terminal=satellite.variable_interval,
        )
        satellite.update_timed_terminal_event(sim.sim_time + self.max_duration, extra_actions=lambda sim: self._forget())
        return target.id

    def _forget(self) -> None:
        self.attempt = None

    def _complete(self, target: Any, now: float) -> bool:
        attempt, satellite = self.attempt, self.satellite
        if attempt is None or now <= attempt["time"]:
            return False
        passed, attempt["time"] = now - attempt["time"], now
        guidance, controller = satellite.fsw.attGuidMsg.read(), satellite.fsw.insControl
        valid = bool(satellite.dynamics.rso_access_messages[target.id].read().hasAccess)
        valid = valid and np.linalg.norm(guidance.sigma_BR) <= controller.attErrTolerance
        valid = valid and np.linalg.norm(guidance.omega_BR_B) <= controller.rateErrTolerance
        if valid:
            attempt["held"] += passed
            attempt["lit"] += light_of(target) * passed
        elif self.hold_mode == "continuous":
            attempt["held"] = attempt["lit"] = 0.0
        if attempt["captured"] is None and level_of(satellite, target) > attempt["level"]:
            attempt["captured"] = now
        if attempt["captured"] is None or attempt["held"] < self.min_pointing_hold_s:
            return False
        satellite.staged = dict(target=target.id, time=attempt["captured"], quality=attempt["lit"] / attempt["held"])
        self.attempt = None
        return True


class DownlinkUntilEmpty(act.Downlink):
    """Ends when no more than a bit is stored, after ten seconds at the earliest."""

    def set_action(self, action: int, prev_action_key: str | None = None) -> str:
        """Arm the event."""
        satellite, sim, start = self.satellite, self.simulator, float(self.simulator.sim_time)
        satellite.started_empty = satellite.dynamics.storage_level <= 1.0
        key = super().set_action(action, prev_action_key)
        name = f"emptied_{satellite.name}"
        if name in sim.eventMap:
            sim.delete_event(name)
        sim.createNewEvent(
            name,
            macros.sec2nano(satellite.fsw.fsw_rate),
            True,
            conditionFunction=lambda sim: (
                sim.sim_time >= start + 10.0
                and satellite.dynamics.storage_level <= 1.0
                and satellite.dynamics.transmitter.dataStatus == 1
            ),
            actionFunction=lambda sim: setattr(satellite, "requires_retasking", True),
            terminal=satellite.variable_interval,
        )
        return key


class Changes(data.base.Data):
    """Targets of which data came or went in a step."""

    def __init__(self, came: list[str] | None = None, went: list[str] | None = None) -> None:
        """Keep the ids."""
        self.came, self.went = came or [], went or []

    def __add__(self, other: Changes) -> Changes:
        """Return only what is new: rewards need no more."""
        return Changes(other.came, other.went)


class LevelStore(data.base.DataStore):
    """Compares the levels of partitions before and after a step."""

    data_type = Changes

    def get_log_state(self) -> dict[str, float]:
        """Levels by target."""
        scenario = getattr(self.satellite, "rso_scenario", None)
        if scenario is None:
            return {}
        return {key: level_of(self.satellite, target) for key, target in scenario.targets_by_id.items()}

    def compare_log_states(self, old: dict[str, float], new: dict[str, float]) -> Changes:
        """Return the targets whose level changed."""
        return Changes([key for key in new if new[key] > old[key]], [key for key in new if new[key] < old[key]])


class ServiceReward(data.base.GlobalReward):
    """Pays a share of the priority for good images when they are taken, and the rest when they have come down."""

    data_store_type = LevelStore

    def __init__(self, delivery_share: float, empty: float, battery: float, storage: float) -> None:
        """Keep the share and the penalties."""
        super().__init__()
        self.share, self.empty, self.battery, self.storage = delivery_share, empty, battery, storage

    def reset_overwrite_previous(self) -> None:
        """Forget records."""
        super().reset_overwrite_previous()
        self.records: dict[str, list[tuple[float, float]]] = {}
        self.parts = [0.0, 0.0, 0.0]

    def reset_post_sim_init(self) -> None:
        """Find the cooldown: two periods of the orbit in which the imager begins."""
        camera = self.scenario.satellites[0]
        r, v = np.linalg.norm(camera.dynamics.r_BN_N), np.linalg.norm(camera.dynamics.v_BN_N)
        mu = MU_EARTH * 1e9
        self.cooldown_s = 2.0 * 2.0 * np.pi * np.sqrt((1.0 / (2.0 / r - v * v / mu)) ** 3 / mu)

    def calculate_reward(self, new_data_dict: dict[str, Changes]) -> dict[str, float]:
        """Pay for a step, and keep what is pending and cools down up to date."""
        scenario, camera = self.scenario, self.scenario.satellites[0]
        now, changes = float(camera.simulator.sim_time), new_data_dict[camera.name]
        penalty = self.battery * (camera.dynamics.battery_charge_fraction < 0.1)
        penalty += self.storage * (camera.dynamics.storage_level_fraction > 0.991)
        penalty += self.empty * camera.started_empty
        camera.started_empty = False
        taken = delivered = 0.0
        for key in changes.came:
            target, staged = scenario.targets_by_id[key], camera.staged
            record = (now, light_of(target)) if staged is None else (staged["time"], staged["quality"])
            self.records.setdefault(key, []).append(record)
            scenario.pending.setdefault(key, set()).add(f"{key} {record[0]}")
            taken += (1.0 - self.share) * target.priority * (record[1] >= 0.5)
        camera.staged = None
        for key in changes.went:
            time, quality = self.records[key].pop(0)
            scenario.pending[key].discard(f"{key} {time}")
            if quality >= 0.5:
                scenario.cooldown_until[key] = max(scenario.cooldown_until.get(key, -np.inf), time + self.cooldown_s)
                delivered += self.share * scenario.targets_by_id[key].priority
            else:
                scenario.cooldown_until.pop(key, None)
        scenario.revision += 1
        self.parts = [taken, delivered, penalty]
        return {name: taken + delivered + penalty if name == camera.name else 0.0 for name in new_data_dict}


def sun_hat_H(satellite: Any) -> Array:
    """Direction from a satellite to the Sun in its Hill frame."""
    world, dynamics = satellite.simulator.world, satellite.dynamics
    r_SN_N = world.gravFactory.spiceObject.planetStateOutMsgs[world.sun_index].read().PositionVector
    line = rv2HN(dynamics.r_BN_N, dynamics.v_BN_N) @ (np.array(r_SN_N) - np.array(dynamics.r_BN_N))
    return line / np.linalg.norm(line)


class Imager(sats.AccessSatellite):
    """Observes what the imager of the preset does, of three candidates."""

    dyn_type, fsw_type = (dyn.SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel), OneShotFSWModel
    observation_spec = [
        obs.SatProperties(
            dict(prop="storage_level_fraction"),
            dict(prop="battery_charge_fraction"),
            dict(prop="wheel_speeds_fraction"),
            dict(prop="sun_hat_H", fn=sun_hat_H),
        ),
        obs.Eclipse(norm=5700.0),
        obs.OpportunityProperties(
            dict(prop="opportunity_open", norm=5700.0),
            dict(prop="opportunity_close", norm=5700.0),
            type="ground_station",
            n_ahead_observe=2,
        ),
        obs.RSOTargetProperties(n_ahead_observe=SLOTS),
    ]
    staged, started_empty = None, False


def make_env(ic: dict[str, Any]) -> ConstellationTasking:
    """The environment of an episode, with every initial condition pinned."""

    class Camera(Imager):
        action_spec = [
            act.Charge(duration=300.0),
            DownlinkUntilEmpty(duration=300.0),
            act.Desat(duration=150.0),
            Expose(SLOTS, require_illumination_during_hold=False, **ic["image"]),
        ]

    catalog = scene.RSOTargetCatalog.from_dict(ic["catalog"])
    return ConstellationTasking(
        satellites=[Camera("SS1", sat_args={**ic["args"], "oe": None}), *(Passive(t.satellite_name) for t in catalog.targets)],
        scenario=scene.RSOTargets(catalog, ["SS1"]),
        rewarder=ServiceReward(**ic["reward"]),
        world_args=dict(utc_init=ic["utc_init"], **ic["world"]),
        time_limit=ic["time_limit"],
        sim_rate=1.0,
        log_level="CRITICAL",
    )


def boundary(env: ConstellationTasking, seen: dict[str, Array]) -> dict[str, Any]:
    """What is seen of an environment at the reset and after a step."""
    scenario, camera, ids = env.scenario, env.satellites[0], list(env.scenario.targets_by_id)
    listed = candidate_snapshot(camera, SLOTS).targets
    return dict(
        obs=seen.get("SS1", np.full(14 + 11 * SLOTS, np.nan)),
        candidates=[-1 if target is None else ids.index(target.id) for target in listed],
        state=state_of(camera),
        storage=[level_of(camera, scenario.targets_by_id[key]) for key in ids],
        priority=[scenario.targets_by_id[key].priority for key in ids],
        pending=[len(scenario.pending.get(key, ())) for key in ids],
        cooldown=[scenario.cooldown_until.get(key, -np.inf) for key in ids],
    )


def play(ic: dict[str, Any], choose: Callable[[int, dict[str, Any]], int | None]) -> tuple[dict[str, Any], list[str]]:
    """Arrays of an episode, and the names of what is observed; ``choose`` returns an action by number and boundary."""
    env = make_env(ic)
    seen, _ = env.reset(seed=0)
    rows = [boundary(env, seen)]
    steps: list[dict[str, Any]] = []
    passive = {satellite.name: 0 for satellite in env.satellites[1:]}
    while (action := choose(len(steps), rows[-1])) is not None:
        given = {"SS1": int(action)} | (passive if not steps else {})
        seen, reward, terminated, truncated, info = env.step(given)
        steps.append(
            dict(
                action=action,
                reward=reward["SS1"],
                parts=env.rewarder.parts,
                over=int(terminated["SS1"] or truncated["SS1"]),
                duration=info["__common__"]["d_ts"],
            )
        )
        rows.append(boundary(env, seen))
        if steps[-1]["over"]:
            break
    names = env.satellites[0].observation_description
    env.close()
    arrays = {key: np.array([row[key] for row in part]) for part in (steps, rows) for key in part[0]}
    return arrays, names


def record(name: str) -> dict[str, Any]:
    """All episodes of the file, one after another."""
    with np.load(RECORDINGS / f"{name}.npz") as old:
        starts, lengths = json.loads(str(old["ic"])), old["length"]
        actions = [old["action"][a:b].tolist() for a, b in itertools.pairwise(np.cumsum([0, *lengths]))]
    played = [
        play(ic, lambda k, _, known=known: known[k] if k < len(known) else None)
        for ic, known in zip(starts, actions, strict=True)
    ]
    return joined(starts, [arrays for arrays, _ in played], played[0][1])


def joined(starts: list[dict[str, Any]], episodes: list[dict[str, Array]], names: list[str]) -> dict[str, Any]:
    """The arrays of the file."""
    arrays = {key: np.concatenate([episode[key] for episode in episodes]) for key in episodes[0]}
    lengths = [len(episode["action"]) for episode in episodes]
    return {"ic": json.dumps(starts), "length": lengths, "obs_names": json.dumps(names), **arrays}


if __name__ == "__main__":
    record_files({FILE: record})
