"""Do learners of other libraries beat the best rule, with a discount per second?

Usage:
    python benchmarks/learners.py [--learners TorchRL-PPO ...] [--seeds 0 1 2] [--episodes 1024] [--settings steps=100000 ...]
        [--tasks areas sites --bench FILE.json] [--out FILE.json]

Trains the examples of :data:`LEARNERS` in NadirScan-v1, once for each seed, and compares each policy with the best of the
package's rules in the same fresh episodes. Core-seconds are those of the training,
with compilation, resets and log lines.

With ``--tasks``, trains in tasks of the suite v3, with the discount of the package's own trainings there, and plays the first
``--episodes`` of the suite. The rule is the published one. ``--bench`` writes a file such as ``bsk-torch bench`` does.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from itertools import product
from pathlib import Path
from statistics import mean
from typing import Any, NamedTuple

import harness
import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase

import bsk_torch
from bsk_torch.lab.commands.bench import document, result_of
from bsk_torch.lab.suites.aggregates import bootstrap, interval
from bsk_torch.lab.suites.suite import SUITES, play, published, references
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.rl.policies.shared_policy import shared_baselines
from bsk_torch.tasks.areas.recipe import AREAS
from bsk_torch.tasks.sites.recipe import SITES

PRESET = "NadirScan-v1"

JUDGED = 5_600_001
"""Seed of the episodes in which policies are compared."""

LEARNERS = {
    "TorchRL-PPO": ("learners_torchrl", []),
    "TorchRL-DQN": ("learners_torchrl", ["--learner=dqn"]),
    "TorchRL-SAC": ("learners_torchrl", ["--learner=sac"]),
    "SB3-MaskablePPO": ("ppo_sb3", []),
    "SB3-DQN": ("ppo_sb3", ["--algorithm=dqn"]),
    "single-file-PPO": ("ppo_cleanrl", []),
}
"""Examples and their arguments, by learner."""

LIBRARIES = {"learners_torchrl": "torchrl", "ppo_sb3": "stable-baselines3", "ppo_cleanrl": "torch"}
"""Packages that learn, by example."""

TASKS = {task.title: task for task in SUITES["v3"] if not task.options}
"""Tasks of the suite that are presets without options, which the examples do not take."""

GAMMAS = {"areas": AREAS["mlp"]["gamma"], "sites": SITES["attention"]["gamma"]}
"""Discounts per second by task."""

COLUMNS = {
    "task": "{task}",
    "learner": "{learner}",
    "seed": "{seed}",
    "decisions": "{steps:,}",
    "core-s": "{core_seconds:.0f}",
    "return": "{return[mean]:.3f} +- {return[half_width]:.3f}",
    "over the best rule": "{gain[mean]:+.3f} +- {gain[half_width]:.3f}",
    "survival": "{survival:.1%}",
}


def policy_of(file: str, trained: Any) -> TensorDictModuleBase:
    """Return what an example has trained as a policy of most probable actions."""
    if file == "ppo_sb3":
        return importlib.import_module("examples.ppo_sb3").as_policy(*trained)
    if file == "ppo_cleanrl":
        keys = ["observation", "action_mask"]
        return TensorDictModule(lambda seen, legal: trained[0].policy(seen, legal).probs.argmax(-1), keys, ["action"])
    policy: TensorDictModuleBase = trained
    return policy


class Trained(NamedTuple):
    """A policy, the settings of its training, the decisions that it took, and the core-seconds."""

    policy: TensorDictModuleBase
    settings: argparse.Namespace
    decisions: int
    core_seconds: float


def train(learner: str, seed: int, settings: list[str]) -> Trained:
    """Train with a seed; ``settings`` are arguments of the example."""
    file, chosen = LEARNERS[learner]
    example = importlib.import_module(f"examples.{file}")
    options = example.arguments([*chosen, f"--seed={seed}", *(f"--{setting}" for setting in settings)])
    begin = time.process_time()
    trained = example.train(options)
    seconds = time.process_time() - begin
    if file == "ppo_sb3":
        return Trained(policy_of(file, trained), options, trained[0].num_timesteps, seconds)
    replayed = getattr(options, "learner", "ppo") != "ppo"
    batch, random = options.num_envs * (1 if replayed else options.rollout), options.num_envs * options.rollout * replayed
    return Trained(policy_of(file, trained), options, max(batch, options.steps // batch * batch) + random, seconds)


def in_scan(trained: Trained, options: argparse.Namespace) -> dict[str, Any]:
    """Compare a policy with the best rule in NadirScan-v1."""
    limit = {} if trained.settings.time_limit is None else {"time_limit": trained.settings.time_limit}
    env = bsk_torch.make(PRESET, num_envs=options.episodes, **limit)
    result = evaluate(trained.policy, env, seed=JUDGED)
    rules = {name: evaluate(rule, env, seed=JUDGED) for name, rule in shared_baselines(env, JUDGED).items()}
    best = max(rules, key=lambda name: rules[name].mean_return.mean)
    return {
        "rule": best,
        "rule_return": asdict(rules[best].mean_return),
        "return": asdict(result.mean_return),
        "gain": asdict(result.gain_over(rules[best])),
        "survival": result.survival,
    }


def rule_of(title: str, episodes: int) -> tuple[str, torch.Tensor]:
    """Return the published rule of a task and its returns in the first ``episodes``."""
    known = published("v3")
    best = next(name for name in known["methods"]["rules"] if title in known["policies"][name])
    return best, torch.tensor(known["policies"][best][title]["returns"][:episodes], dtype=torch.float64)


def in_suite(title: str, learner: str, trained: Trained, options: argparse.Namespace) -> tuple[dict[str, Any], dict[str, Any]]:
    """Compare a policy with the best rule in a task of the suite; return also the result as ``bsk-torch bench`` writes it."""
    episodes = min(options.episodes, TASKS[title].episodes)
    score = play(TASKS[title], lambda preset, make: (make(), trained.policy), episodes)
    assert score is not None
    cost = {"decisions": trained.decisions, "core_seconds": round(trained.core_seconds, 1), "tuning_runs": 0}
    best, rule = rule_of(title, episodes)
    row = {
        "task": title,
        "gamma": trained.settings.gamma,
        "rule": best,
        "rule_return": asdict(confidence(rule)),
        "return": asdict(score.evaluation.mean_return),
        "gain": asdict(confidence(score.evaluation.returns.double().cpu() - rule)),
        "survival": score.evaluation.survival,
    }
    package = LIBRARIES[LEARNERS[learner][0]]
    return row, result_of(score, references("v3")[title]) | {"library": f"{package} {version(package)}", "training": cost}


def summaries(played: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return means over the seeds of each learner and task, with 95 % intervals of a bootstrap of seeds and episodes."""
    rows: list[dict[str, Any]] = []
    for title, learner in sorted({(title, name.partition("/")[0]) for name, tasks in played.items() for title in tasks}):
        runs = [tasks[title] for name, tasks in played.items() if name.startswith(f"{learner}/") and title in tasks]
        returns = torch.tensor([run["returns"] for run in runs], dtype=torch.float64)
        best, rule = rule_of(title, returns.shape[1])
        values = {"return": returns, "gain": returns - rule}
        drawn = bootstrap({name: {title: value} for name, value in values.items()})
        row = {
            "task": title,
            "learner": learner,
            "seeds": len(runs),
            "rule": best,
            "survival": mean(run["survival"] for run in runs),
            "core_seconds": mean(run["training"]["core_seconds"] for run in runs),
        }
        rows.append(row | {name: interval(value.mean(), drawn[name].mean((1, 2)))._asdict() for name, value in values.items()})
    return rows


