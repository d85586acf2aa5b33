"""Put the policy of a run among those that come with the package, with the command, time and score that made it.

    bsk-torch train NadirScan-v1 --frames 5000000 --out runs/scan
    python scripts/publish_policy.py runs/scan "bsk-torch train NadirScan-v1 --frames 5000000"

It is evaluated on fresh episodes: those of seed 1,000,003 + the seed of training.
"""

from __future__ import annotations

import argparse
import json
import platform
import shutil
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf

from bsk_torch import __version__
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.config import CONFIG
from bsk_torch.rl.crew import Crew, evaluate_crew
from bsk_torch.rl.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.log import LOG, read_log
from bsk_torch.rl.policies import POLICY, load_policy, read_card
from bsk_torch.rl.pretrained import FOLDER

FIRST = 4
"""Episodes whose returns are noted one by one, for the test."""


def played(run: Path, preset: str, options: dict[str, Any], episodes: int, seed: int) -> Evaluation:
    """Fresh episodes of the policy in a run's folder."""
    env, policy = make(preset, num_envs=episodes, **options), load_policy(run)
    if isinstance(env, SatelliteTasking):
        return evaluate(policy, env, seed=seed)
    return evaluate_crew(Crew(policy), env, seed=seed)


def processor() -> str:
    """Name of this machine's processor, where it tells."""
    told = Path("/proc/cpuinfo")
    names = (
        [line.split(":")[1].strip() for line in told.read_text().splitlines() if "model name" in line] if told.exists() else []
    )
    return names[0] if names else platform.processor() or platform.machine()


def main() -> None:
    """Evaluate, copy, and note."""
    parser = argparse.ArgumentParser(description="Put the policy of a run among those that come with the package.")
    parser.add_argument("run", type=Path, help="folder of the run")
    parser.add_argument("command", help="the command that trained it")
    parser.add_argument("--episodes", type=int, default=256, help="fresh episodes")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where the policies lie")
    options = parser.parse_args()
    torch.set_num_threads(1)
    card, config, log = read_card(options.run), OmegaConf.load(options.run / CONFIG), read_log(options.run / LOG)
    seed = int(config.seed) + FRESH
    result = played(options.run, card["preset"], card["options"], options.episodes, seed)
    first = played(options.run, card["preset"], card["options"], FIRST, seed)
    options.folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(options.run / POLICY, options.folder / f"{card['preset']}.pt")
    index = options.folder / "policies.json"
    notes = json.loads(index.read_text()) if index.exists() else {}
    notes[card["preset"]] = {
        "command": options.command,
        "bsk_torch": __version__,
        "seed": int(config.seed),
        "frames": int(log["frames"][-1]),
        "seconds": round(log["seconds"][-1], 1),
        "machine": f"{processor()}, one thread",
        "score": {
            "episodes": options.episodes,
            "seed": seed,
            "return": result.mean_return.mean,
            "half_width": result.mean_return.half_width,
            "survival": result.survival,
        },
        "first": first.returns.tolist(),
    }
    index.write_text(json.dumps(dict(sorted(notes.items())), indent=2) + "\n")
    print(f"{card['preset']}: {result.mean_return}, survival {result.survival:.1%}; {options.folder / card['preset']}.pt")


if __name__ == "__main__":
    main()
