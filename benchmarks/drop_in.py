"""Measure the CPU time of a program of bsk_rl, by the package that it imports: ``bsk_rl`` on Basilisk, or ``bsk_torch.bsk_rl``.

Examples:
    python benchmarks/drop_in.py --package bsk_torch.bsk_rl
    python benchmarks/drop_in.py --package bsk_rl            # in an environment with the extra basilisk

Each program plays whole episodes with random actions under the same seeds; the first, which compiles, does not count.
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


PROGRAMS: dict[str, Callable[[Any, float], Any]] = {"scanning": scanning, "imaging": imaging}


def episode(env: Any, seed: int) -> tuple[float, float, int]:
    """Play an episode; return the CPU time of its reset and of its steps, s, and the number of steps."""
    rng, begin = np.random.default_rng(seed), time.process_time()
    env.reset(seed=seed)
    middle, steps, over = time.process_time(), 0, False
    while not over:
        _, _, terminated, truncated, _ = env.step(int(rng.integers(env.action_space.n)))
        steps, over = steps + 1, terminated or truncated
    return middle - begin, time.process_time() - middle, steps


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--package", choices=("bsk_rl", "bsk_torch.bsk_rl"), default="bsk_torch.bsk_rl")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--limit", type=float, default=5700.0, help="length of episodes, s")
    options = parser.parse_args()
    for name, make in PROGRAMS.items():
        env = make(load(options.package), options.limit)
        episode(env, 0)
        each = [episode(env, seed) for seed in range(1, 1 + options.episodes)]
        whole = [reset + steps for reset, steps, _ in each]
        print(
            f"{name} {options.package}: {statistics.median(whole):.3f} s per episode, of which reset "
            f"{statistics.median(reset for reset, _, _ in each):.3f}; {sum(n for *_, n in each) / len(each):.1f} steps"
        )


if __name__ == "__main__":
    main()
