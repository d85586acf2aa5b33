"""Measure the CPU time of programs of bsk_rl, by the package that they import: ``bsk_rl`` on Basilisk, or ``bsk_torch.bsk_rl``.

Examples:
    python benchmarks/drop_in.py                             # both in turns, in an environment with the extra basilisk
    python benchmarks/drop_in.py --package bsk_torch.bsk_rl

Each program plays episodes with random actions under the same seeds; the first, which compiles, does not count. Its shapes are
those of public programs: scanning with and without own properties, imaging with ten and with 32 observed opportunities, attitude
control in steps of one second, and two satellites that maneuver.
"""

from __future__ import annotations

import argparse
import importlib
import statistics
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np


def load(package: str) -> SimpleNamespace:
    """Return the modules of a package by name."""
    names = ("act", "data", "obs", "sats", "scene", "sim.dyn", "sim.fsw")
    modules = {name.rpartition(".")[2]: importlib.import_module(f"{package}.{name}") for name in names}
    return SimpleNamespace(root=importlib.import_module(package), **modules)


def scanning(b: Any, limit: float) -> Any:
    """Return the scanner of the paper's example, with steps of minutes."""

    class Scanner(b.sats.AccessSatellite):
        observation_spec = (
            b.obs.SatProperties(
                dict(prop="storage_level_fraction"),
                dict(prop="battery_charge_fraction"),
                dict(prop="wheel_speeds_fraction"),
            ),
            b.obs.Eclipse(norm=5700.0),
            b.obs.OpportunityProperties(dict(prop="opportunity_open", norm=5700.0), type="ground_station", n_ahead_observe=1),
        )
        action_spec = (
            b.act.Scan(duration=180.0),
            b.act.Charge(duration=120.0),
            b.act.Downlink(duration=120.0),
            b.act.Desat(duration=60.0),
        )
        dyn_type = (b.dyn.ContinuousImagingDynModel, b.dyn.GroundStationDynModel)
        fsw_type = b.fsw.ContinuousImagingFSWModel

    return b.root.SatelliteTasking(
        Scanner("Scanner", dict(maxWheelSpeed=6000.0, dataStorageCapacity=1e10)),
        scenario=b.scene.UniformNadirScanning(),
        rewarder=b.data.ScanningTimeReward(),
        time_limit=limit,
    )


def imaging(b: Any, limit: float) -> Any:
    """Return an imager of 1,000 targets that observes ten of them."""

    class Imager(b.sats.ImagingSatellite):
        observation_spec = (
            b.obs.SatProperties(dict(prop="omega_BP_P", norm=0.03), dict(prop="c_hat_P"), dict(prop="r_BN_P", norm=7e6)),
            b.obs.OpportunityProperties(
                dict(prop="priority"),
                dict(prop="r_LP_P", norm=7e6),
                dict(prop="opportunity_open", norm=300.0),
                dict(prop="target_angle"),
                n_ahead_observe=10,
            ),
            b.obs.Time(),
        )
        action_spec = (b.act.Image(n_ahead_image=10),)
        fsw_type = b.fsw.ImagingFSWModel

    return b.root.SatelliteTasking(
        Imager("Imager", dict(imageAttErrorRequirement=0.05, imageRateErrorRequirement=0.05, u_max=0.5)),
        scenario=b.scene.UniformTargets(1000),
        rewarder=b.data.UniqueImageReward(),
        time_limit=limit,
    )


def properties(b: Any, limit: float) -> Any:
    """Return a scanner that observes properties of a custom model."""

    class Model(b.dyn.ContinuousImagingDynModel, b.dyn.GroundStationDynModel):
        @property
        def sun_angle(self) -> Any:
            world = self.world
            sun = np.array(world.gravFactory.spiceObject.planetStateOutMsgs[world.sun_index].read().PositionVector)
            return np.arccos((np.array(self.BN).T @ [0.0, 0.0, 1.0]) @ sun / np.linalg.norm(sun))

        @property
        def altitude(self) -> Any:
            return np.linalg.norm(self.r_BN_N) - 6378e3

    class Scanner(b.sats.AccessSatellite):
        observation_spec = (
            b.obs.SatProperties(dict(prop="storage_level_fraction"), dict(prop="sun_angle"), dict(prop="altitude", norm=1e6)),
            b.obs.Eclipse(norm=5700.0),
            b.obs.OpportunityProperties(dict(prop="opportunity_open", norm=5700.0), type="ground_station", n_ahead_observe=1),
            b.obs.Time(),
        )
        action_spec = (b.act.Scan(duration=180.0), b.act.Charge(duration=120.0), b.act.Downlink(duration=120.0))
        dyn_type, fsw_type = Model, b.fsw.ContinuousImagingFSWModel

    rewarder, scene = b.data.ScanningTimeReward(), b.scene.UniformNadirScanning()
    return b.root.SatelliteTasking(Scanner("Scanner"), scenario=scene, rewarder=rewarder, time_limit=limit)


