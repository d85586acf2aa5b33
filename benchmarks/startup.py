"""How long it takes until the first step is done: with nothing compiled yet, and with everything compiled.

Usage:
    python benchmarks/startup.py [--tasks scan] [--batches 1 4096] [--dtypes float64 float32] [--warm 3] [--backend eager]

Every line is a new process. The first one of a case starts with empty folders for compiled code, ours and torch's (cold); the
others find what it has left there (warm), and their median is shown. Times are of the wall clock.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from itertools import product
from typing import Any

import harness
import torch

CACHES = ("BSK_TORCH_CACHE", "TORCHINDUCTOR_CACHE_DIR")

COLUMNS = {
    "task": "{task}",
    "batch": "{batch:,}",
    "type": "{dtype}",
    "compiled before": "{cache}",
    "construction, s": "{construction:.2f}",
    "first reset, s": "{reset:.2f}",
    "first step, s": "{step:.3f}",
}


def first_step(_: int, task: str, batch: int, dtype: str, backend: str) -> dict[str, float]:
    """Times from construction to the first step."""
    torch.set_num_threads(1)
    times = [time.perf_counter()]
    env = harness.make_env(task, batch, dtype, backend=backend)
    times.append(time.perf_counter())
    td = env.reset()
    times.append(time.perf_counter())
    env.step_and_maybe_reset(td.set("action", env.action_spec.rand()))
    times.append(time.perf_counter())
    names = ("construction", "reset", "step")
    return {name: after - before for name, before, after in zip(names, times, times[1:], strict=False)}


def cold_and_warm(task: str, batch: int, dtype: str, backend: str, warm: int) -> list[dict[str, Any]]:
    """Two rows of the table."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ.update(dict.fromkeys(CACHES, folder))  # for the processes that follow
        cold, *others = [harness.in_processes(1, first_step, task, batch, dtype, backend)[0] for _ in range(1 + warm)]
    case = {"task": task, "batch": batch, "dtype": dtype}
    medians = {name: statistics.median(other[name] for other in others) for name in cold} if others else {}
    return [{**case, "cache": "nothing", **cold}, {**case, "cache": "everything", **medians, "processes": others}]


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, tasks=["scan"], batches=[1, 4096], dtypes=["float64", "float32"], warm=3)
    arguments.add_argument("--backend", choices=["compiled", "eager"], default="compiled")
    options, described = harness.begin(arguments)
    rows = harness.Rows(options, described)
    for case in product(options.tasks, options.batches, options.dtypes):
        rows += cold_and_warm(*case, options.backend, options.warm)
        print(harness.table(COLUMNS, rows[-2:]), flush=True)
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
