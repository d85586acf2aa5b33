"""How the rate grows with the batch, what an environment costs in memory, and what a second core brings.

Usage:
    python benchmarks/scaling.py [--tasks scan] [--batches 1 4 16 ...] [--split 64 16384] [--layouts thread ...] [--out FILE.json]

Every line is measured in new processes. The first table has one thread: rates are simulated seconds per core-second, with
quartiles over turns, and memory is what the process has grown by, code included, per environment (memory.py looks closer). The
second table splits the same number of environments over two cores in several ways; its rates are simulated seconds per second
of the wall clock: one process with one ``thread`` or two ``threads``, two ``processes`` with half of the batch each, and a
``ParallelEnv`` of two workers (``parallel``).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import harness
import torch
from torchrl.envs import ParallelEnv

BATCHES = [4**k for k in range(9)]

SPLIT = [64, 16384]
"""Batches that are split over two cores."""

TURNS = 5

LEAST = 20
"""Steps in a turn of a large batch: enough for a few bulk preparations of episodes."""

COLUMNS = {
    "task": "{task}",
    "batch": "{batch:,}",
    "simulated s per core-s": "{rate:,.0f}",
    "quartiles": "{rate_low:,.0f} to {rate_high:,.0f}",
    "step, ms": "{step_ms:.3g}",
    "memory per environment, kB": "{kilobytes:,.0f}",
    "first reset and step, s": "{ready_s:.1f}",
    "remark": "{remark}",
}

SPLIT_COLUMNS = {
    "task": "{task}",
    "layout": "{layout}",
    "batch": "{batch:,}",
    "simulated s per s": "{rate:,.0f}",
    "x the first": "{gain:.2f}",
}


# -- batches ----------------------------------------------------------------------------------------------------------


def one_batch(_: int, task: str, batch: int, seconds: float, warm_up: int) -> dict[str, Any]:
    """A row of the first table."""
    torch.set_num_threads(1)
    before = harness.resident()
    player, ready = harness.start(lambda: harness.rollout(harness.make_env(task, batch)), warm_up)
    turns = [harness.play(player, seconds / TURNS, LEAST) for _ in range(TURNS)]
    return {
        "batch": batch,
        "dtype": "float64",
        **harness.spread("rate", [turn.rate for turn in turns]),
        "step_ms": 1e3 * sum(turn.cpu for turn in turns) / sum(turn.steps for turn in turns),
        "kilobytes": (harness.resident() - before) / batch / 1e3,
        "ready_s": ready,
        "turns": [turn._asdict() for turn in turns],
    }


def too_large(batch: int, rows: list[dict[str, Any]]) -> str:
    """Why a batch would not fit into the memory that is left, judged by the largest one before; empty if it does."""
    known = [row for row in rows if "kilobytes" in row]
    need = batch * known[-1]["kilobytes"] * 1e3 if known and known[-1]["batch"] >= 64 else 0.0
    return f"needs {need / 1e9:.0f} GB, {harness.available() / 1e9:.0f} GB are left" if need > 0.9 * harness.available() else ""


def batches(task: str, sizes: list[int], seconds: float, warm_up: int) -> list[dict[str, Any]]:
    """A task's rows of the first table."""
    rows: list[dict[str, Any]] = []
    for batch in sizes:
        remark = too_large(batch, rows)
        measured = {"batch": batch} if remark else harness.in_processes(1, one_batch, task, batch, seconds, warm_up)[0]
        rows.append({"task": task, **measured, "remark": remark})
        print(harness.cell("{task}, {batch}: {rate:,.0f}", rows[-1]), flush=True)
    return rows


# -- two cores --------------------------------------------------------------------------------------------------------


def alone(rank: int, task: str, batch: int, threads: int, seconds: float, warm_up: int) -> harness.Turn:
    """One process with a batch of its own, which starts when all are ready."""
    torch.set_num_threads(threads)
    player, _ = harness.start(lambda: harness.rollout(harness.make_env(task, batch, rank=rank)), warm_up)
    harness.meet()
    return harness.play(player, seconds, LEAST)


def in_workers(_: int, task: str, batch: int, seconds: float, warm_up: int) -> harness.Turn:
    """One process that drives two workers, each with half of the batch, in step."""
    torch.set_num_threads(1)
    workers = [partial(harness.make_env, task, batch // 2, rank=rank) for rank in range(2)]
    env = ParallelEnv(2, workers, mp_start_method="spawn")
    player, _ = harness.start(lambda: harness.rollout(env), warm_up)
    turn = harness.play(player, seconds, LEAST)
    env.close()
    return turn


Layout = Callable[[str, int, float, int], list[harness.Turn]]

LAYOUTS: dict[str, Layout] = {
    "thread": lambda task, n, *times: harness.in_processes(1, alone, task, n, 1, *times),
    "threads": lambda task, n, *times: harness.in_processes(1, alone, task, n, 2, *times),
    "processes": lambda task, n, *times: harness.in_processes(2, alone, task, n // 2, 1, *times),
    "parallel": lambda task, n, *times: harness.in_processes(1, in_workers, task, n, *times),
}


def layouts(task: str, batch: int, names: list[str], seconds: float, warm_up: int) -> list[dict[str, Any]]:
    """Rows of the second table for one task and batch size."""
    rows: list[dict[str, Any]] = []
    for layout in names:
        turns = LAYOUTS[layout](task, batch, seconds, warm_up)
        rate = sum(turn.wall_rate for turn in turns)
        row = {"task": task, "layout": layout, "batch": batch, "dtype": "float64", "rate": rate}
        gain = rate / (rows[0]["rate"] if rows else rate)
        rows.append(row | {"gain": gain, "turns": [turn._asdict() for turn in turns]})
        print(harness.cell("{task}, {layout}, {batch}: {rate:,.0f}", rows[-1]), flush=True)
    return rows


def main() -> None:
    """Measure and print two tables."""
    arguments = harness.parser(__doc__, tasks=["scan"], batches=BATCHES, split=SPLIT, seconds=20.0)
    arguments.add_argument(
        "--layouts", nargs="+", choices=LAYOUTS, default=list(LAYOUTS), help="ways to split, of the second table"
    )
    options, described = harness.begin(arguments)
    rows, split = harness.Rows(options, described), []
    for task in options.tasks:
        times = options.seconds, harness.warm_up(options, task)
        rows += batches(task, options.batches, *times)
        split += [row for batch in options.split for row in layouts(task, batch, options.layouts, *times)]
    print(harness.table(COLUMNS, rows), harness.table(SPLIT_COLUMNS, split), sep="\n\n")
    harness.write(options, described, rows=rows, split=split)


if __name__ == "__main__":
    main()
