"""How near policies come to upper bounds: the bound of each episode beside what random actions, rules and trained policies reach.

Usage:
    python benchmarks/bounds.py [--only AEOS-v1/1000 NadirScan-v1 ...] [--episodes 256] [--batch 256] [--seed 1000003]
        [--iterations 30] [--time-limit 0] [--out FILE.json]

No policy may lie above the bound: ``smallest`` is the least difference of any episode, and the script fails where it is negative.
Rows of other tasks that FILE.json has stay in it, each with the commit that it was measured at. In ``AEOSPower-v1/battery`` and
others a resource is plenty: what policies gain there is what that resource costs them.
"""

from __future__ import annotations

import json
import time
from typing import Any

import harness
import torch

import bsk_torch
from bsk_torch.lab.bounds import imaging_bound, scanning_bound
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies import makings, pretrained
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.rules.baselines import BASELINES

BATTERY, STORE, SPEED = 100 * 160.0 * 3600.0, 100 * 100 * 8e6, 10 * 1500.0
"""A hundred times the battery, W s, and the store, bit, of AEOSPower-v1, and ten times its largest wheel speed, rpm."""

PLENTY: dict[str, dict[str, Any]] = {
    "battery": dict(batteryStorageCapacity=BATTERY, storedCharge_Init=BATTERY),
    "wheels": dict(maxWheelSpeed=SPEED),
    "store": dict(dataStorageCapacity=STORE),
}
PLENTY["all"] = {name: value for args in PLENTY.values() for name, value in args.items()}
"""Arguments of AEOSPower-v1's satellite with plenty of a resource."""

CASES: dict[str, tuple[str, dict[str, Any], tuple[str, ...]]] = {
    "AEOS-v1/100": ("AEOS-v1", {"n_targets": 100}, ("random", "nearest", "hasty")),
    "AEOS-v1/1000": ("AEOS-v1", {"n_targets": 1000}, ("random", "nearest", "hasty")),
    "AEOS-v1/3000": ("AEOS-v1", {"n_targets": 3000}, ("random", "nearest", "hasty")),
    "AEOS-v1": ("AEOS-v1", {}, ("random", "nearest", "hasty")),
    "AEOSCity-v1": ("AEOSCity-v1", {}, ("random", "nearest", "hasty")),
    "CloudyAEOS-v1": ("CloudyAEOS-v1", {}, ("random", "nearest", "hasty")),
    "AEOSPower-v1": ("AEOSPower-v1", {}, ("random", "nearest", "hasty")),
    **{f"AEOSPower-v1/{name}": ("AEOSPower-v1", {"sat_args": args}, ("hasty",)) for name, args in PLENTY.items()},
    "NadirScan-v1": ("NadirScan-v1", {}, ("random", "rule")),
    "AEOSConstellation-v1/1000": ("AEOSConstellation-v1", {"n_targets": 1000}, ("random", "hasty")),
}
"""Preset, options and baselines by name."""

COLUMNS = {
    "task": "{task}",
    "policy": "{policy}",
    "return": "{value:.2f} +- {half:.2f}",
    "bound": "{bound:.2f}",
    "share of the bound": "{share:.1%}",
    "smallest difference": "{smallest:.3g}",
    "bound, s for each episode": "{seconds:.2f}",
}


def players(env: Any, sets: Any, preset: str, rules: tuple[str, ...]) -> list[tuple[str, Any, Any]]:
    """Name, environment and policy of all that fly; trained ones see targets as a set."""
    team = not hasattr(env, "satellite")
    found: list[tuple[str, Any, Any]] = [
        (name, env, bsk_torch.rule(name, env) if team else BASELINES[name](env, 0)) for name in rules
    ]
    if preset in makings():
        found.append(("trained", sets, shared(pretrained(preset), sets) if team else pretrained(preset)))
    return found


def with_others(options: Any, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows, behind those of other tasks that the user's file has; the tasks of all become those of ``options``."""
    before = json.loads(options.out.read_text())["rows"] if options.out and options.out.exists() else []
    every = [row for row in before if row["task"] not in options.only] + rows
    every.sort(key=lambda row: list(CASES).index(row["task"]))
    options.only = list(dict.fromkeys(row["task"] for row in every))
    return every


def main() -> None:
    """Compute bounds, fly, and print a table."""
    arguments = harness.parser(
        __doc__, only=list(CASES), episodes=256, batch=256, seed=1_000_003, iterations=30, time_limit=0.0, backend="compiled"
    )
    options, described = harness.begin(arguments)
    rows: list[dict[str, Any]] = []
    for task in options.only:
        preset, choices, rules = CASES[task]
        uppers, seconds = [], 0.0
        returns: dict[str, list[Any]] = {}
        for k in range(0, options.episodes, options.batch):
            world: dict[str, Any] = dict(num_envs=min(options.batch, options.episodes - k), backend=options.backend, **choices)
            world |= {"time_limit": options.time_limit} if options.time_limit else {}
            env: Any = bsk_torch.make(preset, **world)
            sets = env if preset == "NadirScan-v1" else bsk_torch.make(preset, **world, as_set=True)
            env.set_seed(options.seed + k)
            env.reset()
            begin = time.process_time()
            bound = scanning_bound(env) if preset == "NadirScan-v1" else imaging_bound(env, iterations=options.iterations)
            seconds += time.process_time() - begin
            uppers.append(bound.upper)
            for name, where, policy in players(env, sets, preset, rules):
                returns.setdefault(name, []).append(evaluate(policy, where, seed=options.seed + k).returns)
        upper = torch.cat(uppers)
        for name, parts in returns.items():
            value = torch.cat(parts)
            half = 1.96 * float(value.std()) / len(value) ** 0.5 if len(value) > 1 else float("nan")
            row = dict(task=task, policy=name, value=float(value.mean()), half=half, bound=float(upper.mean()))
            row |= dict(
                share=float(value.sum() / upper.sum()), smallest=float((upper - value).min()), seconds=seconds / len(upper)
            )
            rows.append(row | {"episodes": len(value), "commit": described["commit"]})
            print(harness.cell("{task} {policy}: {value:.2f} of {bound:.2f}, smallest {smallest:.3g}", rows[-1]), flush=True)
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=with_others(options, rows))
    above = [row for row in rows if row["smallest"] < 0.0]
    if above:
        raise SystemExit(f"{len(above)} policies lie above the bound: {above}")


if __name__ == "__main__":
    main()
