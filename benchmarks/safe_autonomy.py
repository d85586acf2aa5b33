"""What rules and random actions reach in ``CWDocking-v1`` or ``CWInspection-v1`` with and without run-time assurance, and speed.

Usage:
    python benchmarks/safe_autonomy.py [--preset CWDocking-v1] [--episodes 1024] [--batch 1024]
        [--filters none asif simplex implicit_simplex] [--policies random glide rush]
        [--original PYTHON] [--turns 5] [--steps 100] [--out FILE.json]

All policies play the same episodes. A policy is a rule, ``rush``, or the folder of a run of ``bsk-torch train``. ``rush`` docks
at one and a half times the safe speed. ``--original`` names an interpreter with AFRL's safe-autonomy-sims, whose environment
steps in turns with ours, both on one thread and with random actions scaled down so that episodes last. Rates count processor
time, not that of other jobs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import time
from functools import partial
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase

import bsk_torch
from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.marl.runs import read_config
from bsk_torch.rl.policies.files import policy_of_file
from bsk_torch.tasks.safe_autonomy.rules import glide

SIDE = Path(__file__).with_name("safe_autonomy_side.py")

POINTS = 99
"""Points of an inspection."""

WEAK = 0.02
"""Largest random force of the measurement of speed, N."""

COLUMNS = {
    "preset": "{preset}",
    "policy": "{policy}",
    "filter": "{filter}",
    "success": "{success:.1%}",
    "inspected, IQM": "{inspected:.2%}",
    "crashed": "{crashed:.1%}",
    "above the safe speed": "{speeding:.2f}",
    "blinded": "{blinded:.2f}",
    "interventions": "{interventions:.1f}",
    "decisions": "{decisions:.0f}",
    "return": "{value:.3f} +- {half:.3f}",
}


def rush(env: SatelliteTasking) -> TensorDictModuleBase:
    """Return a policy that docks above the safe speed."""
    decide = partial(glide, description=env.satellite.observation_description, most=1.0, share=1.5)
    return TensorDictModule(decide, in_keys=["observation"], out_keys=["action"])


def interquartile_mean(values: torch.Tensor) -> float:
    """Return the mean of the middle half of values."""
    ordered, quarter = values.sort().values, len(values) // 4
    return float(ordered[quarter : len(values) - quarter].mean())


def play(policy: str, name: str, options: argparse.Namespace) -> Evaluation:
    """Play the episodes of a policy behind a filter."""
    size = min(options.batch, options.episodes)
    assurance = None if name == "none" else name
    limit = {} if options.time_limit is None else {"time_limit": options.time_limit}
    world = dict(num_envs=size, env_ids=[0] * size, assurance=assurance, backend=options.backend)
    env = bsk_torch.make(options.preset, **world, **limit)
    if Path(policy).is_dir():
        actor: TensorDictModuleBase = policy_of_file(policy)
    else:
        actor = rush(env) if policy == "rush" else bsk_torch.rule(policy, env)
    return evaluate(actor, env, seeds=range(options.seed, options.seed + options.episodes))


def called(policy: str) -> str:
    """Return how tables call a policy."""
    return f"trained, seed {read_config(Path(policy)).seed}" if Path(policy).is_dir() else policy


def summary(result: Evaluation) -> dict[str, Any]:
    """Return shares of episodes, and means per episode."""
    counts = {name: values.double() for name, values in result.counts.items()}
    value = confidence(result.returns)
    inspected = None if "inspected" not in counts else counts["inspected"] / POINTS
    success = counts["docked"] if inspected is None else (inspected >= 1.0).double()
    row = {
        "success": float(success.mean()),
        "crashed": float((~result.survived).double().mean()),
        "decisions": float(result.decisions.double().mean()),
        "value": value.mean,
        "half": value.half_width,
    }
    row |= {name: float(counts[name].mean()) for name in ("speeding", "blinded", "interventions") if name in counts}
    return row if inspected is None else row | {"inspected": interquartile_mean(inspected)}


def our_rate(env: SatelliteTasking, steps: int) -> float:
    """Return decisions per core-second of random actions, with resets."""
    td, done = env.reset(), 0
    begin = time.process_time()
    for _ in range(steps):
        _, td = env.step_and_maybe_reset(td.set("action", WEAK * (2.0 * torch.rand(env.num_envs, 3) - 1.0)))
        done += env.num_envs
    return done / (time.process_time() - begin)


def their_rate(options: argparse.Namespace) -> float:
    """Return decisions per core-second of random actions in the original, with one thread as here."""
    command = [options.original, str(SIDE), "--preset", options.preset, "--steps", str(options.steps), "--weak", str(WEAK)]
    one = os.environ | {"OMP_NUM_THREADS": "1"}
    return float(subprocess.run(command, check=True, capture_output=True, text=True, env=one).stdout)


def speed(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return rates of both sides, in turns."""
    env = bsk_torch.make(options.preset, num_envs=options.batch, seed=0, backend=options.backend)
    our_rate(env, 2)
    rates: dict[str, list[float]] = {"bsk_torch": [], "safe-autonomy-sims": []}
    for _ in range(options.turns):
        rates["bsk_torch"].append(our_rate(env, options.steps))
        if options.original is not None:
            rates["safe-autonomy-sims"].append(their_rate(options))
    batch = {"bsk_torch": options.batch, "safe-autonomy-sims": 1}
    return [
        {"preset": options.preset, "side": side, "batch": batch[side]} | harness.spread("rate", found)
        for side, found in rates.items()
        if found
    ]


def main() -> None:
    """Play, measure and print tables."""
    arguments = harness.parser(
        __doc__,
        preset="CWDocking-v1",
        episodes=1024,
        batch=1024,
        seed=1_000_010,
        filters=["none", "asif", "simplex", "implicit_simplex"],
        policies=["random", "glide", "rush"],
        backend="compiled",
        turns=5,
        steps=100,
    )
    arguments.add_argument("--original", help="interpreter with safe-autonomy-sims")
    arguments.add_argument("--time-limit", type=float, help="s, default that of the preset")
    options, described = harness.begin(arguments)
    rows = harness.Rows(options, described)
    for policy in options.policies:
        for name in options.filters:
            row = {"preset": options.preset, "policy": called(policy), "filter": name} | summary(play(policy, name, options))
            rows.append(row)
            print(harness.table(COLUMNS, [row]), flush=True)
    rates = speed(options) if options.turns else []
    print(harness.table(COLUMNS, rows))
    names = {
        "preset": "{preset}",
        "side": "{side}",
        "batch": "{batch}",
        "decisions per core-s": "{rate:,.0f} ({rate_low:,.0f} to {rate_high:,.0f})",
    }
    print(harness.table(names, rates))
    harness.write(options, described, rows=rows, rates=rates)


if __name__ == "__main__":
    main()