def main() -> None:
    """Measure and print."""
    parsed = harness.parser(__doc__, learners=list(LEARNERS), seeds=[0, 1, 2], episodes=1024)
    parsed.add_argument("--settings", nargs="+", default=[], metavar="NAME=VALUE", help="options of the examples")
    parsed.add_argument("--tasks", nargs="+", default=[], choices=TASKS, help="train and play in tasks of the suite v3")
    parsed.add_argument("--bench", type=Path, metavar="FILE.json", help="returns of all episodes of these tasks")
    options, described = harness.begin(parsed)
    rows: list[dict[str, Any]] = []
    played: dict[str, dict[str, Any]] = {}
    for title, learner, seed in product(options.tasks or [None], options.learners, options.seeds):
        task = [f"preset={TASKS[title].preset}", f"gamma={GAMMAS[title]}"] if title else []
        trained = train(learner, seed, [*task, *options.settings])
        if title:
            row, played.setdefault(f"{learner}/seed_{seed}", {})[title] = in_suite(title, learner, trained, options)
        else:
            row = in_scan(trained, options)
        rows.append({"learner": learner, "seed": seed, "steps": trained.decisions, "core_seconds": trained.core_seconds, **row})
        print(harness.table(COLUMNS, rows[-1:]), flush=True)
        harness.write(options, described, rows=rows, **({"summaries": summaries(played)} if played else {}))
        if options.bench:
            tasks = [TASKS[name] for name in options.tasks]
            content = document("v3", tasks, min(options.episodes, max(task.episodes for task in tasks)), played)
            options.bench.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
