"""Where the time of a step goes.

Usage:
    python benchmarks/breakdown.py [--tasks scan] [--batches 4096 1] [--seconds 20] [--out FILE.json]

Methods of the environment are timed in place, each without those inside it, in a random rollout in its steady state (see
harness.py); times are of one thread. (The script is not called profile.py: Python's own cProfile would import it.)
"""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import harness

RESET = "reset: next episodes and their first observations"

PARTS = (
    ("", "step_and_maybe_reset", "TorchRL: the rest of step_and_maybe_reset"),
    ("", "_step", "checks, ends and what else a step does"),
    ("", "_command", "act: durations and commands"),
    ("simulator", "run", "tick: the simulation"),
    ("", "_reward", "data: reward and aliveness"),
    ("", "_outputs", "obs: observations and masks"),
    ("satellite", "find_next_opportunities", "windows: which come next"),
    ("simulator.access", "extend", "windows: search beyond those prepared at reset"),
    ("simulator", "reach", "orbits beyond those prepared at reset"),
    ("", "_reset", RESET),
    ("action_spec", "rand", "drawing random actions"),
)
"""Attribute of the environment, method of it, and how its time is called."""

COLUMNS = {"task": "{task}", "batch": "{batch:,}", "part": "{part}", "microseconds per step": "{us:,.1f}", "%": "{percent:.1f}"}


def shares(task: str, batch: int, seconds: float, warm_up: int) -> list[dict[str, Any]]:
    """Rows of one batch: every part, and their sum."""
    env = harness.make_env(task, batch)
    player, ready = harness.start(lambda: harness.rollout(env), warm_up)
    watch = harness.Stopwatch(RESET)
    for owner, method, part in PARTS:
        watch.watch(attrgetter(owner)(env) if owner else env, method, part)
    turn = harness.play(player, seconds, whole=batch)
    total = sum(watch.spent.values())
    parts = sorted(watch.spent.items(), key=lambda item: -item[1])
    case = {"task": task, "batch": batch, "dtype": "float64"}
    return [
        {**case, "part": part, "us": 1e6 * spent / turn.steps, "percent": 100.0 * spent / total}
        for part, spent in [*parts, ("all", total)]
    ] + [{**case, "ready_s": ready, **turn._asdict()}]


def main() -> None:
    """Measure and print a table."""
    arguments = harness.parser(__doc__, tasks=["scan"], batches=[4096, 1], seconds=20.0)
    options, described = harness.begin(arguments)
    cases = [(task, batch) for task in options.tasks for batch in options.batches]
    rows = [row for task, batch in cases for row in shares(task, batch, options.seconds, harness.warm_up(options, task))]
    print(harness.table(COLUMNS, [row for row in rows if "part" in row]))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
