"""What do policies that the members of a team share return in ThreeSensors-v1 or Walker4-v1, next to rules, in the same episodes?

Usage:
    bsk-torch train ThreeSensors-v1 --frames 65536 --seed 0 --out runs/0 --episodes 0   # likewise with other seeds
    python benchmarks/crews.py --preset ThreeSensors-v1 --policies runs/* [--episodes 32] [--rules local ...] [--out FILE.json]

Rules know their own images only (``information="independent"``); ``local`` reads nothing but the environment. Policies observe
and may do what they did in training: those of Walker4-v1 may tell others about their images.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import harness
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch import ConstellationTasking
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.policies.files import policy_of_file, read_card
from bsk_torch.rl.policies.shared_policy import rule, shared

PRESETS = ("ThreeSensors-v1", "Walker4-v1")

RULES = ["local", "prompt", "prompt_ahead"]

COLUMNS = {
    "policy": "{policy}",
    "return": "{return[0]:.1f} +- {return[1]:.1f}",
    "paid images": "{acquisitions:.1f}",
    "deliveries": "{services:.1f}",
    "duplicate attempts": "{duplicate_attempts:.1f}",
    "decisions": "{decisions:.0f}",
    "core-seconds per episode": "{cpu:.1f}",
}


Played = tuple[TensorDictModuleBase, ConstellationTasking]
"""A policy for all satellites, and the environment in which it decides."""


def make_env(options: argparse.Namespace, **team: Any) -> ConstellationTasking:
    """Return the environment of a team."""
    world = dict(n_targets=options.targets, time_limit=options.time_limit, backend=options.backend)
    env = bsk_torch.make(options.preset, num_envs=options.episodes, **(team | world))
    assert isinstance(env, ConstellationTasking)
    return env


def ruled(name: str, env: ConstellationTasking) -> Played:
    """Return a rule."""
    return rule(name, env), env


def trained(run: Path, options: argparse.Namespace) -> Played:
    """Return the policy of a run, in an environment with the options of its training."""
    env = make_env(options, **read_card(run)["options"])
    return shared(policy_of_file(run), env), env


def row(name: str, played: dict[str, Evaluation], rules: list[str], cpu: float) -> dict[str, Any]:
    """Figures of a policy, with its gains over those ``rules`` that have been ``played``; intervals are means and half-widths."""
    found = played[name]
    gains = {other: found.gain_over(played[other]) for other in rules if other in played}
    counts = {count: float(found.counts[count].double().mean()) for count in ("acquisitions", "services", "duplicate_attempts")}
    return {
        "policy": name,
        "episodes": len(found.returns),
        "return": [found.mean_return.mean, found.mean_return.half_width],
        "over": {other: [gain.mean, gain.half_width] for other, gain in gains.items()},
        **counts,
        "decisions": float(found.decisions.double().mean()),
        "survival": found.survival,
        "cpu": cpu,
    }


def main() -> None:
    """Play the episodes, and print a table."""
    parsed = harness.parser(__doc__, rules=RULES, episodes=32, targets=100, time_limit=45_000.0)
    parsed.add_argument("--preset", choices=PRESETS, default=PRESETS[0])
    parsed.add_argument("--policies", nargs="*", default=[], type=Path, metavar="RUN", help="folders of bsk-torch train")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    env = make_env(options, information="independent", as_set=True, outlook=True, shielded=True)
    policies: dict[str, Callable[[], Played]] = {name: partial(ruled, name, env) for name in options.rules}
    policies |= {f"trained, {run.name}": partial(trained, run, options) for run in options.policies}
    played: dict[str, Evaluation] = {}
    cpu: dict[str, float] = {}
    for name, make in policies.items():
        policy, env = make()
        clock = time.process_time()
        played[name] = evaluate(policy, env, seed=FRESH)
        cpu[name] = (time.process_time() - clock) / options.episodes
        rows = [row(each, played, options.rules, cpu[each]) for each in played]
        print(harness.cell("{policy}: {return[0]:.1f} +- {return[1]:.1f}", rows[-1]), flush=True)
        harness.write(options, described, rows=rows)
    gains = {f"over {name}": f"{{over[{name}][0]:+.1f}} +- {{over[{name}][1]:.1f}}" for name in options.rules}
    print(harness.table(COLUMNS | gains, rows))


if __name__ == "__main__":
    main()
