"""Do learners of other libraries beat the best rule, with a discount per second?

Usage:
    python benchmarks/learners.py [--learners TorchRL-PPO ...] [--seeds 0 1 2] [--episodes 1024] [--settings steps=100000 ...]
        [--out FILE.json]

Trains the examples of :data:`LEARNERS` in NadirScan-v1, once for each seed, and compares each policy with the best of the
package's rules in the same fresh episodes. Core-seconds are those of the training,
with compilation, resets and log lines.
"""

from __future__ import annotations

import importlib
import time
from dataclasses import asdict
from typing import Any

import harness
from tensordict.nn import TensorDictModule, TensorDictModuleBase

import bsk_torch
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.policies.shared_policy import shared_baselines

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

COLUMNS = {
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


def row(learner: str, seed: int, options: Any) -> dict[str, Any]:
    """Train with a seed and compare the policy with the best rule."""
    file, chosen = LEARNERS[learner]
    example = importlib.import_module(f"examples.{file}")
    settings = example.arguments([*chosen, f"--seed={seed}", *(f"--{setting}" for setting in options.settings)])
    begin = time.process_time()
    trained = example.train(settings)
    seconds = time.process_time() - begin
    limit = {} if settings.time_limit is None else {"time_limit": settings.time_limit}
    env = bsk_torch.make(PRESET, num_envs=options.episodes, **limit)
    result = evaluate(policy_of(file, trained), env, seed=JUDGED)
    rules = {name: evaluate(rule, env, seed=JUDGED) for name, rule in shared_baselines(env, JUDGED).items()}
    best = max(rules, key=lambda name: rules[name].mean_return.mean)
    return {
        "learner": learner,
        "seed": seed,
        "steps": settings.steps,
        "core_seconds": seconds,
        "rule": best,
        "rule_return": asdict(rules[best].mean_return),
        "return": asdict(result.mean_return),
        "gain": asdict(result.gain_over(rules[best])),
        "survival": result.survival,
    }


def main() -> None:
    """Measure and print."""
    parsed = harness.parser(__doc__, learners=list(LEARNERS), seeds=[0, 1, 2], episodes=1024)
    parsed.add_argument("--settings", nargs="+", default=[], metavar="NAME=VALUE", help="options of the examples")
    options, described = harness.begin(parsed)
    rows: list[dict[str, Any]] = []
    for learner in options.learners:
        for seed in options.seeds:
            rows.append(row(learner, seed, options))
            print(harness.table(COLUMNS, rows[-1:]), flush=True)
            harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
