"""Head-room of Sites-v1, SitesTeam-v1 and TipAndCue-v1: rules, one tuned, planners that know what is observed, and policies.

Usage:
    python benchmarks/sites.py [--preset Sites-v1] [--gain convex] [--risk 0] [--settings 128] [--zooms 2] [--episodes 256]
        [--planned 16] [--horizon 180] [--futures 4 12] [--tried 8] [--schedules 8] [--time-limit 2850] [--base FOLDER]
        [--first 7500000] [--runs FOLDER ...] [--join FILE.json ...] [--out FILE.json]

All fly the same fresh episodes, of which planners have the first ``--planned`` only; gains over the tuned rule are paired. The
share is this gain as a part of the way from random actions to the entrant, or to the tuned rule if that is farther. ``--settings
0`` takes the tuned numbers of ``--out``, or those of the package. ``--runs`` are folders of trainings; planners with 0 futures
know the weather. ``--schedules`` are widths of the search of ``bsk_torch.tasks.sites.schedule``, which flies all episodes.
Entrants that are measured again replace their rows of ``--out``, others stay. Planners take long: several runs, with another
``--first`` each, can share their episodes, which ``--join`` collects.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import harness
import torch
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch.env import Tasking
from bsk_torch.lab.planners import Rollout
from bsk_torch.presets.aeos import ORBIT
from bsk_torch.rl.evaluation import Evaluation, evaluate
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.policies.shared_policy import member_view, shared
from bsk_torch.tasks.sites.rules import CommitRule, commit
from bsk_torch.tasks.sites.schedule import schedule

FIRST = 7_500_000
"""First seed of the episodes in which entrants are compared."""

TUNED, ALONE, PLANNER = "commit, tuned", "commit, uncoordinated", "rollout"

RULES = ("random", "nearest", "greedy", "hasty", "farsighted", "commit")

RANGES = {
    "patience": (20.0, 300.0),
    "loyalty": (0.0, 6.0),
    "each": (5.0, 40.0),
    "reserve": (-20.0, 30.0),
    "doubt": (2.0, 40.0),
    "slew": (45.0, 90.0),
    "alone": (0.0, 1.0),
    "nerve": (0.0, 3.0),
}
"""Numbers of the rule that are tuned, and between which."""

SHARED = {"yielding": (0.0, 1.2)}
"""The same in teams only."""

LOOKS = {"hope": (0.05, 1.0), "rush": (10.0, 300.0), "busy": (0.0, 1.5)}
"""The same with wide looks only, where the nerve has no effect."""

GAMMA = 0.995
"""Discount of planners per second."""

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
    names = {"SitesTeam-v1": (), "TipAndCue-v1": ("gain",)}.get(options.preset, ("gain", "risk"))
    task = {name: getattr(options, name) for name in names}
    env = bsk_torch.make(options.preset, num_envs=episodes, env_ids=[0] * episodes, time_limit=options.time_limit, **task, **more)
    assert isinstance(env, Tasking)
    return env


def play(policy: TensorDictModuleBase, env: Tasking, first: int) -> tuple[Evaluation, float]:
    """Return the results of a policy in the fresh episodes, and the CPU time, s."""
    clock = time.process_time()
    result = evaluate(policy, env, seeds=range(first, first + env.num_envs))
    return result, time.process_time() - clock


def row(result: Evaluation, cpu: float, tuned: Evaluation, chance: Evaluation) -> dict[str, Any]:
    """Return the returns of an entrant, and its gains over the tuned rule and over random actions in the same episodes."""
    n = len(result.returns)
    others = {"gains": tuned, "over_random": chance}
    return {
        "returns": result.returns.tolist(),
        **{name: (result.returns - other.returns[:n]).tolist() for name, other in others.items()},
        "measures": {name: float(values.mean()) for name, values in result.measures.items()},
        "cpu": cpu,
    }


def joined(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of an entrant that has flown different episodes in several runs."""
    lists = {name: [x for part in parts for x in part[name]] for name in ("returns", "gains", "over_random")}
    return {**parts[0], **lists, "cpu": sum(part["cpu"] for part in parts)}


