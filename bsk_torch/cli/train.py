"""``bsk-torch train``: train policies, compare them with baselines, and draw them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import torch
import typer

from bsk_torch.cli.results import print_results, save_results
from bsk_torch.cli.shared import (
    Backend,
    Device,
    Episodes,
    Seed,
    Threads,
    TimeLimit,
    console,
    environment,
    environment_options,
    extra,
    fail,
    fits,
)
from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.baselines import BASELINES
from bsk_torch.rl.config import CONFIG, PPOConfig, load_config, override
from bsk_torch.rl.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.log import LOG, read_log
from bsk_torch.rl.recipes import configure
from bsk_torch.rl.targets import image_actions

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

Changes = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[NAME=VALUE]...",
        help="Settings that differ from the recipe's, such as learning_rate=1e-3 'hidden=[128,128]' evaluate_every=500000 "
        "loggers=[csv,tensorboard] collector=multi workers=2; every field of bsk_torch.rl.config.PPOConfig.",
    ),
]


def train(
    preset: Annotated[
        str, typer.Argument(help="Name of an environment, see 'bsk-torch list'; or, with --resume, the folder of a run.")
    ],
    changes: Changes = None,
    network: Annotated[str, typer.Option(help="'mlp'; 'gru' with a memory; 'attention' for targets observed as a set.")] = "mlp",
    minutes: Annotated[float, typer.Option(min=0.01, help="Training time after compilation.")] = 3.0,
    frames: Annotated[int | None, typer.Option(help="Number of decisions, instead of a time.")] = None,
    seed: Seed = 0,
    seeds: Annotated[int, typer.Option(min=1, help="Number of trainings, with seeds from --seed on, one after the other.")] = 1,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in the folder that is named.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; a new one in runs/ unless given.")] = None,
    episodes: Episodes = 256,
    threads: Threads = 1,
    backend: Backend = "compiled",
    device: Device = "cpu",
    time_limit: TimeLimit = None,
) -> None:
    """Train policies with PPO and compare them with random actions and rules on fresh episodes."""
    torch.set_num_threads(threads)
    if resume:
        folder = Path(preset)
        config = _read(folder, changes or [])
        runs, seed = {folder: config}, config.seed
    else:
        limit = {"frames": frames, "seconds": None} if frames else {"seconds": 60.0 * minutes}
        options = environment_options(backend, device, time_limit)
        config = _configured(preset, network, changes or [], seed=seed, options=options, **limit)
        folder = out or Path("runs") / f"{preset}_{datetime.now():%Y%m%d-%H%M%S}"
        runs = {folder / f"seed_{seed + k}" if seeds > 1 else folder: replace(config, seed=seed + k) for k in range(seeds)}
        _check(runs)
    env = environment(config.preset, episodes, config.options)
    results = {name: _evaluated(name, BASELINES[name](env, seed), env, seed) for name in BASELINES if fits(name, env)}
    trained: dict[str, Evaluation] = {}
    for folder, config in runs.items():
        trained[f"seed {config.seed}"], interrupted = _run(config, folder, env, results, seed, resume)
        if interrupted:
            break
    if len(trained) > 1:
        print_results(results | trained, f"{config.preset}, {episodes} fresh episodes")


def _check(folders: Iterable[Path]) -> None:
    """End the program before anything is done if there is something in one of the folders."""
    for folder in folders:
        try:
            extra("bsk_torch.rl.training").check_folder(folder)
        except FileExistsError as error:
            fail(str(error))


def _configured(preset: str, network: str, changes: list[str], **settings: Any) -> PPOConfig:
    try:
        return override(configure(preset, network, **settings), changes)
    except ValueError as error:
        fail(str(error))


def _read(folder: Path, changes: list[str]) -> PPOConfig:
    """Configuration of a run that goes on."""
    path = folder / CONFIG
    if not path.is_file():
        fail(f"{str(folder)!r} is no folder of a run: it has no {path.name}")
    try:
        return override(load_config(path, PPOConfig), changes)
    except ValueError as error:
        fail(str(error))


def _run(
    config: PPOConfig,
    folder: Path,
    env: SatelliteTasking,
    baselines: Mapping[str, Evaluation],
    seed: int,
    resume: bool,
) -> tuple[Evaluation, bool]:
    """Train, compare with ``baselines`` in the fresh episodes of ``seed``, draw, keep all in ``folder``; was it interrupted?"""
    training = extra("bsk_torch.rl.training")
    try:
        run = training.Training(config, folder, resume)
    except (ValueError, FileNotFoundError, ModuleNotFoundError) as error:
        fail(str(error))
    results = dict(baselines) | ({} if resume else {"untrained": _evaluated("untrained", run.policy, env, seed)})
    policy = run.run()
    results["trained"] = _evaluated("trained", policy, env, seed)
    print_results(results, f"{config.preset}, {env.batch_size[0]} fresh episodes", "trained")
    save_results(results, folder / "evaluation.json", "trained")
    _draw(policy, results, config, folder)
    typer.echo(f"policy, logs, evaluation and pictures are in {folder}; 'bsk-torch report {folder}' makes a page of them")
    return results["trained"], run.interrupted


def _evaluated(name: str, policy: TensorDictModuleBase, env: SatelliteTasking, seed: int) -> Evaluation:
    with console.status(f"evaluating: {name}"):
        return evaluate(policy, env, seed=seed + FRESH)


def _draw(policy: TensorDictModuleBase, results: Mapping[str, Evaluation], config: PPOConfig, folder: Path) -> None:
    """Learning curve, and the first fresh episode: from above where targets are imaged, else as a timeline."""
    curves = extra("bsk_torch.viz.curves")
    levels = {name: (result.mean_return.mean, result.mean_return.half_width) for name, result in results.items()}
    curves.learning_curve(read_log(folder / LOG), folder / "learning_curve.png", levels, f"{config.preset}: learning")
    env = make(config.preset, num_envs=1, **config.options)
    title, seed = f"{config.preset}: one episode of the trained policy", config.seed + FRESH
    if _images(env):
        above = extra("bsk_torch.viz.ground_track")
        above.ground_track(above.record_imaging_episode(policy, env, seed=seed), folder / "ground_track.png", title)
    else:
        timeline = extra("bsk_torch.viz.timeline")
        timeline.timeline(timeline.record_episode(policy, env, seed=seed), folder / "timeline.png", title)


def _images(env: SatelliteTasking) -> bool:
    """Whether the satellite images targets."""
    try:
        return bool(image_actions(env))
    except ValueError:
        return False
