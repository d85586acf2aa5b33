"""Train a constellation with MAPPO or IPPO, and compare it with rules on fresh episodes.

    python scripts/train_constellation.py --algorithm mappo --minutes 8
    python scripts/train_constellation.py --algorithm ippo --no-share
    python scripts/train_constellation.py --preset AEOSConstellation-v1 --n-targets 3000 --time-limit 5700

The table pairs episodes: "lead" is by how much the trained policy does better in the same ones, with 95 % confidence intervals.
"""

from __future__ import annotations

import argparse
import json
import logging
from datetime import datetime
from pathlib import Path
from typing import Any

import torch

from bsk_torch.comm import NoCommunication
from bsk_torch.presets import make
from bsk_torch.rl.crew import Crew, crew_baseline, evaluate_crew
from bsk_torch.rl.evaluate import FRESH, Evaluation
from bsk_torch.rl.marl import LOSSES, CrewConfig, CrewTraining

RULES = ("greedy", "nearest", "hasty", "random")
"""What the trained policy is compared with."""


def environment_options(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of the environment that the command line sets."""
    chosen: dict[str, Any] = {"as_set": True, "backend": options.backend}
    chosen |= {name: value for name in ("n_targets", "time_limit") if (value := getattr(options, name)) is not None}
    return chosen if options.share else chosen | {"communicator": NoCommunication()}


def table(results: dict[str, Evaluation]) -> str:
    """Markdown table of team returns, and of the lead that the first policy has over the others."""
    first = next(iter(results.values()))
    lines = ["| policy | team return | lead of the first | images | for nothing | decisions |", "|---|---|---|---|---|---|"]
    for name, result in results.items():
        images, wasted = (float(result.counts[count].double().mean()) for count in ("imaged", "duplicates"))
        lead = "-" if result is first else str(first.gain_over(result))
        decisions = float(result.decisions.double().mean())
        lines.append(f"| {name} | {result.mean_return} | {lead} | {images:.0f} | {wasted:.0f} | {decisions:.0f} |")
    return "\n".join(lines)


def save(results: dict[str, Evaluation], path: Path) -> None:
    """Write the returns of all episodes, so that others can be compared with them."""
    path.write_text(json.dumps({name: result.returns.tolist() for name, result in results.items()}) + "\n")


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Train a constellation with MAPPO or IPPO, and compare it with rules.")
    parser.add_argument("--preset", default="Constellation-v1", help="environment whose satellites are all alike")
    parser.add_argument("--algorithm", default="mappo", choices=sorted(LOSSES))
    parser.add_argument("--minutes", type=float, default=8.0, help="training time after compilation")
    parser.add_argument("--num-envs", type=int, default=64, help="episodes at once")
    parser.add_argument("--rollout", type=int, default=128, help="steps of each between two updates")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=256, help="fresh episodes for every evaluation")
    parser.add_argument("--n-targets", type=int, help="targets of an episode, instead of the preset's")
    parser.add_argument("--time-limit", type=float, help="length of an episode, s, instead of the preset's")
    parser.add_argument("--share", action=argparse.BooleanOptionalAction, default=True, help="tell others what has been imaged")
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument("--out", type=Path, help="folder for the results; a new one in runs/ unless given")
    return parser.parse_args()


def main() -> None:
    """Train, evaluate, and leave everything in a folder."""
    options = arguments()
    torch.set_num_threads(1)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    config = CrewConfig(
        preset=options.preset,
        algorithm=options.algorithm,
        seconds=60.0 * options.minutes,
        num_envs=options.num_envs,
        rollout=options.rollout,
        seed=options.seed,
        options=environment_options(options),
    )
    out = options.out or Path("runs") / f"{options.preset}_{options.algorithm}_{datetime.now():%Y%m%d-%H%M%S}"
    policy = Crew(CrewTraining(config, out).run())
    env = make(config.preset, num_envs=options.episodes, **config.options)
    policies = {options.algorithm: policy} | {rule: crew_baseline(rule, env, options.seed) for rule in RULES}
    results = {name: evaluate_crew(made, env, seed=options.seed + FRESH) for name, made in policies.items()}
    print(table(results))
    save(results, out / "evaluation.json")
    print(f"policy, log and returns are in {out}")


if __name__ == "__main__":
    main()
