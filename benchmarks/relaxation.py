"""What keeps the bound of imaging up: multipliers, or least times between images that are too short?

Usage:
    python benchmarks/relaxation.py [--targets 3000 10000] [--times "least" "sustained" ...] [--episodes 2] [--time-limit 5700]
        [--iterations 60] [--bits 4] [--cell 2] [--seed 1000003] [--out FILE.json]

The relaxation of AEOS-v1 with several times between images: the least ones of the envelope, those of slews in one step alone
(no bound: satellites may be on their way already), those that satellites cannot beat for long, and typical ones. Of those that
satellites cannot beat for long there are three variants. In the first, every slew starts from the best direction; in the second,
only single images are limited in how late they are, not all of a flight together (both are bounds, too). In the third, windows
do not close later by the reserve (no bound).
``bound`` and ``schedule`` enclose the best that the relaxation allows, whatever the multipliers. ``knapsack`` is the time that
images of all targets in view take if each comes by the quickest transition to it: a bound that counts time alone can lie below
the sum in view only where that is longer than the episode. ``planner`` is what beam search over the trained policy collects in
the same episodes. ``--times`` chooses rows; others that FILE.json has of the same episodes stay in it, each with the commit
that it was measured at.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from typing import Any

import harness
import torch
from image_leads import lateness, record_images
from torch import Tensor

import bsk_torch
from bsk_torch.lab.bounds import SUSTAINED, Envelope
from bsk_torch.lab.bounds.graph import ImageGraph
from bsk_torch.lab.bounds.imaging import graph_of
from bsk_torch.lab.bounds.paths import best_paths
from bsk_torch.lab.bounds.tasks import check_task, payment, shortest_pause
from bsk_torch.lab.bounds.windows import openings
from bsk_torch.lab.planners import planner
from bsk_torch.rl.policies import pretrained

PLANNER: dict[str, Any] = dict(name="beam", budget=800, horizon=400.0, gamma=0.994, width=16, depth=4)
"""The planner that the bounds are compared with, the best that is known."""

COLUMNS = {
    "targets": "{targets:,}",
    "times": "{times}",
    "in view": "{in_view:.2f}",
    "bound": "{bound:.2f}",
    "schedule": "{schedule:.2f}",
    "planner": "{planner:.2f}",
    "knapsack, s": "{knapsack:,.0f}",
    "cell, s": "{cell:.1f}",
    "s for each bound": "{seconds:.2f}",
}


def envelopes() -> dict[str, Envelope]:
    """Return times between images by name."""
    least = Envelope.load()
    sustained = Envelope.load(SUSTAINED)
    others = {
        "sustained": sustained,
        "sustained, best direction": towards(sustained),
        "sustained, any lateness": replace(sustained, lateness=None),
        "sustained, true windows": replace(sustained, reserve=0, lateness=None),
        "typical": least.expected,
    }
    return {"least": least, "least in one step": replace(least, any=least.direct)} | others


def towards(envelope: Envelope) -> Envelope:
    """Return times by the angle between targets for satellites that always point from one towards the next one."""
    nearer = torch.arange(len(envelope.direct)) * envelope.width - envelope.lag
    ticks = tuple(envelope.least(nearer.clamp(min=0.0), direct=True).tolist())
    return replace(envelope, direct=ticks, any=ticks, lag=0.0, sectors=0, near=0.0)


def quickest(graph: ImageGraph, step: float) -> Tensor:
    """Return the sum over the targets in view of the quickest transition to each, [rows] s."""
    never = graph.reach  # after which any target may follow any other
    window = torch.full_like(graph.row, never).scatter_reduce(0, graph.pair_to, graph.pair_cells, "amin")
    width = int(graph.target.max()) + 1
    target = torch.full((graph.rows * width,), 2 * never).scatter_reduce(0, graph.row * width + graph.target, window, "amin")
    seen = target <= never
    return torch.where(seen, target, 0).view(graph.rows, width).sum(1) * graph.ticks * step


def flown(options: Any, targets: int) -> dict[str, float]:
    """Return the mean return of the planner in the episodes, and how late its images are, s, for the sustained times."""
    env: Any = bsk_torch.make(
        "AEOS-v1",
        n_targets=targets,
        num_envs=options.episodes,
        time_limit=options.time_limit,
        backend=options.backend,
        as_set=True,
    )
    policy = planner(env=env, base=pretrained("AEOS-v1"), **PLANNER)
    images = record_images(env, policy, options.seed)
    late = lateness(images, Envelope.load(SUSTAINED)).double() * env.simulator.h
    return dict(planner=float(images.returns.mean()), latest=float(late.max()), lateness=float(late.sum(1).max()))


def rows_of(options: Any, targets: int, commit: str) -> list[dict[str, Any]]:
    """Solve the relaxation of the same episodes with the chosen times."""
    env: Any = bsk_torch.make(
        "AEOS-v1", n_targets=targets, num_envs=options.episodes, time_limit=options.time_limit, backend=options.backend
    )
    env.set_seed(options.seed)
    env.reset()
    satellite, limit, paid = env.satellite, env.state.limit_ticks, payment(env)
    every, rows = openings(satellite, limit), []
    in_view = torch.zeros_like(paid)
    in_view[every.row, every.target] = paid[every.row, every.target]
    for name in options.times:
        envelope = envelopes()[name]
        check_task(env, envelope)
        begin = time.process_time()
        parts = []
        for envs in torch.arange(len(paid)).split(1):  # the graph of one episode at a time is enough to keep
            graph = graph_of(satellite, every, envs, 1, envelope, options.cell, int(limit.max()), shortest_pause(env, satellite))
            budget = envelope.most_late(int(limit.max()))
            found = best_paths(graph, paid[envs], budget=budget, iterations=options.iterations, bits=options.bits)
            parts.append((float(found.upper), float(found.lower), float(quickest(graph, env.simulator.h))))
        upper, lower, knapsack = torch.tensor(parts, dtype=torch.float64).mean(0).tolist()
        seconds = (time.process_time() - begin) / len(paid)
        row = dict(targets=targets, times=name, in_view=float(in_view.sum(1).mean()), bound=upper, schedule=lower)
        row |= dict(knapsack=knapsack, seconds=seconds, cell=options.cell * env.simulator.h, commit=commit)
        rows.append(row)
        print(harness.cell("{targets} {times}: {bound:.2f} of {in_view:.2f}, schedule {schedule:.2f}", row), flush=True)
    return rows


def main() -> None:
    """Solve, and print a table."""
    arguments = harness.parser(
        __doc__,
        targets=[3000, 10_000],
        times=list(envelopes()),
        episodes=2,
        time_limit=5700.0,
        iterations=60,
        bits=4,
        cell=2,
        seed=1_000_003,
        backend="compiled",
    )
    options, described = harness.begin(arguments)
    known: list[dict[str, Any]] = []
    collected: dict[int, dict[str, float]] = {}
    if options.out and options.out.exists():
        earlier = json.loads(options.out.read_text())
        if all(earlier["options"][name] == getattr(options, name) for name in ("episodes", "time_limit", "seed")):
            known = earlier["rows"]
            if earlier.get("planner") == PLANNER:
                collected = {row["targets"]: {name: row[name] for name in ("planner", "latest", "lateness")} for row in known}
    found = {(row["targets"], row["times"]): row for row in known}
    for targets in options.targets:
        found |= {(targets, row["times"]): row for row in rows_of(options, targets, described["commit"])}
    collected = {targets: collected.get(targets) or flown(options, targets) for targets in {targets for targets, _ in found}}
    order = list(envelopes())
    rows = sorted(found.values(), key=lambda row: (row["targets"], order.index(row["times"])))
    rows = [row | collected[row["targets"]] for row in rows]
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, planner=PLANNER, rows=rows)


if __name__ == "__main__":
    main()
