"""Basilisk's side of vs_basilisk.py: the environments of three presets in bsk_rl, random actions, resets included.

Usage:
    python benchmarks/basilisk_side.py NadirScan-v1 '{}'
    python benchmarks/basilisk_side.py AEOS-v1 '{"n_targets": 1000}'

Runs in an interpreter that has bsk and bsk_rl but need not have torch. For every line of input, a number of seconds, it plays
that long, until an episode ends, and answers with a line of JSON: simulated seconds, ended episodes, decisions, steps, and
seconds of all cores and of the wall clock. Basilisk runs in a thread of its own, so only the time of the whole process counts
its work.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "basilisk" / "recorders"))

from bsk_rl import ConstellationTasking, act, comm, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from bsk_rl.utils.orbital import random_orbit, walker_delta_args
from record_basilisk import BATTERY, EPISODE, FIXED, PAPER_MODES, STORAGE, paper_observations, scanner_class

Step = tuple[float, bool]
"""Simulated seconds of a step, and whether an episode ended with it."""

SHARED: dict[str, Any] = dict(time_limit=EPISODE, terminate_on_time_limit=True, log_level="ERROR", disable_env_checker=True)
"""What both environments are made with."""


# -- scanning ---------------------------------------------------------------------------------------------------------

DRAWN: dict[str, Any] = {
    "storageInit": lambda: int(np.random.uniform(0.0, 0.8) * STORAGE),
    "storedCharge_Init": lambda: np.random.uniform(0.3, 1.0) * BATTERY,
    "disturbance_vector": lambda: np.random.normal(scale=1e-4, size=3),
    "wheelSpeeds": lambda: np.random.uniform(-3000.0, 3000.0, 3),
}
"""What bsk_rl draws at every reset as the preset does; orbit, attitude and epoch are random by default."""


def nadir_scan() -> gym.Env:
    """The paper's environment with random episodes."""
    satellite = scanner_class(PAPER_MODES, paper_observations())("Scanner1", sat_args=FIXED | DRAWN)
    return gym.make(
        "SatelliteTasking-v1",
        satellite=satellite,
        scenario=scene.UniformNadirScanning(value_per_second=1 / EPISODE),
        rewarder=data.ScanningTimeReward(),
        failure_penalty=-1.0,
        **SHARED,
    )


# -- imaging ----------------------------------------------------------------------------------------------------------

ALTITUDE, EARTH_RADIUS, SOON, AHEAD = 800e3, 6378136.6, 300.0, 32

AGILE: dict[str, Any] = {
    "oe": lambda: random_orbit(a=(6371e3 + ALTITUDE) / 1e3, i=45.0),
    "imageTargetMinimumElevation": math.atan(ALTITUDE / 500e3),
    "imageAttErrorRequirement": 0.01,
    "imageRateErrorRequirement": 0.01,
    "u_max": 0.4,
    "omega_max": math.radians(5.0),
    "servo_P": 30.0,
    "batteryStorageCapacity": 100 * 80.0 * 3600.0,
    "storedCharge_Init": 100 * 80.0 * 3600.0,
    "dataStorageCapacity": 100 * 20 * 8e6,
}
"""The preset's arguments; the rest is random by default."""


def targets_ahead(count: int) -> obs.OpportunityProperties:
    """Observation of the next targets; bsk_rl writes into the dictionaries, so every satellite needs its own."""
    return obs.OpportunityProperties(
        dict(prop="priority"),
        dict(prop="r_LB_H", norm=ALTITUDE),
        dict(prop="target_angle", norm=math.pi),
        dict(prop="target_angle_rate", norm=0.03),
        dict(prop="opportunity_open", norm=SOON),
        dict(prop="opportunity_close", norm=SOON),
        type="target",
        n_ahead_observe=count,
    )


