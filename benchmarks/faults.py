"""Do policies of FaultyScan-v1 survive faults, also those that were trained without?

Usage:
    python benchmarks/faults.py [--episodes 256] [--out FILE.json]

Rules and the policies of the package for NadirScan-v1, trained without faults, and FaultyScan-v1, trained with all, fly the same
fresh episodes: without faults, with one kind of fault (:data:`CONDITIONS`), and those of the preset, four times as many.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import harness
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch import SatelliteTasking
from bsk_torch.presets.faulty_scan import KINDS
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.policies.shared_policy import rule

PRESET = "FaultyScan-v1"

JUDGED = 3_500_003
"""Seed of the episodes in which policies are compared."""

CONDITIONS: dict[str, tuple[str, ...]] = {"none": (), **{kind: (kind,) for kind in KINDS}, "all": KINDS}
"""Kinds of faults that occur, by condition."""

POLICIES: dict[str, Callable[[SatelliteTasking], TensorDictModuleBase]] = {
    "rule": lambda env: rule("rule", env),
    "cautious": lambda env: rule("cautious", env),
    "trained without faults": lambda env: pretrained("NadirScan-v1"),
    "trained with all faults": lambda env: pretrained(PRESET),
}


def judge(make_policy: Callable[[Any], Any], options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Return survival and return by condition of what ``make_policy`` returns for an environment, with 95 % intervals."""
    found = {}
    for name, kinds in CONDITIONS.items():
        episodes = options.episodes * (4 if kinds == KINDS else 1)
        env = bsk_torch.make(PRESET, num_envs=episodes, kinds=kinds, time_limit=options.time_limit, backend=options.backend)
        result = evaluate(make_policy(env), env, seed=JUDGED)
        low, high = result.survival_interval
        found[name] = {
            "survival": result.survival,
            "survival_low": low,
            "survival_high": high,
            "return": result.mean_return.mean,
            "half": result.mean_return.half_width,
        }
    return found


FORMS = {"survival": "{survival:.1%} ({survival_low:.1%} to {survival_high:.1%})", "return": "{return:.3f} ± {half:.3f}"}
"""Entries of the two tables."""


def main() -> None:
    """Compare, and print two tables."""
    parsed = harness.parser(__doc__, episodes=256, time_limit=28_500.0)
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    found = {name: judge(policy, options) for name, policy in POLICIES.items()}
    for what, form in FORMS.items():
        rows = [{"name": name} | {c: form.format_map(result[c]) for c in CONDITIONS} for name, result in found.items()]
        print(f"{what}\n\n{harness.table({'policy': '{name}'} | {c: f'{{{c}}}' for c in CONDITIONS}, rows)}\n")
    harness.write(options, described, found=found)


if __name__ == "__main__":
    main()
