"""
Getting started
===============

A satellite that scans the ground for a minute or charges for ten, for one orbit.

On the command line::

    python examples/bsk_rl/simple_environment.py --num-envs 4

The problem of bsk_rl's page "Getting Started". Comments mark lines that differ from it.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/NadirScan-v1.png"

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch

from bsk_torch import (  # bsk_rl: from bsk_rl import act, data, obs, scene, sats
    SatelliteTasking,
    act,
    data,
    obs,
    rand,
    sats,
    scene,
)
from bsk_torch.sim import dyn, fsw  # bsk_rl: from bsk_rl.sim import dyn, fsw


class MyScanningSatellite(sats.AccessSatellite):
    """Observes its data buffer, its battery and the next eclipse."""

    observation_spec = [
        obs.SatProperties(
            dict(prop="storage_level_fraction"), dict(prop="battery_charge_fraction")
        ),
        obs.Eclipse(),
    ]
    action_spec = [act.Scan(duration=60.0), act.Charge(duration=600.0)]
    dyn_type = dyn.ContinuousImagingDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


def make(
    num_envs: int = 1, sat_args: dict[str, Any] | None = None, **options: Any
) -> SatelliteTasking:
    """Return ``num_envs`` episodes of the problem; ``sat_args`` and ``options`` replace its own."""
    arguments = dict(
        imageAttErrorRequirement=0.05,
        dataStorageCapacity=1e10,
        instrumentBaudRate=1e7,
        storedCharge_Init=50000.0,
        # bsk_rl: lambda: np.random.uniform(0.25, 0.75) * 1e10
        storageInit=rand.Uniform(0.25e10, 0.75e10),
    )
    defaults = dict(
        scenario=scene.UniformNadirScanning(),
        rewarder=data.ScanningTimeReward(),
        time_limit=5700.0,  # about one orbit
    )
    return SatelliteTasking(  # bsk_rl: gym.make("SatelliteTasking-v1", ...
        satellite=MyScanningSatellite(
            name="EO1", sat_args=arguments | (sat_args or {})
        ),
        num_envs=num_envs,  # bsk_rl: one episode
        **(defaults | options),
    )


def main() -> None:
    """Scan three times, then charge until the time limit."""
    parser = argparse.ArgumentParser(description="Scan, then charge.")
    parser.add_argument("--num-envs", type=int, default=4, help="episodes at once")
    parser.add_argument(
        "--time-limit", type=float, default=5700.0, help="length of an episode, s"
    )
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of the first episode at the end; needs the extra viz",
    )
    options = parser.parse_args()
    env = make(
        options.num_envs, time_limit=options.time_limit, backend=options.backend, seed=1
    )
    scan, charge = (torch.full((options.num_envs,), action) for action in (0, 1))
    td = env.reset()  # bsk_rl: observation, info = env.reset(seed=1)
    print("store, before:", td["observation"][:, 0])
    for _ in range(3):
        td = env.step(td.set("action", scan))["next"]  # bsk_rl: env.step(action=0)
        print("reward:", td["reward"].squeeze(1))
    print("store, after:", td["observation"][:, 0])
    while not td["truncated"].all():
        td = env.step(td.set("action", charge))["next"]
        print(
            f"{float(env.simulator.sim_time[0]):6.0f} s, charge:",
            td["observation"][:, 1],
        )
    if options.figure is not None:
        from PIL import Image

        Image.fromarray(env.render(rows=0).numpy()).save(options.figure)


if __name__ == "__main__":
    main()