class AgileSatellite(sats.ImagingSatellite):
    """Sees the next 32 targets and images one of them."""

    observation_spec = (
        obs.SatProperties(
            dict(prop="omega_BH_H", norm=0.03),
            dict(prop="c_hat_H"),
            dict(prop="r_BN_P", norm=EARTH_RADIUS),
            dict(prop="v_BN_P", norm=7616.5),
        ),
        targets_ahead(AHEAD),
        obs.Time(),
    )
    action_spec = (act.Image(n_ahead_image=AHEAD),)
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.SteeringImagerFSWModel


def aeos(n_targets: int) -> gym.Env:
    """Agile imaging of so many targets with random episodes."""
    return gym.make(
        "SatelliteTasking-v1",
        satellite=AgileSatellite("EO1", sat_args=AGILE),
        scenario=scene.UniformTargets(n_targets),
        rewarder=data.UniqueImageReward(),
        sim_rate=0.5,
        max_step_duration=SOON,
        failure_penalty=0.0,
        **SHARED,
    )


# -- constellations -----------------------------------------------------------------------------------------------------


class LinkedImager(AgileSatellite):
    """Sees the next 16 targets and images one of them."""

    observation_spec = (
        AgileSatellite.observation_spec[0],
        targets_ahead(16),
        obs.Time(),
    )
    action_spec = (act.Image(n_ahead_image=16),)


def constellation(satellites: int, targets: int, interval: float | None) -> Any:
    """A plane of imagers, tasked once in ``interval`` seconds, or when they have done what they were told if None."""
    arguments = {name: value for name, value in AGILE.items() if name != "oe"} | dict(K1=0.5, K3=3.0, servo_Ki=5.0)
    return ConstellationTasking(
        satellites=[LinkedImager(f"EO{k}", arguments, variable_interval=interval is None) for k in range(satellites)],
        scenario=scene.UniformTargets(targets),
        rewarder=data.UniqueImageReward(),
        communicator=comm.FreeCommunication(),
        sat_arg_randomizer=walker_delta_args(n_planes=1, altitude=ALTITUDE / 1e3, inc=45.0),
        max_step_duration=SOON if interval is None else interval,
        time_limit=EPISODE,
        failure_penalty=0.0,
        log_level="ERROR",
    )


def constellation_episodes(env: Any) -> Iterator[Step]:
    """Play on for ever; a step's simulated seconds are those of all satellites, and every step may end a turn."""
    rng = np.random.default_rng(0)
    infos = env.reset(seed=0)[1]
    while True:
        idle = [agent for agent in env.agents if infos[agent]["requires_retasking"]]
        infos = env.step({agent: int(rng.integers(16)) for agent in idle})[4]
        seconds = float(infos["__common__"]["d_ts"]) * len(env.satellites)
        if not env.agents:
            infos = env.reset()[1]
        yield seconds, True


# -- playing ----------------------------------------------------------------------------------------------------------

PRESETS: dict[str, Callable[..., Any]] = {"NadirScan-v1": nadir_scan, "AEOS-v1": aeos, "Constellation-v1": constellation}


def episodes(env: gym.Env) -> Iterator[Step]:
    """Play on for ever."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    while True:
        _, _, terminated, truncated, info = env.step(int(rng.integers(env.action_space.n)))
        if terminated or truncated:
            env.reset()
        yield float(info["d_ts"]), terminated or truncated


def play(player: Iterator[Step], seconds: float) -> dict[str, float]:
    """A turn of ``seconds`` of the wall clock and until an episode ends; the entries are those of ``Turn`` in harness.py."""
    steps: list[Step] = []
    cpu, wall = time.process_time(), time.perf_counter()
    while time.perf_counter() - wall < seconds or not steps[-1][1]:
        steps.append(next(player))
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    simulated, ended, count = sum(step[0] for step in steps), sum(step[1] for step in steps), len(steps)
    return {"simulated": simulated, "ended": ended, "decisions": count, "steps": count, "cpu": cpu, "wall": wall}


def main() -> None:
    """Answer until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Basilisk talks
    env = PRESETS[sys.argv[1]](**json.loads(sys.argv[2]))
    player = constellation_episodes(env) if sys.argv[1] == "Constellation-v1" else episodes(env)
    next(player)
    for line in sys.stdin:
        print(json.dumps(play(player, float(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
