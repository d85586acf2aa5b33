"""What recording at tick resolution costs.

Usage:
    python benchmarks/recording.py [--tasks scan] [--batches 64 4096] [--every 1 10] [--steps 8] [--rounds 3] [--out FILE.json]

Random actions are played in an environment, each round first without a recording, then with one of the attitude (``sigma_BN``,
``omega_BN_B``) of one environment, and of all. Times are of one thread, for a step of all environments, medians over steps. Rows
that are recorded run a second time, from one recorded tick to the next: the cost of one is that of the calls, and does not depend
on the batch.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import harness
from tensordict import TensorDictBase

FIELDS = ("sigma_BN", "omega_BN_B")

COLUMNS = {
    "task": "{task}",
    "batch": "{batch:,}",
    "recorded": "{rows:,}",
    "every": "{every}",
    "without, ms": "{without_ms:.3g}",
    "with, ms": "{with_ms:.3g}",
    "ratio": "{ratio:.2f}",
    "ticks a step": "{ticks:.0f}",
    "bytes a record": "{bytes:.0f}",
}


def play(env: Any, td: TensorDictBase, steps: int) -> tuple[TensorDictBase, list[float]]:
    """Play some steps; return where they lead, and the time of each without resets, in s."""
    seconds = []
    for _ in range(steps):
        td = env.rand_action(td)
        clock = time.thread_time()
        stepped = env.step(td)
        seconds.append(time.thread_time() - clock)
        td = env.maybe_reset(stepped["next"])
    return td, seconds


def costs(task: str, batch: int, rows: int, every: int, steps: int, rounds: int) -> dict[str, Any]:
    """Return a row of the table."""
    env = harness.make_env(task, batch)
    td, _ = play(env, env.reset(), 2)
    plain: list[float] = []
    recorded: list[float] = []
    size, records, ticks = 0, 0, []
    for _ in range(rounds):
        td, seconds = play(env, td, steps)
        plain += seconds
        with env.record(FIELDS, rows=range(rows), every=every) as recording:
            td, seconds = play(env, td, steps)
        recorded += seconds
        size, records = size + recording.nbytes, records + len(recording.time)
        ticks.append(every * len(recording.time) / (rows * steps))
    case = {"task": task, "batch": batch, "rows": rows, "every": every}
    without, with_it = (1e3 * statistics.median(seconds) for seconds in (plain, recorded))
    found = {"without_ms": without, "with_ms": with_it, "ratio": with_it / without}
    return case | found | {"ticks": statistics.mean(ticks), "bytes": size / max(records, 1)}


def main() -> None:
    """Measure and print the table."""
    arguments = harness.parser(__doc__, tasks=["scan"], batches=[64, 4096], every=[1, 10], steps=8, rounds=3)
    options, described = harness.begin(arguments)
    rows = harness.Rows(options, described)
    for task in options.tasks:
        for batch in options.batches:
            for count in sorted({1, batch}):
                for every in options.every:
                    rows.append(costs(task, batch, count, every, options.steps, options.rounds))
                    print(harness.cell("{task}, {rows} of {batch}, every {every}: {ratio:.2f}", rows[-1]), flush=True)
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
