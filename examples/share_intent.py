"""
Single-satellite policy in a constellation
==========================================

Fly a constellation with a policy trained on one satellite, and let satellites share the list of imaged targets.

On the command line::

    python examples/share_intent.py --minutes 4                train on one satellite first
        python examples/share_intent.py --policy runs/alone        use the run folder of an earlier training

Based on "Intent Sharing for Emergent Collaboration in Autonomous Earth Observing Constellations", a study with bsk_rl. The only
coordination is that targets reported as imaged by another satellite are no longer observed.
"""

# sphinx_gallery_thumbnail_path = "_static/readme/Constellation-v1.png"

from __future__ import annotations

import argparse
import json
import logging
from datetime import datetime
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase

import bsk_torch
from bsk_torch import comm
from bsk_torch.presets import make
from bsk_torch.rl.evaluation import FRESH, Evaluation, evaluate
from bsk_torch.rl.marl import MAPPOConfig, MAPPOTraining, SharedPolicy
from bsk_torch.rl.policies import policy_of_file

SHARING: dict[str, comm.CommunicationMethod] = {
    "none": comm.NoCommunication(),
    "line of sight": comm.LOSCommunication(),
    "line of sight, passed on": comm.LOSMultiCommunication(),
    "all": comm.FreeCommunication(),
}
"""Communication methods."""


def train_alone(
    options: argparse.Namespace, world: dict[str, Any], out: Path
) -> TensorDictModuleBase:
    """Train a policy in an equal environment with a single satellite.

    In a constellation, others image many of the targets, so the number of targets is varied down to a tenth. With all targets in
    every episode, the policy would gain almost nothing by sharing.
    """
    targets = options.n_targets // 10, options.n_targets + 1
    config = MAPPOConfig(
        algorithm="ippo",
        seconds=60.0 * options.minutes,
        num_envs=options.num_envs,
        rollout=32,
        minibatch=1024,
        seed=options.seed,
        options=world
        | {"n_satellites": 1, "n_planes": 1, "phasing": 0, "n_targets": targets},
    )
    return MAPPOTraining(config, out).run()


def row(who: str, sharing: str, result: Evaluation, alone: Evaluation) -> str:
    """Return a table row: a result, and its gain over the result without sharing in the same episodes."""
    images, wasted = (
        float(result.counts[name].double().mean()) for name in ("imaged", "duplicates")
    )
    gain = "-" if result is alone else str(result.gain_over(alone))
    return f"| {who} | {sharing} | {result.mean_return} | {gain} | {images:.0f} | {wasted:.0f} |"


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description="Fly a constellation with a policy trained on one satellite."
    )
    parser.add_argument(
        "--policy",
        type=Path,
        help="run folder of an earlier training, instead of a new one",
    )
    parser.add_argument(
        "--minutes", type=float, default=4.0, help="training time after compilation"
    )
    parser.add_argument(
        "--num-envs",
        type=int,
        default=256,
        help="number of training environments",
    )
    parser.add_argument(
        "--episodes", type=int, default=256, help="unseen episodes per evaluation"
    )
    parser.add_argument(
        "--n-satellites", type=int, default=12, help="satellites in the constellation"
    )
    parser.add_argument(
        "--n-targets",
        type=int,
        default=5000,
        help="targets in an episode of the constellation",
    )
    parser.add_argument(
        "--time-limit", type=float, default=5700.0, help="length of an episode, s"
    )
    parser.add_argument(
        "--rules", nargs="*", default=["greedy"], help="baselines to compare with"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--backend", default="compiled", choices=["compiled", "eager"])
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for the results (default: a new one in runs/)",
    )
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of an episode; needs the extra viz",
    )
    return parser.parse_args()


def main() -> None:
    """Train or load, then fly with every communication method."""
    options = arguments()
    torch.set_num_threads(1)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    out = options.out or Path("runs") / f"share_intent_{datetime.now():%Y%m%d-%H%M%S}"
    world = {
        "as_set": True,
        "backend": options.backend,
        "n_targets": options.n_targets,
        "time_limit": options.time_limit,
    }
    trained = (
        policy_of_file(options.policy)
        if options.policy
        else train_alone(options, world, out)
    )
    returns: dict[str, dict[str, list[float]]] = {}
    alone: dict[str, Evaluation] = {}
    print(
        "| policy | shared with | team return | gain by sharing | images | duplicates |\n|---|---|---|---|---|---|"
    )
    for sharing, communicator in SHARING.items():
        constellation = {
            "n_satellites": options.n_satellites,
            "communicator": communicator,
        }
        env = make(
            "Constellation-v1", num_envs=options.episodes, **world, **constellation
        )
        flown = {"trained alone": SharedPolicy(trained)} | {
            rule: bsk_torch.rule(rule, env, options.seed) for rule in options.rules
        }
        for who, policy in flown.items():
            result = evaluate(policy, env, seed=options.seed + FRESH)
            print(row(who, sharing, result, alone.setdefault(who, result)), flush=True)
            returns.setdefault(who, {})[sharing] = result.returns.tolist()
    if options.figure is not None:
        from bsk_torch.viz.episodes import draw, record

        draw(
            record(SharedPolicy(trained), env, seed=options.seed + FRESH),
            options.figure,
            "trained alone, sharing all",
        )
    out.mkdir(parents=True, exist_ok=True)
    (out / "share_intent.json").write_text(json.dumps(returns) + "\n")


if __name__ == "__main__":
    main()
