"""Presets of bsk_torch as environments of bsk_rl, and flights of episodes there. Needs the extra ``basilisk``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "basilisk" / "recorders"))

from bsk_rl import act, data, obs, sats, scene
from bsk_rl.scene.targets import Target
from bsk_rl.sim import dyn, fsw
from flight import LONGEST, Array, Flight, Pilot, Problem, Start
from numpy.typing import NDArray
from record_basilisk import PAPER_MODES, paper_observations, scanner_class
from tensordict import TensorDict

from bsk_torch.presets.aeos import AHEAD, ORBIT, SATELLITE, TARGET
from bsk_torch.presets.aeos_power import BIN, BINS, CHARGE, CROWD, DESAT, FAST, RESERVE, RESOURCES

# -- presets ----------------------------------------------------------------------------------------------------------


def nadir_scan(problem: Problem, start: Start) -> gym.Env:
    """NadirScan-v1."""
    satellite = scanner_class(PAPER_MODES, paper_observations())("Scanner1", sat_args=bits(start.sat_args))
    return environment(problem, start, satellite, scene.UniformNadirScanning(**problem.scenario), data.ScanningTimeReward())


def bits(arguments: dict[str, Any]) -> dict[str, Any]:
    """The arguments with a whole number of bits in the store, which both sides make of it."""
    return arguments | ({"storageInit": int(arguments["storageInit"])} if "storageInit" in arguments else {})


def environment(problem: Problem, start: Start, satellite: Any, scenario: Any, rewarder: Any) -> gym.Env:
    """The environment with every initial condition pinned; ValueError where bsk_rl would still draw one."""
    env = gym.make(
        "SatelliteTasking-v1",
        satellite=satellite,
        scenario=scenario,
        rewarder=rewarder,
        time_limit=start.time_limit,
        world_args=start.world_args,
        log_level="ERROR",
        disable_env_checker=True,
        **problem.settings,
    )
    given = env.unwrapped.satellite.sat_args_generator | env.unwrapped.world_args_generator
    if drawn := sorted(name for name, value in given.items() if callable(value) and name != "utc_init"):
        raise ValueError(f"bsk_rl would draw {drawn}, which bsk_torch has not")
    return env


class GivenTargets(scene.UniformTargets):
    """Targets at positions [T, 3] m with priorities [T], named by their number."""

    def __init__(self, r_LP_P: Array, priority: Array) -> None:
        """Ask for these targets."""
        super().__init__(len(priority))
        self.rows = [Target(str(k), r_LP_P[k], float(priority[k])) for k in range(len(priority))]

    def regenerate_targets(self) -> None:
        """Called by bsk_rl at reset."""
        self.targets = self.rows


class TargetDensity(obs.Observation):
    """Sums of the priorities of the targets whose next window closes in each of the next intervals, as AEOSPower-v1 sees them."""

    def get_obs(self) -> Array:
        """Called by bsk_rl."""
        now, sums = self.simulator.sim_time, np.zeros(BINS + 1)
        for target, (_, close) in self.satellite.next_opportunities_dict(types="target").items():
            sums[min(int((close - now) / BIN), BINS)] += target.priority
        return sums[:BINS] / CROWD


def entries(properties: tuple[dict[str, Any], ...]) -> list[dict[str, Any]]:
    """Copies of properties: bsk_rl writes into them."""
    return [dict(entry) for entry in properties]


def imaging(problem: Problem, start: Start) -> gym.Env:
    """AEOS-v1, or AEOSPower-v1 where the satellite may do more than image."""
    powered = len(problem.actions) > AHEAD
    properties = entries(SATELLITE + (RESOURCES if powered else ()))
    targets = obs.OpportunityProperties(*entries(TARGET), type="target", n_ahead_observe=AHEAD)
    station = [dict(prop=name, norm=ORBIT) for name in ("opportunity_open", "opportunity_close")]
    seen = [TargetDensity("density"), obs.OpportunityProperties(*station, type="ground_station", n_ahead_observe=1)]
    modes = [act.Charge(duration=60.0), act.Downlink(duration=60.0), act.Desat(duration=60.0)]
    attributes = {
        "observation_spec": [
            obs.SatProperties(*properties),
            targets,
            *((*seen, obs.Eclipse(norm=ORBIT)) if powered else ()),
            obs.Time(),
        ],
        "action_spec": [*(modes if powered else ()), act.Image(n_ahead_image=AHEAD)],
        "dyn_type": dyn.GroundStationDynModel if powered else dyn.ImagingDynModel,
        "fsw_type": fsw.SteeringImagerFSWModel,
    }
    satellite = type("Agile", (sats.ImagingSatellite,), attributes)("EO1", sat_args=bits(start.sat_args))
    return environment(problem, start, satellite, GivenTargets(*start.targets), data.UniqueImageReward())


BUILDERS: dict[str, Callable[[Problem, Start], gym.Env]] = {
    "NadirScan-v1": nadir_scan,
    "AEOS-v1": imaging,
    "AEOSPower-v1": imaging,
}
"""Presets that can be flown, by name."""


def shield(satellite: Any, n_actions: int) -> NDArray[np.bool_]:
    """Legal actions [A] by the rule of AEOSPower-v1, from what bsk_rl knows; see :func:`bsk_torch.presets.aeos_power.shield`."""
    now = satellite.simulator.sim_time
    start, end = (time - now for time in satellite.trajectory.next_eclipse(now))
    needed = RESERVE + max((end - start) - start, 0.0) / ORBIT
    only = np.arange(n_actions)
    if end >= start and satellite.dynamics.battery_charge_fraction < needed:
        return only == CHARGE
    if np.abs(satellite.dynamics.wheel_speeds_fraction).max() > FAST:
        return only == DESAT
    return only >= 0


# -- flying -----------------------------------------------------------------------------------------------------------


def fly_there(problem: Problem, start: Start, pilot: Pilot) -> Flight:
    """The episode in bsk_rl; ValueError where it observes, or may do, something else than bsk_torch."""
    env: Any = BUILDERS[problem.preset](problem, start).unwrapped
    observation, _ = env.reset(seed=0)
    satellite = env.satellite
    check_names("observations", problem.observed, satellite.observation_description)
    check_names("actions", problem.actions, satellite.action_description)
    observations, steps, begin, ended = [observation], [], env.simulator.sim_time, False
    while not ended and len(steps) < LONGEST:
        action, logits = pilot(seen_by(problem, satellite, observation), [start.seed], len(steps))
        observation, reward, terminated, truncated, _ = env.step(int(action[0]))
        observations.append(observation)
        steps.append((int(action[0]), logits[0].numpy(), float(reward)))
        ended = terminated or truncated
    actions, logits, rewards = (np.array(part) for part in zip(*steps, strict=True))
    dynamics, deaths = satellite.dynamics, causes(problem, satellite)
    penalty = problem.settings["failure_penalty"] if deaths else 0.0
    fill = float(getattr(dynamics, "storage_level_fraction", np.nan))
    seconds = round(env.simulator.sim_time - begin, 9)
    env.close()
    return Flight(start.seed, actions, np.array(observations), logits, rewards, seconds, penalty, deaths, fill)


def check_names(what: str, here: tuple[str, ...], there: Any) -> None:
    """ValueError for a difference between bsk_torch's names and bsk_rl's."""
    if list(here) != [str(name) for name in there]:
        raise ValueError(f"{what} differ: bsk_torch has {list(here)}, bsk_rl {[str(name) for name in there]}")


def causes(problem: Problem, satellite: Any) -> tuple[str, ...]:
    """Aliveness checks that fail now; empty for a satellite that lives."""
    if satellite.is_alive():
        return ()
    failed = [name for name in problem.checks if hasattr(satellite.dynamics, name) and not getattr(satellite.dynamics, name)()]
    return tuple(failed) or ("unknown",)


def seen_by(problem: Problem, satellite: Any, observation: Array) -> TensorDict:
    """Return the observation and the action mask of the policy."""
    n = len(problem.actions)
    mask = torch.as_tensor(shield(satellite, n) if problem.shielded else np.ones(n, dtype=bool)).unsqueeze(0)
    return TensorDict({"observation": torch.as_tensor(observation).unsqueeze(0), "action_mask": mask}, [1])
