"""``bsk-torch publish``: put the policy of a run among those that come with the package."""

from __future__ import annotations

import json
import platform
import shutil
from pathlib import Path
from typing import Annotated

import torch
import typer

from bsk_torch import __version__
from bsk_torch.cli.report import command_of, run_card, run_config
from bsk_torch.cli.shared import Device, Threads, console, environment, environment_options, fail
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.policies.files import POLICY, build_policy, check_fits
from bsk_torch.rl.policies.pretrained import FOLDER, INDEX
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.training.log import LOG, read_log

FIRST = 4
"""Episodes whose returns are noted one by one, to be tested."""


def publish(
    run: Annotated[Path, typer.Argument(help="Folder of a training run.")],
    command: Annotated[str | None, typer.Option(help="Command that trained it, if it was not that of its settings.")] = None,
    episodes: Annotated[int, typer.Option(min=FIRST, help="Fresh episodes of the evaluation.")] = 256,
    folder: Annotated[Path, typer.Option(help="Where the policies lie.")] = FOLDER,
    threads: Threads = 1,
    device: Device = "cpu",
) -> None:
    """Evaluate a policy, copy it to the pretrained ones, and note command, time and score.

    The evaluation plays the fresh episodes of seed 1,000,003 + the seed of training.
    """
    torch.set_num_threads(threads)
    config, card = run_config(run), run_card(run, device)
    if not (run / LOG).is_file():
        fail(f"{str(run)!r} has no {LOG}, which says how long the training took")
    log, seed, preset = read_log(run / LOG), config.seed + FRESH, card["preset"]
    env = environment(preset, episodes, card["options"] | environment_options("compiled", device, None))
    try:
        check_fits(card, env, preset)
        policy = shared(build_policy(card, device), env)
    except ValueError as error:
        fail(str(error))
    with console.status(f"playing {episodes} fresh episodes"):
        result = evaluate(policy, env, seed=seed)
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(run / POLICY, folder / f"{preset}.pt")
    notes = {
        "command": command or command_of(config),
        "bsk_torch": __version__,
        "seed": config.seed,
        "frames": int(log["frames"][-1]),
        "seconds": round(log["seconds"][-1], 1),
        "machine": f"{processor()}, {threads} thread{'s' * (threads > 1)}",
        "score": score(result, seed),
        "first": result.returns[:FIRST].tolist(),
    }
    index = folder / INDEX
    listed = json.loads(index.read_text()) if index.exists() else {}
    index.write_text(json.dumps(dict(sorted((listed | {preset: notes}).items())), indent=2) + "\n")
    typer.echo(f"{preset}: {result.mean_return}, survival {result.survival:.1%}; {folder / f'{preset}.pt'}")


def score(result: Evaluation, seed: int) -> dict[str, float]:
    """Return the figures of an evaluation that are noted with a policy."""
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
