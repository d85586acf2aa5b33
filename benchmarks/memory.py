"""Memory per environment, and whether it stays the same over many steps.

Usage:
    python benchmarks/memory.py [--tasks scan] [--batch 4096] [--steps 1000000] [--out FILE.json]

The first table has the bytes of all tensors that are kept, by where they are kept, and what the process has grown by since a
small batch of the same kind had run, so that code and compiled kernels are not counted: at its largest, while episodes were
prepared in bulk, and in the end; all per environment, its prepared next episode included. The second table has the memory of the
process at ten points of a random rollout of ``--steps`` environment steps (10_000_000 takes minutes).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import harness
import torch
from torch import Tensor

SMALL = 64
"""Batch size that has everything loaded that does not depend on the batch size."""

POINTS = 10

COLUMNS = {"task": "{task}", "batch": "{batch:,}", "what": "{what}", "bytes per environment": "{per_env:,.0f}"}

FLAT_COLUMNS = {"task": "{task}", "environment steps": "{steps:,}", "memory of the process, MB": "{megabytes:,.1f}"}


def inside(value: Any) -> Iterable[Any]:
    """What a container, or an object of the package, holds."""
    if isinstance(value, dict):
        return value.values()
    if isinstance(value, list | tuple | set):
        return value
    ours = type(value).__module__.startswith("bsk_torch")
    slots = [getattr(value, name, None) for name in getattr(type(value), "__slots__", ())]
    return [*vars(value).values(), *slots] if ours and hasattr(value, "__dict__") else slots if ours else ()


def storage(value: Any, seen: set[int]) -> int:
    """Bytes of all tensors reachable from ``value`` that are not in ``seen`` yet, every storage once."""
    if isinstance(value, Tensor):
        kept = value.untyped_storage()
        new = kept.data_ptr() not in seen
        seen.add(kept.data_ptr())
        return kept.nbytes() if new else 0
    if id(value) in seen:
        return 0
    seen.add(id(value))
    return sum(storage(part, seen) for part in inside(value))


def kept(env: Any) -> dict[str, int]:
    """Bytes of the tensors that an environment keeps: each part of its simulation, its pool, and the rest."""
    seen = {id(env.simulator)}  # its parts point back to it
    parts = {f"simulator.{name}": storage(part, seen) for name, part in vars(env.simulator).items()}
    parts["pool"] = storage(getattr(env, "pool", None), seen)
    parts["the rest"] = storage(vars(env), seen)
    return {name: size for name, size in parts.items() if size}


def per_environment(env: Any, before: int) -> list[dict[str, Any]]:
    """Rows of the first table, the largest first; ``before`` is what the process had before the environment."""
    parts, batch = kept(env), env.batch_size[0]
    sizes = sorted(parts.items(), key=lambda item: -item[1])
    sizes += {
        "all tensors": sum(parts.values()),
        "env.bytes_per_env": batch * env.bytes_per_env,
        "growth of the process": harness.resident() - before,
        "growth of the process at its largest": harness.peak() - before,
    }.items()
    return [{"what": what, "batch": batch, "dtype": "float64", "per_env": size / batch} for what, size in sizes]


def flatness(player: harness.Player, batch: int, steps: int) -> list[dict[str, Any]]:
    """Rows of the second table: memory before, and at ten points of ``steps`` environment steps."""
    rows, done = [{"steps": 0, "megabytes": harness.resident() / 1e6}], 0
    for point in range(1, POINTS + 1):
        while done * batch < steps * point / POINTS:
            next(player)
            done += 1
        rows.append({"steps": done * batch, "megabytes": harness.resident() / 1e6})
        print("{steps:,}: {megabytes:,.1f} MB".format_map(rows[-1]), flush=True)
    return rows


def measure(_: int, task: str, batch: int, steps: int, warm_up: int) -> dict[str, list[dict[str, Any]]]:
    """A task's rows of both tables."""
    torch.set_num_threads(1)
    small, _ = harness.start(lambda: harness.rollout(harness.make_env(task, SMALL)), 10)
    del small
    before, env = harness.resident(), harness.make_env(task, batch)
    player, _ = harness.start(lambda: harness.rollout(env), warm_up)
    tables = {"rows": per_environment(env, before), "flatness": flatness(player, batch, steps)}
    return {name: [{"task": task, **row} for row in rows] for name, rows in tables.items()}


def main() -> None:
    """Measure and print two tables."""
    arguments = harness.parser(__doc__, tasks=["scan"], batch=4096, steps=1_000_000)
    options, described = harness.begin(arguments)
    results: dict[str, list[dict[str, Any]]] = {"rows": [], "flatness": []}
    for task in options.tasks:
        case = task, options.batch, options.steps, harness.warm_up(options, task)
        for name, rows in harness.in_processes(1, measure, *case)[0].items():
            results[name] += rows
    print(harness.table(COLUMNS, results["rows"]), harness.table(FLAT_COLUMNS, results["flatness"]), sep="\n\n")
    harness.write(options, described, **results)


if __name__ == "__main__":
    main()
