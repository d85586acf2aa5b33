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

import argparse
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

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts" / "recorders"))

from Basilisk.simulation import reactionWheelStateEffector
from Basilisk.utilities import orbitalMotion, simIncludeRW
from bsk_rl import ConstellationTasking, act, comm, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from bsk_rl.utils.functional import default_args
from bsk_rl.utils.orbital import random_orbit, random_unit_vector, relative_to_chief, walker_delta_args
from bsk_rl.utils.rso_imaging import candidate_snapshot
from record_basilisk import BATTERY, EPISODE, FIXED, PAPER_MODES, STORAGE, ScannerDyn, paper_observations, scanner_class

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


def with_wheels(axes: list[list[float]]) -> type[dyn.DynamicsModel]:
    """Return the paper's dynamics model with HR16 wheels about other axes; bsk_rl has no argument for them."""

    class Wheels(ScannerDyn):
        @default_args(wheelSpeeds=lambda: np.random.uniform(-3000.0, 3000.0, len(axes)), maxWheelSpeed=np.inf, u_max=0.2)
        def setup_reaction_wheel_dyn_effector(
            self, wheelSpeeds: Any, maxWheelSpeed: float, u_max: float, priority: int = 997, **kwargs: Any
        ) -> None:
            self.maxWheelSpeed, self.rwFactory = maxWheelSpeed, simIncludeRW.rwFactory()
            self.rwStateEffector = reactionWheelStateEffector.ReactionWheelStateEffector()
            for axis, speed in zip(axes, wheelSpeeds, strict=True):
                self.rwFactory.create("Honeywell_HR16", axis, maxMomentum=50.0, Omega=speed).u_max = u_max
            self.rwFactory.addToSpacecraft(self.scObject.ModelTag, self.rwStateEffector, self.scObject)
            self.simulator.AddModelToTask(self.task_name, self.rwStateEffector, ModelPriority=priority)

    return Wheels


def nadir_scan(axes: list[list[float]] | None = None) -> gym.Env:
    """The paper's environment with random episodes, and with wheels about other ``axes`` than bsk_rl's three."""
    scanner, arguments = scanner_class(PAPER_MODES, paper_observations()), FIXED | DRAWN
    if axes is not None:
        scanner.dyn_type = with_wheels(axes)
        arguments = {name: value for name, value in arguments.items() if name != "wheelSpeeds"}
    satellite = scanner("Scanner1", sat_args=arguments)
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


# -- inspection --------------------------------------------------------------------------------------------------------

POINTS: dict[str, Any] = dict(
    n_points=100, radius=1.0, theta_max=math.radians(30), range_max=250.0, theta_solar_max=math.radians(60)
)
INSPECTOR: dict[str, Any] = dict(
    imageAttErrorRequirement=1.0,
    imageRateErrorRequirement=None,
    instrumentBaudRate=1,
    dataStorageCapacity=1e6,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
    conjunction_radius=2.0,
    dv_available_init=10.0,
    max_range_radius=1000,
    chief_name="RSO",
    enforce_range_on_chief=True,
)
KICK, DRIFT = 0.01, (100.0, 2000.0)
"""Standard deviation of each component of a random manoeuvre, m/s, and bounds of the drift after it, s."""


class Inspector(sats.Satellite):
    """Flies about another spacecraft by impulsive manoeuvres, and inspects it."""

    observation_spec = (
        obs.SatProperties(dict(prop="dv_available", norm=10)),
        obs.ResourceRewardWeight(),
        obs.RelativeProperties(
            dict(prop="r_DC_Hc", norm=500),
            dict(prop="v_DC_Hc", norm=5),
            dict(prop="rso_imaged_regions"),
            chief_name="RSO",
        ),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    )
    action_spec = (
        act.ImpulsiveThrustHill(chief_name="RSO", max_dv=1.0, max_drift_duration=11400.0, fsw_action="action_inspect_rso"),
    )
    dyn_type = (dyn.MaxRangeDynModel, dyn.ConjunctionDynModel, dyn.RSOInspectorDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.RSOInspectorFSWModel)


class Inspected(sats.Satellite):
    """Points along its orbit's frame."""

    observation_spec = (obs.SatProperties(dict(prop="one", fn=lambda _: 1.0)),)
    action_spec = (act.NadirPoint(duration=1e9),)
    dyn_type = (dyn.ConjunctionDynModel, dyn.RSODynModel)
    fsw_type = fsw.FSWModel


