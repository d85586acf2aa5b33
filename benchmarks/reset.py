"""What a reset costs, alone and as a share of a random rollout.

Usage:
    python benchmarks/reset.py [--tasks scan] [--batch 4096] [--rows 1 16 1024] [--rounds 3] [--shares 4096 64] [--out FILE.json]

A large batch prepares the next episode of every environment in bulk, so the time of a partial reset depends on what is ready:
``ready`` resets rows whose next episode waits; ``used`` resets rows that have just used theirs, so that as many are prepared
as reset; ``all used`` does so when no row has an episode left, so that the whole batch is prepared: ``in bulk, each`` is that
divided by the batch. ``whole batch`` resets all of a batch of that many rows, its episodes prepared in the same call; below 32
rows nothing is ever prepared ahead, so ``whole batch, each``, divided by the rows, is what a small batch pays. Times are of one
thread, medians over rounds. The share is that of ``_reset`` in ``step_and_maybe_reset`` in the steady state (see harness.py),
where rows are mostly ready and seldom many are used.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import harness
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase

MOST = 16
"""Resets of rows that are ready, in a round."""

AGAIN = 3
"""Resets of rows that are not, in a round."""

COLUMNS = {
    "task": "{task}",
    "rows": "{rows}",
    "of": "{batch}",
    "ready, ms": "{ready_ms:.3g}",
    "used, ms": "{used_ms:.4g}",
    "all used, ms": "{all_used_ms:.4g}",
    "in bulk, each, ms": "{bulk_ms_each:.3g}",
    "whole batch, ms": "{whole_ms:.4g}",
    "whole batch, each, ms": "{whole_ms_each:.3g}",
}

SHARE_COLUMNS = {
    "task": "{task}",
    "batch": "{batch}",
    "share of resets": "{share:.1%}",
    "ms per ended episode": "{episode_ms:.3g}",
    "episodes ended": "{ended}",
    "steps": "{steps}",
}


def seconds_of_reset(env: EnvBase, first: int, count: int) -> float:
    """Time of resetting ``count`` rows from ``first`` on."""
    rows = torch.arange(env.batch_size[0])
    chosen = (rows >= first) & (rows < first + count)
    call = TensorDict({"_reset": chosen.unsqueeze(-1)}, env.batch_size)
    clock = time.thread_time()
    env.reset(call)
    return time.thread_time() - clock


def partial_resets(env: EnvBase, count: int) -> dict[str, list[float]]:
    """One round of resets of ``count`` rows: with nothing ready, of the same rows again, and of others that are ready."""
    env.reset()  # uses every episode that is ready
    all_used = [seconds_of_reset(env, 0, count)]
    used = [seconds_of_reset(env, 0, count) for _ in range(AGAIN)]
    blocks = list(range(count, env.batch_size[0] - count + 1, count))[:MOST]
    ready = [seconds_of_reset(env, first, count) for first in blocks]
    return {"all_used_ms": all_used, "used_ms": used, "ready_ms": ready}


def whole_reset(env: EnvBase) -> float:
    """Time of resetting every row."""
    clock = time.thread_time()
    env.reset()
    return time.thread_time() - clock


def resets(task: str, batch: int, counts: list[int], rounds: int) -> list[dict[str, Any]]:
    """A task's rows of the first table; medians over all rounds, in ms."""
    env, rows = harness.make_env(task, batch), []
    env.reset()
    for count in counts:
        small = harness.make_env(task, count)
        small.reset()
        times: dict[str, list[float]] = {"whole_ms": [whole_reset(small) for _ in range(rounds)]}
        for _ in range(rounds):
            for name, values in partial_resets(env, count).items():
                times.setdefault(name, []).extend(values)
        medians = {name: 1e3 * statistics.median(values) for name, values in times.items() if values}
        each = {"bulk_ms_each": medians["all_used_ms"] / batch, "whole_ms_each": medians["whole_ms"] / count}
        case = {"task": task, "rows": count, "batch": batch, "dtype": "float64"}
        rows.append({**case, **medians, **each, "seconds": times})
        print(harness.cell("{task}, {rows}: {bulk_ms_each:.3g} ms each", rows[-1]), flush=True)
    return rows


def share(task: str, batch: int, seconds: float, warm_up: int) -> dict[str, Any]:
    """Row of the second table: the part of a random rollout that resets take."""
    env = harness.make_env(task, batch)
    player, ready = harness.start(lambda: harness.rollout(env), warm_up)
    watch = harness.Stopwatch("reset")
    watch.watch(env, "step_and_maybe_reset", "step")
    watch.watch(env, "_reset", "reset")
    turn = harness.play(player, seconds, whole=batch)
    resetting = watch.spent.get("reset", 0.0)
    return {
        "task": task,
        "batch": batch,
        "dtype": "float64",
        "share": resetting / sum(watch.spent.values()),
        "episode_ms": 1e3 * resetting / max(turn.ended, 1),
        "ready_s": ready,
        **turn._asdict(),
    }


def main() -> None:
    """Measure and print two tables."""
    arguments = harness.parser(__doc__, tasks=["scan"], batch=4096, rows=[1, 16, 1024], rounds=3, shares=[4096, 64], seconds=20.0)
    options, described = harness.begin(arguments)
    rows, shares = harness.Rows(options, described), []
    for task in options.tasks:
        rows += resets(task, options.batch, options.rows, options.rounds)
        shares += [share(task, batch, options.seconds, harness.warm_up(options, task)) for batch in options.shares]
    print(harness.table(COLUMNS, rows), harness.table(SHARE_COLUMNS, shares), sep="\n\n")
    harness.write(options, described, rows=rows, shares=shares)


if __name__ == "__main__":
    main()
