"""Satellite-seconds per core-second of AEOS-Bench, by satellites and tasks, here and on Basilisk.

Usage:
    python benchmarks/aeos_speed.py [--basilisk PYTHON] [--sizes 8x50 40x250] [--rows 2048] [--turns 3] [--steps 1 30]
        [--seconds 5] [--plot FILE.png] [--out FILE.json]

``--rows`` satellites fly at once, in rows / satellites episodes, under the benchmark's greedy rule; ``--steps`` are the seconds
for which choices hold: 1 as in the benchmark. Rates include the rule and the resets of a turn, which lasts for ``--seconds``.
``PYTHON`` is an interpreter with Basilisk, which flies one episode under the same rule, with the modules of this project's
recordings. All take turns; figures are medians, and ratios those of the same turn. The plot shows the rate here by the number of
satellites.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
from pathlib import Path
from typing import Any

import harness
import torch
from harness import Player, Step

import bsk_torch
from bsk_torch.rl.policies.shared_policy import rule

SIDE = Path(__file__).with_name("aeos_speed_side.py")

FLOWN = 20
"""Seconds of flight that Basilisk is measured for."""

COLUMNS = {
    "satellites": "{satellites}",
    "tasks": "{tasks}",
    "episodes": "{batch}",
    "seconds per choice": "{step:g}",
    "satellite-s per core-s": "{rate:,.0f}",
    "Basilisk": "{basilisk_rate:,.0f}",
    "x Basilisk": "{ratio:,.0f} ({low:,.0f} to {high:,.0f})",
}


def rollout(satellites: int, tasks: int, step: float, rows: int, backend: str) -> Player:
    """Fly the rule; a step's simulated seconds are those of all satellites."""
    batch = max(1, rows // satellites)
    env = bsk_torch.make(
        "AEOSBench-v1",
        num_envs=batch,
        seed=0,
        satellites=satellites,
        tasks=tasks,
        sensor="on",
        step_duration=step,
        backend=backend,
    )
    greedy, td = rule("nearest_task", env), env.reset()
    while True:
        with torch.no_grad():
            played, td = env.step_and_maybe_reset(greedy(td))
        seen = harness.step_of(played["next"])
        yield Step(seen.simulated * satellites, seen.ended, batch * satellites)


def on_basilisk(options: argparse.Namespace, satellites: int, tasks: int) -> float:
    """Return the rate on Basilisk, with one thread as here."""
    command = [options.basilisk, str(SIDE), "--satellites", str(satellites), "--tasks", str(tasks), "--seconds", str(FLOWN)]
    one = os.environ | {"OMP_NUM_THREADS": "1"}
    return float(subprocess.run(command, check=True, capture_output=True, text=True, env=one).stdout.split()[-1])


def size(text: str) -> tuple[int, int]:
    """Parse satellites and tasks, such as ``8x50``."""
    satellites, _, tasks = text.partition("x")
    if not (satellites.isdigit() and tasks.isdigit()):
        raise SystemExit(f"--sizes {text}: write satellites x tasks, such as 8x50")
    return int(satellites), int(tasks)


def plot(rows: list[dict[str, Any]], path: str) -> None:
    """Draw the rates by satellites, a line for each number of tasks and length of choices."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.0, 3.2), layout="constrained")
    for tasks, step in sorted({(row["tasks"], row["step"]) for row in rows}):
        mine = sorted((row["satellites"], row["rate"]) for row in rows if (row["tasks"], row["step"]) == (tasks, step))
        axes.plot(*zip(*mine, strict=True), marker="o", label=f"{tasks} tasks, {step:g} s per choice")
    axes.set(xlabel="satellites in an episode", ylabel="satellite-seconds per core-second", xscale="log", yscale="log")
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, turns=3, seconds=5.0, rows=2048, steps=[1.0, 30.0])
    arguments.add_argument("--sizes", nargs="+", default=["8x50", "40x250"], help="satellites x tasks")
    arguments.add_argument("--basilisk", metavar="PYTHON", help="interpreter with Basilisk")
    arguments.add_argument("--plot", metavar="FILE", help="picture of the rates")
    arguments.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(arguments)
    players, sizes = {}, [size(text) for text in options.sizes]
    for satellites, tasks in sizes:
        for step in options.steps:
            made = (satellites, tasks, step)
            players[made], _ = harness.start(lambda made=made: rollout(*made, options.rows, options.backend), 2)
    turns: dict[tuple[int, int, float], list[tuple[float, float]]] = {made: [] for made in players}
    for _ in range(options.turns):
        for satellites, tasks in sizes:
            theirs = on_basilisk(options, satellites, tasks) if options.basilisk else float("nan")
            for step in options.steps:
                made = (satellites, tasks, step)
                turns[made].append((harness.play(players[made], options.seconds).rate, theirs))
                print(f"{satellites} x {tasks}, {step:g} s: {turns[made][-1][0]:,.0f}", flush=True)
    rows = []
    for (satellites, tasks, step), pairs in turns.items():
        ours, theirs, ratios = zip(*[(a, b, a / b) for a, b in pairs], strict=True)
        medians = {name: statistics.median(part) for name, part in (("rate", ours), ("basilisk_rate", theirs), ("ratio", ratios))}
        spread = {"low": min(ratios), "high": max(ratios)}
        batch = max(1, options.rows // satellites)
        rows.append(dict(satellites=satellites, tasks=tasks, batch=batch, step=step, turns=pairs, **medians, **spread))
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)
    if options.plot:
        plot(rows, options.plot)


if __name__ == "__main__":
    main()