def around(satellites: list[sats.Satellite]) -> dict[Any, Any]:
    """Orbits of the inspected spacecraft, and of inspectors 250 to 750 m from it."""

    def orbit() -> Any:
        a = 6371.0 + np.random.uniform(500, 1100)
        return random_orbit(a=a, e=np.random.uniform(0.0, min(1 - 6871.0 / a, 7471.0 / a - 1)))

    def relative() -> Any:
        directions = [random_unit_vector() for _ in range(2)]
        return np.r_[directions[0] * np.random.uniform(250, 750), directions[1] * np.random.uniform(0, 0.5)]

    names = [satellite.name for satellite in satellites if satellite.name != "RSO"]
    return relative_to_chief("RSO", orbit, dict.fromkeys(names, relative))(satellites)


def rso_inspection(n_inspectors: int) -> Any:
    """bsk_rl's inspection of another spacecraft, by one or several."""
    return ConstellationTasking(
        satellites=[
            Inspected("RSO", dict(conjunction_radius=2.0)),
            *(Inspector(f"Inspector{k}", INSPECTOR) for k in range(1, n_inspectors + 1)),
        ],
        scenario=scene.SphericalRSO(**POINTS),
        rewarder=(
            data.RSOInspectionReward(completion_bonus=1.0),
            data.ResourceReward(reward_weight=0.1, resource_fn=lambda sat: getattr(sat.fsw, "dv_available", 0.0)),
        ),
        sat_arg_randomizer=around,
        sim_rate=5.0,
        time_limit=57000.0,
        failure_penalty=-1.0,
        log_level="ERROR",
    )


def inspection_episodes(env: Any) -> Iterator[Step]:
    """Play on for ever; a step's simulated seconds are those of an episode, and every step may end a turn."""
    rng = np.random.default_rng(0)
    infos, acted = env.reset(seed=0)[1], False
    while True:
        idle = [agent for agent in env.agents if infos[agent]["requires_retasking"] and agent != "RSO"]
        actions: dict[str, Any] = {agent: np.r_[rng.normal(0.0, KICK, 3), rng.uniform(*DRIFT)] for agent in idle}
        _, _, terminated, truncated, infos = env.step(actions if acted else {"RSO": 0, **actions})
        seconds, acted = float(infos["__common__"]["d_ts"]), True
        if any(terminated.values()) or any(truncated.values()):
            infos, acted = env.reset()[1], False
        yield seconds, True


# -- imaging in orbit --------------------------------------------------------------------------------------------------

EYE: dict[str, Any] = dict(
    imageAttErrorRequirement=0.02,
    instrumentBaudRate=8e6,
    dataStorageCapacity=1.6e8,
    batteryStorageCapacity=1e9,
    storedCharge_Init=1e9,
    u_max=0.4,
)
ORBIT = 5700.0
"""Length of an episode of imaging in orbit, s."""


