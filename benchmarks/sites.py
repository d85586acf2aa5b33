"""Head-room of Sites-v1: rules, a rule tuned by search, planners that know what is observed, and trained policies.

Usage:
    python benchmarks/sites.py [--preset Sites-v1] [--settings 256] [--episodes 256] [--planned 24] [--horizon 240]
        [--futures 4 12] [--runs FOLDER ...] [--out FILE.json]

All fly the same fresh episodes, of which planners have the first ``--planned`` only; gains over the tuned rule are paired. The
share is this gain, divided by the difference between the entrant and random actions: part of the way from random actions to the
entrant. ``--settings 0`` takes the numbers of the rule *commit* as they are in the package. ``--runs`` are folders of trainings;
planners with 0 futures know the weather.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch.env import Tasking
from bsk_torch.lab.planners import Rollout
from bsk_torch.rl.evaluation import Evaluation, evaluate
from bsk_torch.rl.policies.shared_policy import member_view, shared
from bsk_torch.tasks.sites.rules import CommitRule, commit

FIRST = 7_500_000
"""First seed of the episodes in which entrants are compared."""

RANDOM, TUNED = "random", "commit, tuned"

RULES = (RANDOM, "nearest", "greedy", "hasty", "farsighted", "commit")

RANGES = {
    "patience": (20.0, 300.0),
    "loyalty": (0.0, 6.0),
    "each": (5.0, 40.0),
    "slack": (-40.0, 100.0),
    "slew": (40.0, 70.0),
    "alone": (0.0, 1.0),
    "nerve": (0.0, 3.0),
}
"""Numbers of the rule that are tuned, and between which."""

GAMMA, TRIED = 0.995, 8
"""Discount of planners per second, and actions that they try."""

COLUMNS = {
    "entrant": "{entrant}",
    "return": "{return:.2f} ± {half:.2f}",
    "episodes": "{episodes}",
    "minus the tuned rule": "{gain:+.2f} ± {gain_half:.2f}",
    "share of the way": "{share:+.3f} ± {share_half:.3f}",
    "core-seconds": "{cpu:.0f}",
}


def environment(options: argparse.Namespace, episodes: int, **more: Any) -> Tasking:
    """Return the environment of so many episodes that are named by seeds."""
    env = bsk_torch.make(options.preset, num_envs=episodes, env_ids=[0] * episodes, **more)
    assert isinstance(env, Tasking)
    return env


def play(policy: TensorDictModuleBase, env: Tasking) -> tuple[Evaluation, float]:
    """Return the results of a policy in the fresh episodes, and the CPU time, s."""
    clock = time.process_time()
    found = evaluate(policy, env, seeds=range(FIRST, FIRST + env.num_envs))
    return found, time.process_time() - clock


def row(entrant: str, found: Evaluation, cpu: float, tuned: Evaluation, chance: Evaluation, **more: Any) -> dict[str, Any]:
    """Return the figures of an entrant; the interval of the share is that of its gain, on the same scale."""
    n = len(found.returns)
    gain = found.gain_over(tuned)
    way = float((found.returns - chance.returns[:n]).mean())
    return {
        "entrant": entrant,
        "episodes": n,
        "return": found.mean_return.mean,
        "half": found.mean_return.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "share": gain.mean / way if way else 0.0,
        "share_half": gain.half_width / way if way else 0.0,
        "cpu": cpu,
        "measures": {name: float(values.mean()) for name, values in found.measures.items()},
        "returns": found.returns.tolist(),
        **more,
    }


def main() -> None:
    """Measure the entrants and print a table."""
    parsed = harness.parser(__doc__, preset="Sites-v1", settings=256, episodes=256, planned=24, horizon=240.0, futures=[4, 12])
    parsed.add_argument("--runs", nargs="*", type=Path, default=[], metavar="FOLDER", help="trainings")
    options, described = harness.begin(parsed)
    env = environment(options, options.episodes)
    results: dict[str, Any] = {"ranges": RANGES, "seeds": [FIRST, FIRST + options.episodes]}
    numbers: dict[str, float] = {}
    if options.settings:
        tuning = bsk_torch.tune(
            CommitRule.of(member_view(environment(options, 2))).decide, env, RANGES, settings=options.settings, fresh=256
        )
        numbers = tuning.thresholds
        results["tuning"] = {"thresholds": numbers, "episodes": tuning.episodes, "core_seconds": tuning.core_seconds}
        print(tuning, flush=True)

    def tuned_rule(where: Tasking) -> TensorDictModuleBase:
        return shared(commit(member_view(where), **numbers), where)

    found = {name: play(bsk_torch.rule(name, env), env) for name in RULES} | {TUNED: play(tuned_rule(env), env)}
    chance, tuned = found[RANDOM][0], found[TUNED][0]
    rows = [row(name, *each, tuned, chance) for name, each in found.items()]

    def enter(name: str, policy: TensorDictModuleBase, where: Tasking, **more: Any) -> None:
        rows.append(row(name, *play(policy, where), tuned, chance, **more))
        print(harness.cell("{entrant}: {return:.2f}, {gain:+.2f} +- {gain_half:.2f}, {cpu:.0f} core-s", rows[-1]), flush=True)
        harness.write(options, described, rows=rows, **results)

    for folder in options.runs:
        card = json.loads((folder / "evaluation.json").read_text()) if (folder / "evaluation.json").exists() else {}
        where = environment(options, options.episodes, as_set=True)
        enter(f"policy {folder.name}", bsk_torch.load_policy(folder, where), where, training=card.get("seconds"))
    if options.planned:
        where = environment(options, options.planned)
        for futures in options.futures:
            planner = Rollout(
                where, tuned_rule(where), horizon=options.horizon, gamma=GAMMA, budget=TRIED, futures=futures or None
            )
            enter(f"rollout, {futures} futures" if futures else "rollout that knows the weather", planner, where)
    harness.write(options, described, rows=rows, **results)
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
