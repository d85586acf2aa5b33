"""Where the CPU time of a step goes, by part of the package.

Usage:
    python benchmarks/breakdown.py [--tasks scan] [--batches 4096 1] [--seconds 20] [--out FILE.json]

A timer of CPU time interrupts a random rollout in its steady state (see harness.py) about every millisecond. The CPU time since
the previous interrupt is counted for the part whose code was running or had called torch or a kernel: that of the innermost frame
of a module in ``PARTS``. All that happens inside a reset is counted as the reset. Times are of one thread. (The script is not
called profile.py: Python's own cProfile would import it.)
"""

from __future__ import annotations

from types import FrameType
from typing import Any

import harness

from bsk_torch.rl.training.profile import sampling

RESET = "reset: next episodes and their first observations"

PARTS = {
    "bsk_torch.act": "act: actions and commands",
    "bsk_torch.obs": "obs: observations and masks",
    "bsk_torch.data": "data: reward",
    "bsk_torch.scene": "scene: targets",
    "bsk_torch.comm": "comm: communication",
    "bsk_torch.sats": "sats: upcoming opportunities and masks",
    "bsk_torch.sim.access": "sim.access: windows",
    "bsk_torch.sim.orbit": "sim.orbit: arcs",
    "bsk_torch.sim.readout": "sim.readout: observables",
    "bsk_torch.sim": "sim: the simulation",
    "bsk_torch.env": "env: episodes, ends, specifications",
    "torchrl": "TorchRL",
    "__main__": "this script",
}
"""Names of parts by package; the longest that fits a module counts. Others, such as torch, count for their caller."""

COLUMNS = {"task": "{task}", "batch": "{batch:,}", "part": "{part}", "microseconds per step": "{us:,.1f}", "%": "{percent:.1f}"}


def part_of(frame: FrameType | None) -> str:
    """The part whose code runs in ``frame``, or has called what runs."""
    found = ""
    while frame is not None:
        if frame.f_code.co_name == "_reset":
            return RESET
        if not found:
            module = frame.f_globals.get("__name__", "")
            fits = [package for package in PARTS if module == package or module.startswith(f"{package}.")]
            found = PARTS[max(fits, key=len)] if fits else ""
        frame = frame.f_back
    return found or "the rest"


def shares(task: str, batch: int, seconds: float, warm_up: int) -> list[dict[str, Any]]:
    """Rows of one batch: every part, and their sum."""
    env = harness.make_env(task, batch)
    player, ready = harness.start(lambda: harness.rollout(env), warm_up)
    with sampling(part_of) as spent:
        turn = harness.play(player, seconds, whole=batch)
    total = sum(spent.values())
    parts = sorted(spent.items(), key=lambda item: -item[1])
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
    rows = harness.Rows(
        options,
        described,
        (row for task, batch in cases for row in shares(task, batch, options.seconds, harness.warm_up(options, task))),
    )
    print(harness.table(COLUMNS, [row for row in rows if "part" in row]))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
