"""How much energy and storage is there for each image in AEOSPower-v1: could they lower the bound of imaging?

Usage:
    python benchmarks/resources.py [--episodes 256] [--seed 1000003] [--time-limit 17100] [--out FILE.json]

Energy that an episode offers at most, with the panel towards the Sun whenever there is any, less what its wheels draw in any
case; data that the store holds and that passes over stations can send; beside what images need at least.
"""

from __future__ import annotations

from typing import Any

import harness
import torch
from torch import Tensor

import bsk_torch
from bsk_torch.lab.bounds.windows import openings, sunlight

PRESET = "AEOSPower-v1"

SAMPLES = 10
"""Ticks between the times at which sunlight is computed."""

COLUMNS = {"quantity of an episode": "{name}", "least": "{least:,.4g}", "mean": "{mean:,.4g}", "largest": "{largest:,.4g}"}


def quantities(env: Any) -> dict[str, Tensor]:
    """Return quantities of the episodes by name, [N] each."""
    satellite, simulator, args, limit = env.satellite, env.simulator, env.satellite.sat_args, env.state.limit_ticks
    h, rows, seconds = simulator.h, torch.arange(len(limit)), limit.double() * simulator.h
    every = openings(satellite, limit)
    seen = torch.zeros(len(limit), env.scenario.most_targets, dtype=torch.bool)
    seen[every.row, every.target] = True
    opens, closes = satellite.find_windows(seconds, "ground_station")[:2]
    passes = torch.where(torch.isfinite(closes), torch.minimum(closes, seconds.unsqueeze(1)) - opens, 0.0).sum(1)
    ticks = torch.arange(1, int(limit.max()) + 1, SAMPLES, dtype=torch.float64)
    lit, flux = sunlight(env, rows, ticks)
    gained = (lit * flux).mean(1) * seconds * args["panelArea"] * args["panelEfficiency"]
    load = args["wheelSpeeds"].shape[-1] * args["rwBasePower"] - args["basePowerDraw"]
    targets, start, image = seen.sum(1).double(), args["storedCharge_Init"], args["instrumentBaudRate"]
    surplus = start + gained - load * seconds
    return {
        "targets in view": targets,
        "charge at the start, kJ": start / 1e3,
        "sunlight on a panel towards the Sun, kJ": gained / 1e3,
        "base load, kJ": load * seconds / 1e3,
        "the rest for each target in view, kJ": surplus / targets.clamp(min=1.0) / 1e3,
        "least energy of an image, kJ": -args["instrumentPowerDraw"] * 2 * h / 1e3,
        "seconds without any sunlight until the battery is empty": start / load,
        "images that the store holds": args["dataStorageCapacity"] / image,
        "images that passes over stations can send": -args["transmitterBaudRate"] * passes / image,
    }


def main() -> None:
    """Compute, and print a table."""
    arguments = harness.parser(__doc__, episodes=256, seed=1_000_003, time_limit=17_100.0, backend="compiled")
    options, described = harness.begin(arguments)
    env: Any = bsk_torch.make(PRESET, num_envs=options.episodes, time_limit=options.time_limit, backend=options.backend)
    env.set_seed(options.seed)
    env.reset()
    rows: list[dict[str, Any]] = []
    for name, value in quantities(env).items():
        rows.append(dict(name=name, least=float(value.min()), mean=float(value.double().mean()), largest=float(value.max())))
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