def figures(entrant: str, one: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of an entrant's row; the interval of the share is that of its gain, on the same scale."""
    mean, gain = (confidence(torch.tensor(one[name], dtype=torch.float64)) for name in ("returns", "gains"))
    way = sum(one["over_random"]) / len(one["over_random"]) - min(0.0, gain.mean) or 1.0
    return {
        "entrant": entrant,
        "episodes": len(one["returns"]),
        "return": mean.mean,
        "half": mean.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "share": gain.mean / way,
        "share_half": gain.half_width / way,
        "cpu": one["cpu"],
        "measures": one["measures"],
    }


def main() -> None:
    """Measure the entrants and print a table."""
    parsed = harness.parser(
        __doc__, preset="Sites-v1", settings=128, zooms=2, episodes=256, planned=16, horizon=180.0, futures=[4, 12], tried=8,
        first=FIRST, time_limit=ORBIT / 2, gain="complete", risk=0.4,
    )  # fmt: skip
    parsed.add_argument("--runs", nargs="*", type=Path, default=[], metavar="FOLDER", help="trainings")
    parsed.add_argument("--schedules", nargs="*", type=int, default=[], metavar="WIDTH", help="widths of beam searches")
    parsed.add_argument("--base", type=Path, metavar="FOLDER", help="training whose policy planners improve instead of the rule")
    parsed.add_argument(
        "--join", nargs="*", type=Path, default=[], metavar="FILE", help="files whose planners flew other episodes"
    )
    options, described = harness.begin(parsed)
    env = environment(options, options.episodes)
    before = json.loads(options.out.read_text()) if options.out and options.out.exists() else {}
    table: dict[str, dict[str, Any]] = before.get("table", {})
    flown: dict[str, dict[str, Any]] = before.get("flown", {})  # by planners, to be joined
    more = CommitRule.of(member_view(env)).more
    team = "site_claims" in more
    ranges = RANGES | (SHARED if team else {}) | (LOOKS if "wide" in more else {})
    results: dict[str, Any] = {
        "ranges": ranges,
        "seeds": [options.first, options.first + options.episodes],
        "tuning": before.get("tuning", {}),
    }
    if options.settings:
        rule = commit(member_view(env)).module
        tuning = bsk_torch.tune(rule, env, ranges, settings=options.settings, zooms=options.zooms)
        results["tuning"] = {name: getattr(tuning, name) for name in ("thresholds", "episodes", "core_seconds")}
        print(tuning, flush=True)
    numbers = results["tuning"].get("thresholds", {})

    def tuned_rule(where: Tasking) -> TensorDictModuleBase:
        return shared(commit(member_view(where), **numbers), where)

    chance, _ = play(bsk_torch.rule("random", env), env, options.first)
    tuned, _ = play(tuned_rule(env), env, options.first)

    def note(name: str, one: dict[str, Any]) -> None:
        table[name] = figures(name, one)
        if name.startswith(PLANNER):
            flown[name] = one
        print(harness.cell("{entrant}: {return:.2f}, {gain:+.2f} +- {gain_half:.2f}, {cpu:.0f} core-s", table[name]), flush=True)
        harness.write(options, described, table=table, flown=flown, **results)

    def enter(name: str, policy: TensorDictModuleBase, where: Tasking) -> None:
        note(name, row(*play(policy, where, options.first), tuned, chance))

    for name in RULES if options.settings or not table else ():
        enter(name, bsk_torch.rule(name, env), env)
    enter(TUNED, tuned_rule(env), env)
    if team:
        enter(ALONE, shared(commit(member_view(env), coordinated=False), env), env)
    for width in options.schedules:
        enter(f"schedule, width {width}", schedule(env, width=width), env)
    for folder in options.runs:
        where = environment(options, options.episodes, as_set=True)
        enter(f"policy {folder.name}", bsk_torch.load_policy(folder, where), where)
    for futures in options.futures if options.planned else ():
        where = environment(options, options.planned, as_set=options.base is not None)
        base = bsk_torch.load_policy(options.base, where) if options.base else tuned_rule(where)
        planner = Rollout(where, base, horizon=options.horizon, gamma=GAMMA, budget=options.tried, futures=futures or None)
        enter(f"{PLANNER}{' of a policy' * bool(options.base)}, {futures} futures", planner, where)
    for path in options.join:
        for name, one in json.loads(path.read_text())["flown"].items():
            note(name, joined([flown[name], one]) if name in flown else one)
    print(harness.table(COLUMNS, list(table.values())))


if __name__ == "__main__":
    main()
