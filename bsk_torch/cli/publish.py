"""``bsk-torch publish``: put the policy of a run among those that come with the package."""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import Any

import torch

from bsk_torch import __version__
from bsk_torch.cli.report import command_of, run_card, run_config
from bsk_torch.cli.shared import check_writable, environment, environment_options
from bsk_torch.cli.terminal import echo, fail, working
from bsk_torch.files import write_file
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.policies.checksummed import save_checksummed
from bsk_torch.rl.policies.files import build_policy, check_fits, read_card
from bsk_torch.rl.policies.pretrained import FOLDER, INDEX
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.training.log import LOG, read_log
from bsk_torch.sim.names import nearest
from bsk_torch.untrusted import Json, read_json

FIRST = 4
"""Episodes whose returns are noted one by one, to be tested."""


def publish(
    run: Path, training: str | None, drop: list[str] | None, episodes: int, folder: Path | None, threads: int, device: str
) -> None:
    """Evaluate a policy, copy it to the pretrained ones, and note command, time and score; see :mod:`bsk_torch.cli.main`."""
    folder = FOLDER if folder is None else folder
    torch.set_num_threads(threads)
    config, card = run_config(run), run_card(run, device)
    for name in drop or ():
        if name not in card["options"]:
            fail(f"--drop {name}: {str(run)!r} was not trained with that option; {nearest(name, list(card['options']))}")
    options = {name: value for name, value in card["options"].items() if name not in (drop or ())}
    if not (run / LOG).is_file():
        fail(f"{str(run)!r} has no {LOG}, from which the training time is read")
    log, listed = _log(run / LOG), _listed(folder)
    seed, preset = config.seed + FRESH, card["preset"]
    check_writable(folder / f"{preset}.pt" if folder.exists() else None)
    env = environment(preset, episodes, options | environment_options("compiled", device, None))
    try:
        check_fits(card, env, preset)
        policy = shared(build_policy(card, device), env)
    except ValueError as error:
        fail(str(error))
    with working(f"playing {episodes} unseen episodes"):
        result = evaluate(policy, env, seed=seed)
    folder.mkdir(parents=True, exist_ok=True)
    save_checksummed(folder / f"{preset}.pt", read_card(run) | {"options": options})
    notes = {
        "command": training or command_of(config),
        "bsk_torch": __version__,
        "seed": config.seed,
        "frames": int(log["frames"][-1]),
        "seconds": round(log["seconds"][-1], 1),
        "machine": f"{processor()}, {threads} thread{'s' * (threads > 1)}",
        "score": score(result, seed),
        "first": result.returns[:FIRST].tolist(),
    }
    write_file(folder / INDEX, json.dumps(dict(sorted((listed | {preset: notes}).items())), indent=2) + "\n")
    echo(f"{preset}: {result.mean_return}, survival {result.survival:.1%}; {folder / f'{preset}.pt'}")


def _log(path: Path) -> dict[str, list[float]]:
    """Columns of the log of a training; ends the program if it has no rows."""
    try:
        log = read_log(path)
    except ValueError as error:
        fail(str(error))
    if not log:
        fail(f"{str(path)!r} has no rows; the training time is read from it")
    return log


def _listed(folder: Path) -> dict[str, Any]:
    """Notes of the policies in a folder, by preset; ends the program if they are damaged, or it is no folder."""
    if folder.exists() and not folder.is_dir():
        fail(f"{str(folder)!r} is not a folder; name one for the policies")
    index = folder / INDEX
    try:
        return read_json(index, dict[str, Json], "holds no notes by preset") if index.exists() else {}
    except ValueError as error:
        fail(str(error))


def score(result: Evaluation, seed: int) -> dict[str, float]:
    """Return the results of an evaluation to store with a policy."""
    return {
        "episodes": len(result.returns),
        "seed": seed,
        "return": result.mean_return.mean,
        "half_width": result.mean_return.half_width,
        "survival": result.survival,
    }


def processor() -> str:
    """Return the name of this machine's processor; that of its architecture if the system does not say."""
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text().splitlines() if cpus.exists() else []
    names = [line.split(":")[1].strip() for line in lines if "model name" in line]
    return names[0] if names else platform.processor() or platform.machine()
