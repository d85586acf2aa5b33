"""``bsk-torch train``: train policies, compare them with baselines, and draw them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import torch
import typer

from bsk_torch.cli.shared import building, environment, environment_options
from bsk_torch.cli.terminal import activity, echo, fail, for_shell, working
from bsk_torch.env import Tasking
from bsk_torch.presets import make
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.evaluation.results import EVALUATION, print_results, save_results
from bsk_torch.rl.marl.runs import TRAINED, configure, read_config, told, training_of
from bsk_torch.rl.policies.shared_policy import shared, shared_baselines
from bsk_torch.rl.training.config import AUTO, CONFIG, PPOConfig, override
from bsk_torch.rl.training.lock import FolderLock
from bsk_torch.rl.training.log import LOG, read_log
from bsk_torch.rl.training.trainer import CHECKPOINT, check_folder, read_checkpoint

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

OF_NEW_RUNS = ("algorithm", "network", "seed", "seeds", "workers", "out", "backend", "device", "time_limit")
"""Parameters of the command that new runs take; one that is resumed takes changes as NAME=VALUE."""


def train(
    context: typer.Context,
    preset: str,
    changes: list[str] | None,
    algorithm: str | None,
    network: str | None,
    minutes: float | None,
    frames: int | None,
    seed: int,
    seeds: int,
    workers: str | None,
    resume: bool,
    out: Path | None,
    episodes: int,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Train policies and compare them with the baselines that fit; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    limits = {"frames": frames, "seconds": minutes and 60.0 * minutes}
    changes = [*(f"{name}={value}" for name, value in limits.items() if value is not None), *(changes or [])]
    if resume:
        folder = Path(preset)
        config = _read(folder, changes)
        given = [name for name in OF_NEW_RUNS if _is_given(context, name)]
        if given:
            fail(
                f"--{given[0].replace('_', '-')} is for new runs; with --resume, changes are written as NAME=VALUE: "
                "learning_rate=1e-4"
            )
        _check_resumable(folder, config)
        runs, seed = {folder: config}, config.seed
    else:
        for name, said in (("preset", "the first argument"), ("network", "--network"), ("algorithm", "--algorithm")):
            if any(change.startswith(f"{name}=") for change in changes):
                fail(f"{name}= is not a setting; give it as {said}")
        options = environment_options(backend, device, time_limit)
        config = configured(preset, algorithm, network, [*_several(workers, changes), *changes], seed=seed, options=options)
        folder = out or Path("runs") / f"{preset}_{datetime.now():%Y%m%d-%H%M%S}"
        runs = {folder / f"seed_{seed + k}" if seeds > 1 else folder: replace(config, seed=seed + k) for k in range(seeds)}
        _check(runs)
    env = environment(config.preset, episodes, config.options) if episodes else None
    results = {name: _evaluated(name, rule, env, seed) for name, rule in shared_baselines(env, seed).items()} if env else {}
    trained: dict[str, Evaluation] = {}
    for folder, config in runs.items():
        found, interrupted = _run(config, folder, env, results, seed, resume)
        if found is not None:
            trained[f"seed {config.seed}"] = found
        if interrupted:
            break
    if len(trained) > 1:
        print_results(results | trained, f"{config.preset}, {episodes} unseen episodes")


def _several(workers: str | None, changes: list[str]) -> list[str]:
    """Return the settings that stand for the option ``--workers``; several are of this machine unless told otherwise."""
    if workers is None:
        return []
    chosen = workers == AUTO or any(change.startswith("collector=") for change in changes)
    return [f"workers={workers}", *([] if chosen else ["collector=multi"])]


def _is_given(context: typer.Context, name: str) -> bool:
    """Return whether a parameter was given on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _check(folders: Iterable[Path]) -> None:
    """End the program before anything is done if a folder is not empty."""
    try:
        for folder in folders:
            check_folder(folder)
    except FileExistsError as error:
        fail(f"{error} with: bsk-torch train {for_shell(folder)} --resume" if (folder / CONFIG).is_file() else str(error))


def _check_resumable(folder: Path, config: PPOConfig) -> None:
    """End the program immediately if the run in a folder cannot be resumed, or another process works there."""
    FolderLock(folder).release()
    if not (folder / CHECKPOINT).is_file():
        return  # the training warns that it begins again
    try:
        read_checkpoint(folder, config)
    except ValueError as error:
        fail(str(error))


def configured(preset: str, algorithm: str | None, network: str | None, changes: list[str], **settings: object) -> PPOConfig:
    """Return the configuration that the command line describes; ends the program if it is wrong."""
    with building():
        return override(configure(preset, network, algorithm, **settings), changes)


def _read(folder: Path, changes: list[str]) -> PPOConfig:
    """Return the configuration of a run that is resumed."""
    if not (folder / CONFIG).is_file():
        fail(f"{str(folder)!r} is not a run folder: it has no {CONFIG}")
    try:
        return override(read_config(folder), changes)
    except ValueError as error:
        fail(str(error))


def _run(
    config: PPOConfig,
    folder: Path,
    env: Tasking | None,
    baselines: Mapping[str, Evaluation],
    seed: int,
    resume: bool,
) -> tuple[Evaluation | None, bool]:
    """Train, compare with ``baselines`` in unseen episodes of ``seed``, draw, and keep all in ``folder``.

    Returns:
        Results of the trained policy, None without an environment for the comparison, and whether the user interrupted the
        training.
    """
    try:
        with working("building the training"):
            run = training_of(config, folder, resume)
    except (TypeError, ValueError, FileNotFoundError, ModuleNotFoundError, ConnectionError) as error:
        fail(str(error))
    results = dict(baselines)
    if env is not None and not resume:
        results["untrained"] = _evaluated("untrained", shared(run.policy, env), env, seed)
    activity.report()
    policy = run.run(bar=not activity.quiet)
    if env is not None:
        results[TRAINED] = _evaluated(TRAINED, shared(policy, env), env, seed)
        print_results(results, f"{config.preset}, {env.batch_size[0]} unseen episodes", TRAINED)
        save_results(results, folder / EVALUATION, TRAINED)
    if find_spec("matplotlib") is None:
        echo("no pictures were drawn: they need matplotlib; pip install 'bsk_torch[viz]'")
    else:
        with working("drawing"):
            _draw(policy, results, config, folder)
    echo(told(run))
    return results.get(TRAINED), run.interrupted


def _evaluated(name: str, policy: TensorDictModuleBase, env: Tasking, seed: int) -> Evaluation:
    with working(f"evaluating {name}"):
        return evaluate(policy, env, seed=seed + FRESH)


def _draw(policy: TensorDictModuleBase, results: Mapping[str, Evaluation], config: PPOConfig, folder: Path) -> None:
    """Draw the learning curve and the first fresh episode."""
    from bsk_torch.recording import record
    from bsk_torch.viz.episodes import draw, episode_of

    levels = {name: (result.mean_return.mean, result.mean_return.half_width) for name, result in results.items()}
    log = read_log(folder / LOG) if (folder / LOG).is_file() else {}
    if log:  # a full disk may have kept it from being written
        from bsk_torch.viz.figures.curves import learning_curve

        learning_curve(log, folder / "learning_curve.png", levels, f"{config.preset}: learning")
    env = make(config.preset, num_envs=1, **config.options)
    recording = record(env, shared(policy, env), seed=config.seed + FRESH)
    title = f"{config.preset}: one episode of the trained policy"
    draw(episode_of(recording), folder / f"{recording.kind}.png", title)
