"""What do rules and policies return in Services-v1, next to the study that the preset is from?

Usage:
    python benchmarks/services.py [--rules rate angle ...] [--best rate] [--policies RUN ...] [--episodes 100] [--first 0]
        [--batch 100] [--out FILE.json]

All play the same episodes, those of the seeds 0, 1, ... from ``--first`` on, by the study's protocol: 200 objects, half of the
orbits low, 30 percent medium and 20 percent geosynchronous on average, priorities of sum 100, eight of which rise in the middle
of the episode, and rewards for verified images. Policies are folders that ``bsk-torch train`` has written, whose names are shown,
and observe and may do what they did in training. Gains over the rule ``--best`` are paired by episode.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import harness
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch import SatelliteTasking
from bsk_torch.rl.evaluation import Evaluation, evaluate
from bsk_torch.rl.policies.files import policy_of_file, read_card
from bsk_torch.rl.policies.shared_policy import rule
from bsk_torch.tasks.objects.rules import IDLE, ORDERS, WORTHS

PRESET = "Services-v1"

OF_TRAINING = ("order", "as_set", "outlook", "shielded")
"""Options that change what policies observe or may choose, which are those of their training."""

NEEDS_OUTLOOK = ("candidate_rate_ahead",)
"""Rules that read what is expected of images."""

COLUMNS = {
    "policy": "{policy}",
    "return": "{return:.1f} +- {half:.1f}",
    "gain": "{gain:+.1f} +- {gain_half:.1f}",
    "captured": "{captured:.0f}",
    "delivered": "{delivered:.0f}",
    "decisions": "{decisions:.0f}",
    "survival": "{survival:.0%}",
    "episodes": "{episodes}",
    "core-seconds per episode": "{cpu:.2f}",
}


def make_env(options: argparse.Namespace, **preset: Any) -> SatelliteTasking:
    """Return the environment of the study."""
    batch = min(options.batch, options.episodes)
    world = dict(n_targets=options.targets, time_limit=options.time_limit, backend=options.backend)
    env = bsk_torch.make(PRESET, num_envs=batch, env_ids=[0] * batch, **world, **preset)
    assert isinstance(env, SatelliteTasking)
    return env


def row(name: str, found: Evaluation, best: Evaluation, cpu: float) -> dict[str, Any]:
    """Figures of a policy; ``best`` is the rule in the same episodes."""
    gain = found.gain_over(best)
    return {
        "policy": name,
        "episodes": len(found.returns),
        "return": found.mean_return.mean,
        "half": found.mean_return.half_width,
        "gain": gain.mean,
        "gain_half": gain.half_width,
        "captured": float(found.counts["captured"].double().mean()),
        "delivered": float(found.counts["delivered"].double().mean()),
        "decisions": float(found.decisions.double().mean()),
        "survival": found.survival,
        "cpu": cpu / len(found.returns),
    }


def main() -> None:
    """Play the episodes, and print a table."""
    names = ["random", *ORDERS, *(name for name in WORTHS if name not in IDLE)]  # those that wait otherwise are for teams
    parsed = harness.parser(__doc__, rules=names, episodes=100, first=0, batch=100, targets=200, time_limit=45_000.0)
    parsed.add_argument("--best", choices=names, default="rate", help="rule over which gains are")
    parsed.add_argument("--policies", nargs="*", default=[], type=Path, metavar="RUN", help="folders of bsk-torch train")
    parsed.add_argument("--backend", choices=("compiled", "eager"), default="compiled")
    options, described = harness.begin(parsed)
    rows: list[dict[str, Any]] = []
    best: Evaluation | None = None

    def compare(name: str, policy: TensorDictModuleBase, env: SatelliteTasking) -> None:
        nonlocal best
        clock = time.process_time()
        found = evaluate(policy, env, seeds=range(options.first, options.first + options.episodes))
        best = found if best is None else best
        rows.append(row(name, found, best, time.process_time() - clock))
        print(harness.cell("{policy}: {return:.1f}, gain {gain:+.1f} +- {gain_half:.1f}", rows[-1]), flush=True)
        harness.write(options, described, rows=rows)

    envs = {outlook: make_env(options, outlook=outlook) for outlook in (False, True)}
    for name in [options.best, *(name for name in options.rules if name != options.best)]:
        env = envs[name in NEEDS_OUTLOOK]
        compare(name, rule(name, env), env)
    for run in options.policies:
        given = read_card(run)["options"]
        seen = {key: given[key] for key in OF_TRAINING if key in given}
        compare(f"trained, {run.name}", policy_of_file(run), make_env(options, **seen))
    print(harness.table(COLUMNS, rows))


if __name__ == "__main__":
    main()
