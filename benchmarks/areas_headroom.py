"""Head-room of tasks of areas: rules, a rule tuned by search, trained policies, and planners that improve either.

Usage:
    python benchmarks/areas_headroom.py [--task areas_revisit] [--settings 128] [--zooms 4] [--episodes 256]
        [--runs FOLDER ...] [--planned 32] [--horizons 1200 5700] [--time-limit 28500] [--satellites 3] [--out FILE.json]

Tasks are those of the suite v3. All fly the same fresh episodes, of which planners have the first ``--planned`` only; gains over
the tuned rule are paired, and the share is this gain as a part of the way from random actions to the entrant. The rule is tuned
by a search in the whole ranges, and by ``--zooms`` others in narrower ones around the best thresholds; ``--settings 0`` takes the
tuned thresholds of ``--out``, or those of the package. ``--runs`` are folders of trainings. Planners fly each of the four actions
in copies of the episode, followed by the tuned rule or by the first of ``--runs`` up to a horizon. Entrants that are measured
again replace their rows of ``--out``. With several ``--satellites``, the task is AreasTeam-v1 instead.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import harness
from sites import COLUMNS, FIRST, figures, play, row
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch.env import Tasking
from bsk_torch.lab.planners import Rollout
from bsk_torch.lab.suites.suite import tasks_of
from bsk_torch.presets.nadir_scan import ORBIT
from bsk_torch.rl.policies.shared_policy import member_view, shared
from bsk_torch.rl.rules.baselines import scan_rule
from bsk_torch.tasks.areas.rules import AreaRule

TUNED = "areas, tuned"

RULES = ("random", "rule", "cautious", "areas")

RANGES = {
    "fast": (0.2, 0.95),
    "low": (0.05, 0.4),
    "enough": (0.1, 0.7),
    "facing": (0.02, 0.5),
    "worth": (0.02, 0.7),
    "full": (0.8, 1.0),
    "lead": (60.0, 600.0),
    "least": (0.0, 0.15),
    "scarce": (0.0, 0.4),
    "rich": (0.0, 2.0),
}
"""Thresholds of the rule, and between which they are tuned."""


def environment(options: argparse.Namespace, episodes: int) -> Tasking:
    """Return the environment of so many episodes that are named by seeds."""
    (task,) = tasks_of("v3", options.task)
    preset, team = ("Areas-v1", {}) if options.satellites == 1 else ("AreasTeam-v1", {"n_satellites": options.satellites})
    arguments = dict(task.options) | {"time_limit": options.time_limit} | team
    env = bsk_torch.make(preset, num_envs=episodes, env_ids=[0] * episodes, **arguments)
    assert isinstance(env, Tasking)
    return env


def areas_rule(env: Tasking, thresholds: AreaRule) -> TensorDictModuleBase:
    """Return the rule *areas* with thresholds for all satellites."""
    return shared(scan_rule(member_view(env), 0, thresholds), env)


def main() -> None:
    """Measure the entrants and print a table."""
    parsed = harness.parser(
        __doc__, task="areas", settings=128, zooms=4, episodes=256, planned=0, time_limit=5 * ORBIT, satellites=1
    )
    parsed.add_argument("--runs", nargs="*", type=Path, default=[], metavar="FOLDER", help="trainings")
    parsed.add_argument("--horizons", nargs="*", type=float, default=[1200.0, ORBIT], metavar="S", help="of planners, s")
    options, described = harness.begin(parsed)
    env = environment(options, options.episodes)
    before = json.loads(options.out.read_text()) if options.out and options.out.exists() else {}
    table: dict[str, dict[str, Any]] = before.get("table", {})
    results: dict[str, Any] = {
        "ranges": RANGES,
        "seeds": [FIRST, FIRST + options.episodes],
        "tuning": before.get("tuning", {}),
    }
    if options.settings:
        tuning = bsk_torch.tune(AreaRule(), env, RANGES, settings=options.settings, zooms=options.zooms)
        results["tuning"] = {name: getattr(tuning, name) for name in ("thresholds", "episodes", "core_seconds")}
        print(tuning, flush=True)
    thresholds = AreaRule(**results["tuning"].get("thresholds", {}))
    chance, _ = play(bsk_torch.rule("random", env), env, FIRST)
    tuned, _ = play(areas_rule(env, thresholds), env, FIRST)

    def enter(name: str, policy: TensorDictModuleBase, where: Tasking) -> None:
        result, cpu = play(policy, where, FIRST)
        table[name] = figures(name, row(result, cpu, tuned, chance)) | {"survival": float(result.survived.double().mean())}
        print(harness.table(COLUMNS, [table[name]]), flush=True)
        harness.write(options, described, table=table, **results)

    for name in RULES if options.settings or not table else ():
        enter(name, bsk_torch.rule(name, env), env)
    enter(TUNED, areas_rule(env, thresholds), env)
    for folder in options.runs:
        enter(f"policy {folder.name}", bsk_torch.load_policy(folder, env), env)
    if options.planned:
        where = environment(options, options.planned)
        bases = {TUNED: areas_rule(where, thresholds)}
        bases |= {f"policy {folder.name}": bsk_torch.load_policy(folder, where) for folder in options.runs[:1]}
        for (base, policy), horizon in itertools.product(bases.items(), options.horizons):
            enter(f"rollout of {base}, {horizon:g} s", Rollout(where, policy, horizon=horizon, gamma=1.0), where)
    print(harness.table(COLUMNS, list(table.values())))


if __name__ == "__main__":
    main()
