"""Time and bytes of copying the state of one episode into many rows of another environment, as planners do.

Usage:
    python benchmarks/state.py [--tasks imaging-1k scan] [--rows 1024 32] [--rounds 20] [--out FILE.json]
    PYTHONPATH=CHECKOUT_OF_RELEASE_0.1 python benchmarks/state.py

The source is an environment with one episode, the target a batch of ``--rows``; both have played ``--steps`` random steps. Times
are of one thread, medians and quartiles over rounds:

``copy``
    ``target.restore(source, rows, source_rows)``: all tensors of the episode into all rows. Release 0.1 has no such method; its
    saved state is repeated for every row first, then put back.
``save``
    ``source.get_state()``, which is part of ``copy`` in release 0.1 and not needed otherwise.
``with observations``
    The same copy through ``target.reset(..., set_state=True)``, which also returns observations of all rows.

Bytes are those of ``source.get_state()``; the last column is their product with the rows, which is what a copy writes. After the
rounds the copies are checked: one step with the same action in every row must give the same reward and observation in every row.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import harness
import torch
from tensordict import TensorDict, TensorDictBase

COLUMNS = {
    "task": "{task}",
    "rows": "{rows:,}",
    "copy, ms": "{copy_ms:.3g}",
    "quartiles": "{copy_ms_low:.3g} to {copy_ms_high:.3g}",
    "us per row": "{row_us:.3g}",
    "save, ms": "{save_ms:.3g}",
    "with observations, ms": "{reset_ms:.3g}",
    "bytes of an episode": "{bytes:,}",
    "MB written": "{megabytes:,.1f}",
}


def copier(source: Any, target: Any) -> Callable[[], None]:
    """Copies episode 0 of ``source`` into all rows of ``target``."""
    rows = torch.arange(target.batch_size[0])
    zeros = torch.zeros_like(rows)
    if hasattr(target, "restore"):
        return lambda: target.restore(source, rows, zeros)
    return lambda: target._restore(source.get_state()[zeros], rows)  # release 0.1


def resetter(source: Any, target: Any) -> Callable[[], TensorDictBase]:
    """Does the same through ``reset``, which returns observations; the state is repeated for every row."""
    zeros = torch.zeros(target.batch_size[0], dtype=torch.long)
    call = {"_reset": torch.ones(len(zeros), 1, dtype=torch.bool)}
    return lambda: target.reset(TensorDict(call | {"state": source.get_state()[zeros]}, target.batch_size), set_state=True)


def timed(function: Callable[[], Any], rounds: int) -> list[float]:
    """CPU times of this thread, ms; a first call is not counted."""
    function()
    times = []
    for _ in range(rounds):
        clock = time.thread_time()
        function()
        times.append(1e3 * (time.thread_time() - clock))
    return times


def check(target: Any, copied: TensorDictBase) -> None:
    """Raise RuntimeError unless all rows of ``target`` are equal and stay so in a step."""
    action = target.action_spec.rand()[:1].expand(target.batch_size).clone()
    after = target.step(copied.set("action", action))["next"]
    for name, values in [*copied.items(True, True), *after.items(True, True)]:
        if not torch.equal(values, values[:1].expand_as(values).clone()) and not bool(values.isnan().any()):
            raise RuntimeError(f"rows differ in {name} after the copy")


def measure(task: str, rows: int, steps: int, rounds: int) -> dict[str, Any]:
    """A row of the table."""
    torch.manual_seed(0)
    source, target = harness.make_env(task, 1), harness.make_env(task, rows)
    for env in (source, target):
        harness.start(lambda env=env: harness.rollout(env), steps)
    size = sum(value.nbytes for value in source.get_state().values(True, True))
    copy = timed(copier(source, target), rounds)
    save, reset = timed(source.get_state, rounds), timed(resetter(source, target), rounds)
    check(target, resetter(source, target)())
    copier(source, target)()
    spread = {**harness.spread("copy_ms", copy), **harness.spread("save_ms", save), **harness.spread("reset_ms", reset)}
    return {
        "task": task,
        "rows": rows,
        **spread,
        "row_us": 1e3 * spread["copy_ms"] / rows,
        "bytes": size,
        "megabytes": size * rows / 1e6,
        "rounds_ms": {"copy": copy, "save": save, "reset": reset},
    }


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, tasks=["imaging-1k", "scan"], rows=[1024, 32], rounds=20, steps=20)
    options, described = harness.begin(arguments)
    table = [measure(task, rows, options.steps, options.rounds) for task in options.tasks for rows in options.rows]
    print(harness.table(COLUMNS, table))
    harness.write(options, described, rows=table)


if __name__ == "__main__":
    main()
