"""What keeps the bound of imaging up: multipliers, or least times between images that are too short?

Usage:
    python benchmarks/relaxation.py [--targets 3000 10000] [--episodes 2] [--time-limit 5700] [--iterations 60] [--bits 4]
        [--seed 1000003] [--out FILE.json]

The relaxation of AEOS-v1 with several times between images: the least ones of the envelope, those of slews in one step alone (no
bound: satellites may be on their way already), those that satellites cannot beat for long, and typical ones. ``bound`` and
``schedule`` enclose the best that the relaxation allows, whatever the multipliers. ``knapsack`` is the time that images of all
targets in view take if each comes by the quickest transition to it: a bound that counts time alone can lie below the sum in view
only where that is longer than the episode. ``planner`` is what a rollout planner over the trained policy collects in the same
episodes.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import harness
import torch
from torch import Tensor

import bsk_torch
from bsk_torch.plan import planner
from bsk_torch.plan.bounds import SUSTAINED, Envelope
from bsk_torch.plan.bounds.graph import ImageGraph
from bsk_torch.plan.bounds.imaging import graph_of
from bsk_torch.plan.bounds.paths import best_paths
from bsk_torch.plan.bounds.tasks import check_task, payment, shortest_pause
from bsk_torch.plan.bounds.windows import openings
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies import pretrained

COLUMNS = {
    "targets": "{targets:,}",
    "times": "{times}",
    "in view": "{in_view:.2f}",
    "bound": "{bound:.2f}",
    "schedule": "{schedule:.2f}",
    "planner": "{planner:.2f}",
    "knapsack, s": "{knapsack:,.0f}",
    "s for each bound": "{seconds:.2f}",
}


def envelopes() -> dict[str, Envelope]:
    """Return times between images by name."""
    least = Envelope.load()
    others = {"sustained": Envelope.load(SUSTAINED), "typical": least.expected}
    return {"least": least, "least in one step": replace(least, any=least.direct)} | others


def quickest(graph: ImageGraph, step: float) -> Tensor:
    """Return the sum over the targets in view of the quickest transition to each, [rows] s."""
    never = graph.reach  # after which any target may follow any other
    window = torch.full_like(graph.row, never).scatter_reduce(0, graph.pair_to, graph.pair_cells, "amin")
    width = int(graph.target.max()) + 1
    target = torch.full((graph.rows * width,), 2 * never).scatter_reduce(0, graph.row * width + graph.target, window, "amin")
    seen = target <= never
    return torch.where(seen, target, 0).view(graph.rows, width).sum(1) * graph.ticks * step


def flown(options: Any, targets: int) -> float:
    """Return the mean return of the planner in the episodes."""
    env: Any = bsk_torch.make(
        "AEOS-v1",
        n_targets=targets,
        num_envs=options.episodes,
        time_limit=options.time_limit,
        backend=options.backend,
        as_set=True,
    )
    policy = planner("rollout", env, base=pretrained("AEOS-v1"), budget=8, horizon=240.0, gamma=0.99)
    return float(evaluate(policy, env, seed=options.seed).returns.mean())


def rows_of(options: Any, targets: int) -> list[dict[str, Any]]:
    """Solve the relaxation of the same episodes with all times."""
    env: Any = bsk_torch.make(
        "AEOS-v1", n_targets=targets, num_envs=options.episodes, time_limit=options.time_limit, backend=options.backend
    )
    env.set_seed(options.seed)
    env.reset()
    satellite, limit, paid = env.satellite, env.state.limit_ticks, payment(env)
    every, rows = openings(satellite, limit), []
    in_view = torch.zeros_like(paid)
    in_view[every.row, every.target] = paid[every.row, every.target]
    planned = flown(options, targets)
    for name, envelope in envelopes().items():
        check_task(env, envelope)
        begin = time.process_time()
        graph = graph_of(
            satellite, every, torch.arange(len(paid)), 1, envelope, 2, int(limit.max()), shortest_pause(env, satellite)
        )
        found = best_paths(graph, paid, iterations=options.iterations, bits=options.bits)
        seconds = (time.process_time() - begin) / len(paid)
        row = dict(targets=targets, times=name, in_view=float(in_view.sum(1).mean()), bound=float(found.upper.mean()))
        row |= dict(schedule=float(found.lower.mean()), knapsack=float(quickest(graph, env.simulator.h).mean()), seconds=seconds)
        rows.append(row | {"planner": planned})
        print(harness.cell("{targets} {times}: {bound:.2f} of {in_view:.2f}, schedule {schedule:.2f}", row), flush=True)
    return rows


def main() -> None:
    """Solve, and print a table."""
    arguments = harness.parser(
        __doc__,
        targets=[3000, 10_000],
        episodes=2,
        time_limit=5700.0,
        iterations=60,
        bits=4,
        seed=1_000_003,
        backend="compiled",
    )
    options, described = harness.begin(arguments)
    rows = [row for targets in options.targets for row in rows_of(options, targets)]
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
