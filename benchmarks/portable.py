"""The price of results that are the same on other processors: CPU time with ``BSK_TORCH_PORTABLE``, relative to that without.

Usage:
    python benchmarks/portable.py [--tasks scan imaging-100 training] [--batch 1024] [--turns 5] [--steps 20] [--out FILE.json]

Two processes, one of them portable, take turns with one thread. A task is so many steps of the batch with random actions, or a
training of NadirScan-v1 for a tenth as many batches of 16 steps.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import harness
import torch

from bsk_torch._portable import SETTINGS, VARIABLE
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.trainer import Training

COLUMNS = {
    "task": "{task}",
    "native, CPU s": "{native:.2f}",
    "portable / native": "{ratio:.2f}",
    "range": "{low:.2f} to {high:.2f}",
}


def train(batch: int, batches: int) -> None:
    """Train, and drop the result."""
    config = PPOConfig(num_envs=batch, frames=16 * batch * batches, minibatch=min(2048, 16 * batch), evaluate_every=0)
    with TemporaryDirectory() as folder:
        Training(config, Path(folder) / "run").run(bar=False)


def serve(task: str, batch: int, steps: int) -> None:
    """Print the CPU time of a turn for each line of the input."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    player = None if task == "training" else harness.start(lambda: harness.rollout(harness.make_env(task, batch)), steps)[0]
    if player is None:
        train(batch, 1)  # it compiles
    for _ in sys.stdin:
        begin = time.process_time()
        if player is None:
            train(batch, max(1, steps // 10))
        else:
            for _ in range(steps):
                next(player)
        print(time.process_time() - begin, flush=True)


def measure(task: str, batch: int, steps: int, turns: int) -> dict[str, object]:
    """Return a row of the table."""
    command = [sys.executable, __file__, "--serve", task, "--batch", str(batch), "--steps", str(steps)]
    processes = [
        subprocess.Popen(command, env=os.environ | extra, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for extra in ({}, {VARIABLE: "1", **SETTINGS})
    ]
    spent: list[list[float]] = [[], []]
    for _ in range(turns):
        for process, seconds in zip(processes, spent, strict=True):
            print(file=process.stdin, flush=True)
            seconds.append(float(process.stdout.readline()))
    for process in processes:
        process.communicate()
    ratios = sorted(portable / native for native, portable in zip(*spent, strict=True))
    middle = {"native": statistics.median(spent[0]), "ratio": statistics.median(ratios)}
    return {"task": task, **middle, "low": ratios[0], "high": ratios[-1], "turns": spent}


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, batch=1024, turns=5, steps=20)
    arguments.add_argument("--tasks", nargs="+", default=["scan", "imaging-100", "training"])
    arguments.add_argument("--serve", metavar="TASK", help="measure a task in this process, as the others are told to")
    options, described = harness.begin(arguments)
    if options.serve:
        serve(options.serve, options.batch, options.steps)
        return
    rows = harness.Rows(
        options, described, (measure(task, options.batch, options.steps, options.turns) for task in options.tasks)
    )
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
