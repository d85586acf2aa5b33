"""Presets of bsk_torch as environments of bsk_rl, and flights of episodes there.

The parts for areas are in :mod:`bsk_torch.lab.basilisk.areas_reference`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
import torch
from bsk_rl import SatelliteTasking, act, data, obs, sats, scene
from bsk_rl.scene.targets import Target
from bsk_rl.sim import dyn, fsw
from numpy.typing import NDArray
from tensordict import TensorDict

from bsk_torch.lab.basilisk.areas_reference import AreaOutlook, AreaProperties, AreaReward, Areas, AreaSatellite
from bsk_torch.lab.basilisk.flight import LONGEST, Array, Flight, Pilot, Problem, Start
from bsk_torch.presets.aeos import ORBIT, SATELLITE, TARGET
from bsk_torch.presets.aeos_power import BIN, BINS, CHARGE, CROWD, DESAT, FAST, RESERVE, RESOURCES
from bsk_torch.sim.component import UserArguments

# -- presets ----------------------------------------------------------------------------------------------------------


class ScannerDyn(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    """Dynamics of a satellite that scans and downlinks, with the two pointing errors that NadirScan-v1 observes."""

    @property
    def instrument_pointing_error(self) -> float:
        """Angle between instrument axis and nadir direction, rad."""
        return angle(-np.array(self.r_BN_P), self.satellite.fsw.c_hat_P)

    @property
    def solar_pointing_error(self) -> float:
        """Angle between panel normal and Sun direction, rad."""
        sun = self.world.gravFactory.spiceObject.planetStateOutMsgs[self.world.sun_index].read()
        return angle(np.array(sun.PositionVector), self.BN.T @ self.satellite.sat_args["nHat_B"])


def angle(a: Array, b: Array) -> float:
    """Angle between two vectors, rad; the second one of length 1."""
    return float(np.arccos(np.clip(a / np.linalg.norm(a) @ b, -1.0, 1.0)))


def next_station() -> obs.OpportunityProperties:
    """The observation of the next pass over a ground station."""
    times = [dict(prop=name, norm=ORBIT) for name in ("opportunity_open", "opportunity_close")]
    return obs.OpportunityProperties(*times, type="ground_station", n_ahead_observe=1)


def scanning(durations: Sequence[float], ahead: Sequence[obs.Observation] = ()) -> dict[str, Any]:
    """Attributes of a satellite that scans, charges, downlinks, and slows its wheels for these durations, s."""
    properties = (
        dict(prop="storage_level_fraction"),
        dict(prop="battery_charge_fraction"),
        dict(prop="wheel_speeds_fraction"),
        dict(prop="instrument_pointing_error", norm=np.pi),
        dict(prop="solar_pointing_error", norm=np.pi),
    )
    actions = act.Scan, act.Charge, act.Downlink, act.Desat
    return {
        "observation_spec": [obs.SatProperties(*properties), next_station(), obs.Eclipse(norm=ORBIT), obs.Time(), *ahead],
        "action_spec": [action(duration=duration) for action, duration in zip(actions, durations, strict=True)],
        "dyn_type": ScannerDyn,
        "fsw_type": fsw.ContinuousImagingFSWModel,
    }


def nadir_scan(problem: Problem, start: Start) -> SatelliteTasking:
    """NadirScan-v1."""
    attributes = scanning((180.0, 120.0, 60.0, 60.0))
    # a new class for each episode, because composed models are kept on the class
    satellite = type("Scanner", (sats.AccessSatellite,), attributes)("Scanner1", sat_args=bits(start.sat_args))
    return environment(problem, start, satellite, scene.UniformNadirScanning(**problem.scenario), data.ScanningTimeReward())


def areas(problem: Problem, start: Start) -> SatelliteTasking:
    """Areas-v1."""
    if start.areas is None:
        raise ValueError(f"{problem.preset} needs areas; the episode of seed {start.seed} has none")
    cells, share, weight = start.areas
    own = {"areas": Areas(cells, share, weight, **problem.scenario)}
    attributes = scanning([60.0] * 4, [AreaProperties("areas"), AreaOutlook("outlook")]) | own
    satellite = type("AreaScanner", (AreaSatellite,), attributes)("Scanner1", sat_args=bits(start.sat_args))
    return environment(problem, start, satellite, scene.Scenario(), AreaReward())


def bits(arguments: UserArguments) -> UserArguments:
    """The arguments with a whole number of bits in the store, which both sides make of it."""
    return dict(arguments) | ({"storageInit": int(arguments["storageInit"])} if "storageInit" in arguments else {})


def environment(problem: Problem, start: Start, satellite: object, scenario: object, rewarder: object) -> SatelliteTasking:
    """The environment with every initial condition pinned; ValueError if one would still be drawn."""
    env = SatelliteTasking(
        satellite=satellite,
        scenario=scenario,
        rewarder=rewarder,
        time_limit=start.time_limit,
        world_args=start.world_args,
        log_level="ERROR",
        **problem.settings,
    )
    arguments = env.satellite.sat_args_generator | env.world_args_generator
    if random := sorted(name for name, value in arguments.items() if callable(value) and name != "utc_init"):
        raise ValueError(f"bsk_rl would draw {random}, which bsk_torch has not")
    return env


class GivenTargets(scene.UniformTargets):
    """Targets at positions [T, 3] m with priorities [T], named by their number."""

    def __init__(self, r_LP_P: Array, priority: Array) -> None:
        """Ask for these targets."""
        super().__init__(len(priority))
        self.rows = [Target(str(k), r_LP_P[k], float(priority[k])) for k in range(len(priority))]

    def regenerate_targets(self) -> None:
        """Called at reset."""
        self.targets = self.rows


class TargetDensity(obs.Observation):
    """Sums of the priorities of the targets whose next window closes in each of the next intervals, as AEOSPower-v1 sees them."""

    def get_obs(self) -> Array:
        """Called after a step."""
        now, sums = self.simulator.sim_time, np.zeros(BINS + 1)
        for target, (_, close) in self.satellite.next_opportunities_dict(types="target").items():
            sums[min(int((close - now) / BIN), BINS)] += target.priority
        return sums[:BINS] / CROWD


def entries(properties: tuple[dict[str, Any], ...]) -> list[dict[str, Any]]:
    """Copies of properties, which are written into."""
    return [dict(entry) for entry in properties]


MODES = "action_charge", "action_downlink", "action_desat"
"""Actions of AEOSPower-v1 other than images."""


def imaging(problem: Problem, start: Start) -> SatelliteTasking:
    """AEOS-v1 and AEOSCity-v1, or AEOSPower-v1 where the satellite may do more than image."""
    powered, candidates = MODES[0] in problem.actions, sum(name not in MODES for name in problem.actions)
    properties = entries(SATELLITE + (RESOURCES if powered else ()))
    targets = obs.OpportunityProperties(*entries(TARGET), type="target", n_ahead_observe=candidates)
    modes = [act.Charge(duration=60.0), act.Downlink(duration=60.0), act.Desat(duration=60.0)]
    attributes = {
        "observation_spec": [
            obs.SatProperties(*properties),
            targets,
            *((TargetDensity("density"), next_station(), obs.Eclipse(norm=ORBIT)) if powered else ()),
            obs.Time(),
        ],
        "action_spec": [*(modes if powered else ()), act.Image(n_ahead_image=candidates)],
        "dyn_type": dyn.GroundStationDynModel if powered else dyn.ImagingDynModel,
        "fsw_type": fsw.SteeringImagerFSWModel,
    }
    satellite = type("Agile", (sats.ImagingSatellite,), attributes)("EO1", sat_args=bits(start.sat_args))
    if start.targets is None:
        raise ValueError(f"{problem.preset} needs targets; the episode of seed {start.seed} has none")
    return environment(problem, start, satellite, GivenTargets(*start.targets), data.UniqueImageReward())


BUILDERS: dict[str, Callable[[Problem, Start], SatelliteTasking]] = {
    "NadirScan-v1": nadir_scan,
    "AEOS-v1": imaging,
    "AEOSPower-v1": imaging,
    "AEOSCity-v1": imaging,
    "Areas-v1": areas,
}
"""Presets that can be flown, by name."""


def shield(satellite: Any, n_actions: int) -> NDArray[np.bool_]:
    """Legal actions [A] by the rule of AEOSPower-v1, from what is known; see :func:`bsk_torch.presets.aeos_power.shield`."""
    now = satellite.simulator.sim_time
    start, end = (time - now for time in satellite.trajectory.next_eclipse(now))
    reserve = RESERVE + max((end - start) - start, 0.0) / ORBIT
    only = np.arange(n_actions)
    if end >= start and satellite.dynamics.battery_charge_fraction < reserve:
        return only == CHARGE
    if np.abs(satellite.dynamics.wheel_speeds_fraction).max() > FAST:
        return only == DESAT
    return only >= 0


# -- flying -----------------------------------------------------------------------------------------------------------


def fly_there(problem: Problem, start: Start, pilot: Pilot, watch: Callable[[object], None] = lambda satellite: None) -> Flight:
    """The episode on Basilisk; ValueError if it observes, or may do, something else than bsk_torch.

    ``watch`` is called with the satellite at the start and after each decision.
    """
    env = BUILDERS[problem.preset](problem, start)
    observation, _ = env.reset(seed=0)
    satellite = env.satellite
    check_names("observations", problem.observed, satellite.observation_description)
    check_names("actions", problem.actions, satellite.action_description)
    steps: list[tuple[int, Array, float]] = []
    observations, begin, ended = [observation], env.simulator.sim_time, False
    watch(satellite)
    while not ended and len(steps) < LONGEST:
        action, said = pilot(seen_by(problem, satellite, observation), [start.seed], len(steps))
        observation, reward, terminated, truncated, _ = env.step(int(action[0]))
        observations.append(observation)
        steps.append((int(action[0]), said[0].numpy(), float(reward)))
        watch(satellite)
        ended = terminated or truncated
    actions, logits, rewards = (np.array(part) for part in zip(*steps, strict=True))
    dynamics, deaths = satellite.dynamics, causes(problem, satellite)
    penalty = problem.settings["failure_penalty"] if deaths else 0.0
    fill = float(getattr(dynamics, "storage_level_fraction", np.nan))
    seconds = round(env.simulator.sim_time - begin, 9)
    env.close()
    return Flight(start.seed, actions, np.array(observations), logits, rewards, seconds, penalty, deaths, fill)


def check_names(what: str, names: tuple[str, ...], reference: Iterable[object]) -> None:
    """ValueError for a difference between bsk_torch's names and bsk_rl's; the message has the first one."""
    for k, (name, counterpart) in enumerate(zip_longest(names, map(str, reference), fillvalue="none")):
        if name != counterpart:
            raise ValueError(f"{what} differ: number {k} is {name!r} in bsk_torch, and {counterpart!r} in bsk_rl")


def causes(problem: Problem, satellite: Any) -> tuple[str, ...]:
    """Aliveness checks that fail now; empty for a satellite that lives."""
    if satellite.is_alive():
        return ()
    failed = [name for name in problem.checks if hasattr(satellite.dynamics, name) and not getattr(satellite.dynamics, name)()]
    return tuple(failed) or ("unknown",)


def seen_by(problem: Problem, satellite: object, observation: Array) -> TensorDict:
    """Return the observation and the action mask of the policy."""
    n = len(problem.actions)
    mask = torch.as_tensor(shield(satellite, n) if problem.shielded else np.ones(n, dtype=bool)).unsqueeze(0)
    return TensorDict({"observation": torch.as_tensor(observation).unsqueeze(0), "action_mask": mask}, [1])
