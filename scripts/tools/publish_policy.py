"""Add the policy of a run to the pretrained ones, with its training command, time and score.

    python scripts/tools/publish_policy.py runs/scan
    python scripts/tools/publish_policy.py runs/team --drop n_satellites --drop n_planes

The evaluation uses the episodes of seed 1,000,003 + the training seed, in the training environment without the dropped options,
which were only for training, such as n_satellites for a policy of one satellite.
"""

from __future__ import annotations

import argparse
import json
import platform
from pathlib import Path

import torch

import bsk_torch
from bsk_torch.cli.run_folder import command_of
from bsk_torch.files import write_file
from bsk_torch.rl.evaluation.evaluate import FRESH, evaluate
from bsk_torch.rl.marl.runs import read_config
from bsk_torch.rl.policies.checksummed import save_checksummed
from bsk_torch.rl.policies.files import build_policy, check_fits, read_card
from bsk_torch.rl.policies.pretrained import FOLDER, INDEX
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.training.log import LOG, read_log
from bsk_torch.sim.names import nearest

FIRST = 4
"""Episodes whose returns are noted one by one, to be tested."""


def processor() -> str:
    """Return the name of this machine's processor; that of its architecture if the system does not say."""
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text().splitlines() if cpus.exists() else []
    names = [line.split(":")[1].strip() for line in lines if "model name" in line]
    return names[0] if names else platform.processor() or platform.machine()


def main() -> None:
    """Evaluate the policy, copy it, and note command, time and score."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="run folder")
    parser.add_argument("--command", metavar="TEXT", help="training command, if it differs from the run's settings")
    parser.add_argument("--drop", action="append", default=[], metavar="NAME", help="option used only for training; repeatable")
    parser.add_argument("--episodes", type=int, default=256, metavar="N", help="unseen episodes of the evaluation")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="folder of the policies; default: the package's")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="threads of torch")
    asked = parser.parse_args()
    torch.set_num_threads(asked.threads)
    config, card, log = read_config(asked.run), read_card(asked.run), read_log(asked.run / LOG)
    for name in asked.drop:
        if name not in card["options"]:
            parser.error(f"--drop {name}: the run was not trained with that option; {nearest(name, card['options'])}")
    options = {name: value for name, value in card["options"].items() if name not in asked.drop}
    seed, preset = config.seed + FRESH, card["preset"]
    env = bsk_torch.make(preset, num_envs=asked.episodes, **options)
    check_fits(card, env, preset)
    result = evaluate(shared(build_policy(card), env), env, seed=seed)
    asked.folder.mkdir(parents=True, exist_ok=True)
    save_checksummed(asked.folder / f"{preset}.pt", card | {"options": options})
    notes = {
        "command": asked.command or command_of(config),
        "bsk_torch": bsk_torch.__version__,
        "seed": config.seed,
        "frames": int(log["frames"][-1]),
        "seconds": round(log["seconds"][-1], 1),
        "machine": f"{processor()}, {asked.threads} thread{'s' * (asked.threads > 1)}",
        "score": {
            "episodes": len(result.returns),
            "seed": seed,
            "return": result.mean_return.mean,
            "half_width": result.mean_return.half_width,
            "survival": result.survival,
        },
        "first": result.returns[:FIRST].tolist(),
    }
    index = asked.folder / INDEX
    listed = json.loads(index.read_text()) if index.exists() else {}
    write_file(index, json.dumps(dict(sorted((listed | {preset: notes}).items())), indent=2) + "\n")
    print(f"{preset}: {result.mean_return}, survival {result.survival:.1%}; {asked.folder / f'{preset}.pt'}")


if __name__ == "__main__":
    main()