class Eye(sats.AccessSatellite):
    """Images one of the next ten objects, downlinks, or charges."""

    observation_spec = (
        obs.SatProperties(dict(prop="storage_level_fraction")),
        obs.RSOTargetProperties(n_ahead_observe=10),
        obs.Time(),
    )
    action_spec = (
        act.Charge(duration=60.0),
        act.Downlink(duration=90.0),
        act.ImageRSO(10, max_duration=200.0, min_pointing_hold_s=5.0),
    )
    dyn_type = (dyn.SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = fsw.SpaceToSpaceImagingFSWModel


class Seen(sats.Satellite):
    """An object."""

    observation_spec, action_spec = (obs.Time(),), (act.Drift(duration=1e9),)
    dyn_type, fsw_type = dyn.RSOTargetDynModel, fsw.FSWModel


def state_of(elements: Any) -> tuple[Any, Any]:
    """Position, m, and velocity, m/s."""
    return orbitalMotion.elem2rv(orbitalMotion.MU_EARTH * 1e9, elements)


def rso_imaging(n_imagers: int, n_targets: int) -> Any:
    """Imagers and a catalog of objects in a plane above theirs, which stays the same for all episodes."""
    np.random.seed(0)
    objects = [state_of(random_orbit(a=7050.0, i=90.0, Omega=17.0)) for _ in range(n_targets)]
    targets = [scene.RSOTarget(f"rso-{k}", f"rso_{k}", *found, priority=np.random.rand()) for k, found in enumerate(objects)]
    names = [f"Eye{k}" for k in range(n_imagers)]
    arguments = EYE | {"oe": lambda: random_orbit(a=7000.0, i=90.0, Omega=17.0)}
    return ConstellationTasking(
        satellites=[*(Eye(name, arguments) for name in names), *(Seen(target.satellite_name) for target in targets)],
        scenario=scene.RSOTargets(scene.RSOTargetCatalog(tuple(targets)), names),
        rewarder=data.RSOImageReward(multi_imager_credit="shared"),
        time_limit=ORBIT,
        log_level="ERROR",
    )


def rso_imaging_episodes(env: Any) -> Iterator[Step]:
    """Play on for ever, with random candidates that exist; a turn ends with an episode."""
    rng = np.random.default_rng(0)
    infos, first = env.reset(seed=0)[1], True
    while True:
        actions = {agent: 0 for agent in env.agents if first and not agent.startswith("Eye")}
        for eye in (satellite for satellite in env.satellites if satellite.name.startswith("Eye")):
            if infos[eye.name]["requires_retasking"]:
                there = sum(one is not None for one in candidate_snapshot(eye, 10).targets)
                actions[eye.name] = int(rng.integers(2 + min(there, 10)))
        _, _, terminated, truncated, infos = env.step(actions)
        seconds, first = float(infos["__common__"]["d_ts"]), all(truncated.values()) or any(terminated.values())
        if first:
            infos = env.reset()[1]
        yield seconds, first


class Manoeuvring(sats.ImagingSatellite):
    """Changes its orbit in every step, and looks at the next targets."""

    observation_spec = (
        obs.SatProperties(dict(prop="dv_available", norm=1e4), dict(prop="r_BN_P", norm=EARTH_RADIUS)),
        obs.OpportunityProperties(
            dict(prop="priority"),
            dict(prop="opportunity_open", norm=SOON),
            dict(prop="opportunity_close", norm=SOON),
            n_ahead_observe=4,
        ),
        obs.Eclipse(norm=5700.0),
        obs.Time(),
    )
    action_spec = (act.ImpulsiveThrust(max_dv=60.0, max_drift_duration=600.0),)
    dyn_type = dyn.ImagingDynModel
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.ImagingFSWModel)


def manoeuvres(n_targets: int) -> gym.Env:
    """Manoeuvres by a satellite that looks at targets."""
    arguments = dict(
        oe=lambda: random_orbit(a=7000.0, i=45.0),
        dv_available_init=1e4,
        batteryStorageCapacity=1e9,
        storedCharge_Init=1e9,
        imageTargetMinimumElevation=math.radians(50.0),
    )
    return gym.make(
        "SatelliteTasking-v1",
        satellite=Manoeuvring("EO1", sat_args=arguments),
        scenario=scene.UniformTargets(n_targets),
        rewarder=data.UniqueImageReward(),
        **SHARED,
    )


def manoeuvring_episodes(env: gym.Env) -> Iterator[Step]:
    """Play on for ever, with random manoeuvres."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    while True:
        _, _, terminated, truncated, info = env.step(np.r_[rng.normal(0.0, 1.0, 3), rng.uniform(60.0, 300.0)])
        if terminated or truncated:
            env.reset()
        yield float(info["d_ts"]), terminated or truncated


# -- playing ----------------------------------------------------------------------------------------------------------

PRESETS: dict[str, Callable[..., Any]] = {
    "NadirScan-v1": nadir_scan,
    "AEOS-v1": aeos,
    "Constellation-v1": constellation,
    "RSOInspection-v1": rso_inspection,
    "rso_imaging": rso_imaging,
    "manoeuvres": manoeuvres,
}


def episodes(env: gym.Env) -> Iterator[Step]:
    """Play on for ever."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    while True:
        _, _, terminated, truncated, info = env.step(int(rng.integers(env.action_space.n)))
        if terminated or truncated:
            env.reset()
        yield float(info["d_ts"]), terminated or truncated


PLAYERS = {
    "Constellation-v1": constellation_episodes,
    "RSOInspection-v1": inspection_episodes,
    "rso_imaging": rso_imaging_episodes,
    "manoeuvres": manoeuvring_episodes,
}
"""Players of environments with several agents, or with actions of real numbers."""


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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("environment", choices=PRESETS)
    parser.add_argument("options", type=json.loads, help="arguments of the environment, JSON")
    given = parser.parse_args()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Basilisk talks
    env = PRESETS[given.environment](**given.options)
    player = PLAYERS.get(given.environment, episodes)(env)
    next(player)
    for line in sys.stdin:
        print(json.dumps(play(player, float(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