def agile(b: Any, limit: float) -> Any:
    """Return an imager that observes 32 opportunities; most steps are short."""

    class Imager(b.sats.ImagingSatellite):
        observation_spec = (
            b.obs.OpportunityProperties(
                dict(prop="priority"), dict(prop="r_LB_H", norm=8e5), dict(prop="target_angle", norm=np.pi),
                dict(prop="target_angle_rate", norm=0.03), dict(prop="opportunity_open", norm=300.0), n_ahead_observe=32,
            ),
        )  # fmt: skip
        action_spec = (b.act.Image(n_ahead_image=2), *(b.act.Charge(name=f"charge_{k}", duration=10.0) for k in range(6)))
        fsw_type = b.fsw.SteeringImagerFSWModel

    gains = dict(servo_P=30.0, K1=0.17, servo_Ki=1.3)
    targets, rewarder = b.scene.UniformTargets(3000), b.data.UniqueImageReward()
    return b.root.SatelliteTasking(Imager("Imager", gains), scenario=targets, rewarder=rewarder, time_limit=0.2 * limit)


def attitude(b: Any, limit: float) -> Any:
    """Return a satellite that decides every second."""

    class Turner(b.sats.Satellite):
        observation_spec = (b.obs.SatProperties(dict(prop="sigma_BN"), dict(prop="omega_BN_B"), dict(prop="wheel_speeds")),)
        action_spec = (b.act.NadirPoint(duration=1.0), b.act.Charge(duration=1.0))
        dyn_type, fsw_type = b.dyn.BasicDynamicsModel, b.fsw.BasicFSWModel

    return b.root.SatelliteTasking(Turner("Turner"), time_limit=0.05 * limit)


def pair(b: Any, limit: float) -> Any:
    """Return two satellites that maneuver, commanded together."""

    class Deputy(b.sats.Satellite):
        observation_spec = (b.obs.SatProperties(dict(prop="r_BN_N", norm=7e6), dict(prop="v_BN_N", norm=7e3)), b.obs.Time())
        action_spec = (b.act.Drift(duration=10.0), b.act.NadirPoint(duration=10.0))
        dyn_type = (b.dyn.ConjunctionDynModel, b.dyn.BasicDynamicsModel)
        fsw_type = b.fsw.BasicFSWModel

    return b.root.GeneralSatelliteTasking([Deputy("A"), Deputy("B")], time_limit=0.2 * limit)


PROGRAMS: dict[str, Callable[[Any, float], Any]] = {
    "scanning": scanning,
    "scanning, own properties": properties,
    "imaging, 10 opportunities": imaging,
    "imaging, 32 opportunities": agile,
    "attitude, 1 s": attitude,
    "two satellites": pair,
}
PACKAGES = ("bsk_rl", "bsk_torch.bsk_rl")


def episode(env: Any, seed: int) -> tuple[float, float]:
    """Play an episode; return the CPU time of its reset and the median of its steps, s."""
    rng, begin = np.random.default_rng(seed), time.process_time()
    env.reset(seed=seed)
    reset, steps, over = time.process_time() - begin, [], False
    several = not hasattr(env.action_space, "n")
    while not over:
        action = [int(rng.integers(space.n)) for space in env.action_space] if several else int(rng.integers(env.action_space.n))
        begin = time.process_time()
        _, _, terminated, truncated, _ = env.step(action)
        steps.append(time.process_time() - begin)
        over = terminated or truncated
    return reset, statistics.median(steps)


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--package", choices=PACKAGES, action="append", help="package to measure; both in turns by default")
    parser.add_argument("--program", choices=PROGRAMS, action="append", help="program to measure; all by default")
    parser.add_argument("--episodes", type=int, default=5)
    parser.add_argument("--limit", type=float, default=5700.0, help="length of the longest episodes, s")
    options = parser.parse_args()
    packages = options.package or PACKAGES
    for name in options.program or PROGRAMS:
        make = PROGRAMS[name]
        envs = {package: make(load(package), options.limit) for package in packages}
        for env in envs.values():
            episode(env, 0)
        found: dict[str, list[tuple[float, float]]] = {package: [] for package in packages}
        for seed in range(1, 1 + options.episodes):
            for package, env in envs.items():
                found[package].append(episode(env, seed))
        resets, steps = ({p: statistics.median(each[k] for each in found[p]) for p in packages} for k in (0, 1))
        each = "; ".join(f"{p}: reset {1e3 * resets[p]:.1f} ms, step {1e3 * steps[p]:.2f} ms" for p in packages)
        ratio = f"; ratio of steps {steps[packages[0]] / steps[packages[1]]:.1f}" if len(packages) == 2 else ""
        print(f"{name}: {each}{ratio}", flush=True)


if __name__ == "__main__":
    main()
