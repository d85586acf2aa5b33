"""Does training with faults help when parts fail, also parts that never failed in training?

Usage:
    python benchmarks/faults.py [--frames 600000] [--seeds 3] [--episodes 128] [--trainings NAME ...] [--out FILE.json]

Policies of FaultyScan-v1 that do not observe faults are trained with different kinds of them, :data:`TRAININGS`, by the recipe of
the preset, except that they imitate first what ``rule`` does, whose thresholds were chosen without faults. They, rules and the
package's policy for NadirScan-v1 fly the same fresh episodes: without faults, with one kind of fault (:data:`CONDITIONS`), and
with all, four times as many. Each kind of fault that may occur is expected once in an episode.
"""

from __future__ import annotations

import argparse
import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import harness

import bsk_torch
from bsk_torch.presets.faulty_scan import KINDS
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.rl.training import configure
from bsk_torch.rl.training.trainer import Training

PRESET = "FaultyScan-v1"

JUDGED = 3_500_003
"""Seed of the episodes in which policies are compared."""

CONDITIONS: dict[str, tuple[str, ...]] = {"none": (), **{kind: (kind,) for kind in KINDS}, "all": KINDS}
"""Kinds of faults that occur, by condition."""

RULES = ("rule", "cautious")

PACKAGED = {"package, faults: none": "NadirScan-v1"}
"""Presets of the package's policies, whose trainings were longer, by name."""

FAULTS: dict[str, Any] = dict(chance=1.0, observed=False)
"""Options of the preset."""

TRAININGS: dict[str, tuple[str, ...]] = {
    "none": (),
    "wheels": ("wheel", "friction"),
    "all": KINDS,
}
"""Kinds of faults that occur in training."""

Results = dict[str, dict[str, float]]
"""Survival and return by condition."""


def train(name: str, seed: int, options: argparse.Namespace, folder: Path) -> tuple[Any, int]:
    """Return a policy, and the number of decisions that it has learned from."""
    world = FAULTS | dict(kinds=list(TRAININGS[name]), time_limit=options.time_limit, backend=options.backend)
    sizes = dict(num_envs=options.num_envs, imitate="rule", evaluate_every=options.evaluate_every) | harness.budget(options)
    training = Training(configure(PRESET, seed=seed, **sizes, options=world), folder)  # type: ignore[arg-type]
    policy = training.run(bar=False)
    return policy, training.progress.frames


@functools.cache
def condition(kinds: tuple[str, ...], episodes: int, **world: Any) -> Any:
    """Return the environment of a condition, in which all policies are judged."""
    return bsk_torch.make(PRESET, num_envs=episodes, kinds=kinds, **FAULTS, **world)


def judge(make_policy: Callable[[Any], Any], options: argparse.Namespace) -> Results:
    """Return survival and return by condition of what ``make_policy`` returns for an environment, with 95 % intervals."""
    found = {}
    world = dict(time_limit=options.time_limit, backend=options.backend)
    for name, kinds in CONDITIONS.items():
        episodes = options.episodes * (4 if kinds == KINDS else 1)
        env = condition(kinds, episodes, **world)
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


def shown(results: list[Results], condition: str, what: str) -> str:
    """Return the entry of a table: mean, least and largest value of several trainings under a condition."""
    return harness.of_seeds([each[condition][what] for each in results], "{:.1%}" if what == "survival" else "{:.3f}")


def main() -> None:
    """Train, compare, and print two tables."""
    parsed = harness.parser(
        __doc__, seconds=60.0, frames=600_000, seeds=3, episodes=128, num_envs=256, evaluate_every=100_000, time_limit=28_500.0
    )
    parsed.add_argument("--trainings", nargs="+", choices=TRAININGS, default=list(TRAININGS), metavar="NAME")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    found = {name: [judge(lambda env, name=name: rule(name, env), options)] for name in RULES}  # type: ignore[misc]
    found |= {name: [judge(lambda env, of=of: pretrained(of), options)] for name, of in PACKAGED.items()}  # type: ignore[misc]
    frames: dict[str, list[int]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in options.trainings:
            for seed in range(options.seeds):
                policy, count = train(name, seed, options, Path(folder) / f"{name}-{seed}")
                found.setdefault(f"trained, faults: {name}", []).append(judge(lambda env, policy=policy: policy, options))  # type: ignore[misc]
                frames.setdefault(name, []).append(count)
                harness.write(options, described, found=found, frames=frames)
    for what in ("survival", "return"):
        rows = [{"name": name} | {c: shown(results, c, what) for c in CONDITIONS} for name, results in found.items()]
        print(f"{what}\n\n{harness.table({'policy': '{name}'} | {c: f'{{{c}}}' for c in CONDITIONS}, rows)}\n")
    harness.write(options, described, found=found, frames=frames)


if __name__ == "__main__":
    main()
