"""Repeat episodes of ``bsk-torch risk --save`` on Basilisk, driven through bsk_rl, with the saved actions.

    bsk-torch risk pretrained --preset NadirScan-v1 --time-limit 5700 --save deaths.json
    python scripts/validation/refly_on_basilisk.py deaths.json --out flights.json

What was drawn for an episode is handed to bsk_rl as fixed arguments. bsk_torch flies the episode again by the rules of bsk_rl
(``compat="bsk_rl"``), and Basilisk with the same actions. The extra ``basilisk`` is needed; see ``fly_on_basilisk.py``.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import bsk_torch
from bsk_torch.env import SatelliteTasking
from bsk_torch.files import write_file
from bsk_torch.lab.basilisk.certificate import flown_there
from bsk_torch.lab.basilisk.flight import FLOWN, Flight, fly_here, lacking, problem_of, replay_pilot
from bsk_torch.lab.risk.rare_flights import read_paths
from bsk_torch.rand import blended


def flown(path: Path) -> list[tuple[Flight, Flight]]:
    """Return the flights of each episode of a file here and on Basilisk; ValueError for what cannot be flown there."""
    content, blend = read_paths(path)
    preset, episodes = content["preset"], content["episodes"]
    if preset not in FLOWN:
        raise ValueError(f"preset {preset!r} cannot be flown on Basilisk; {', '.join(FLOWN)} can")
    known = {episode["seed"]: np.array([action for (action,) in episode["actions"]]) for episode in episodes}
    with blended(blend):
        n = len(known)
        env = bsk_torch.make(preset, num_envs=n, env_ids=[0] * n, dtype=torch.float64, compat="bsk_rl", **content["options"])
        assert isinstance(env, SatelliteTasking)
        starts, here = fly_here(env, replay_pilot(known), list(known))
    there = flown_there(problem_of(env, preset), starts, replay_pilot(known))
    return list(zip(here, there, strict=True))


def figures(path: Path, flights: Sequence[tuple[Flight, Flight]]) -> list[dict[str, Any]]:
    """Return what both sides say of each episode, next to what the file says."""
    found = []
    for episode, (here, there) in zip(read_paths(path)[0]["episodes"], flights, strict=True):
        steps = min(len(here.observations), len(there.observations))
        row = {
            "seed": here.seed,
            "event_after": episode["time"],
            "seconds": [here.seconds, there.seconds],
            "deaths": [list(here.deaths), list(there.deaths)],
            "returns": [episode["return"], here.returns, there.returns],
            "largest_difference": float(np.abs(here.observations[:steps] - there.observations[:steps]).max()),
        }
        found.append(row)
    return found


def told(row: dict[str, Any]) -> str:
    """Return the lines of an episode."""
    sides = (
        f"  {side:<10} {', '.join(deaths) or 'survives'} after {seconds:.0f} s, return {total:.6f}"
        for side, deaths, seconds, total in zip(
            ("bsk_torch", "Basilisk"), row["deaths"], row["seconds"], row["returns"][1:], strict=True
        )
    )
    return "\n".join([f"seed {row['seed']}: observations differ by at most {row['largest_difference']:.1e}", *sides])


def main() -> None:
    """Fly and print; end with a message where something is missing or wrong."""
    parser = argparse.ArgumentParser(description="Repeat saved episodes on Basilisk.")
    parser.add_argument("paths", type=Path, metavar="FILE", help="file written by 'bsk-torch risk --save'")
    parser.add_argument("--out", type=Path, metavar="FILE", help="JSON file for the results")
    options = parser.parse_args()
    torch.set_num_threads(1)
    if missing := lacking():
        sys.exit(missing)
    try:
        rows = figures(options.paths, flown(options.paths))
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    print("\n".join(map(told, rows)))
    if options.out is not None:
        write_file(options.out, json.dumps({"file": options.paths.name, "episodes": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
