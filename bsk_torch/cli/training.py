"""Trainings of the command line: their configuration, their folder, the comparison at their end, and pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path

from tensordict.nn import TensorDictModuleBase

from bsk_torch.cli.shared import extra
from bsk_torch.cli.terminal import activity, echo, fail, for_shell, refusing, working
from bsk_torch.env import Tasking
from bsk_torch.presets import make
from bsk_torch.recording import record
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.evaluation.results import EVALUATION, print_results, save_results
from bsk_torch.rl.marl.runs import TRAINED, configure, read_config, told, training_of
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.training.config import AUTO, CONFIG, PPOConfig, override
from bsk_torch.rl.training.lock import FolderLock
from bsk_torch.rl.training.log import LOG, read_log
from bsk_torch.rl.training.trainer import CHECKPOINT, check_folder, read_checkpoint


def several(workers: str | None, changes: list[str]) -> list[str]:
    """Return the settings that stand for the option ``--workers``; several are of this machine unless told otherwise."""
    if workers is None:
        return []
    chosen = workers == AUTO or any(change.startswith("collector=") for change in changes)
    return [f"workers={workers}", *([] if chosen else ["collector=multi"])]


def check(folders: Iterable[Path]) -> None:
    """End the program before anything is done if a folder is not empty."""
    try:
        for folder in folders:
            check_folder(folder)
    except FileExistsError as error:
        fail(f"{error} with: bsk-torch train {for_shell(folder)} --resume" if (folder / CONFIG).is_file() else str(error))


def check_resumable(folder: Path, config: PPOConfig) -> None:
    """End the program immediately if the run in a folder cannot be resumed, or another process works there."""
    FolderLock(folder).release()
    if not (folder / CHECKPOINT).is_file():
        return  # the training warns that it begins again
    with refusing():
        read_checkpoint(folder, config)


def configured(preset: str, algorithm: str | None, network: str | None, changes: list[str], **settings: object) -> PPOConfig:
    """Return the configuration that the command line describes; ends the program if it is wrong."""
    with refusing(KeyError, ImportError, TypeError, ValueError):
        return override(configure(preset, network, algorithm, **settings), changes)


def read(folder: Path, changes: list[str]) -> PPOConfig:
    """Return the configuration of a run that is resumed."""
    if not (folder / CONFIG).is_file():
        fail(f"{str(folder)!r} is not a run folder: it has no {CONFIG}")
    with refusing():
        return override(read_config(folder), changes)


def run(
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
    kinds = TypeError, ValueError, FileNotFoundError, ModuleNotFoundError, ConnectionError
    with refusing(*kinds), working("building the training"):
        training = training_of(config, folder, resume)
    results = dict(baselines)
    if env is not None and not resume:
        results["untrained"] = evaluated("untrained", shared(training.policy, env), env, seed)
    activity.report()
    policy = training.run(bar=not activity.quiet)
    if env is not None:
        results[TRAINED] = evaluated(TRAINED, shared(policy, env), env, seed)
        print_results(results, f"{config.preset}, {env.batch_size[0]} unseen episodes", TRAINED)
        save_results(results, folder / EVALUATION, TRAINED)
    if find_spec("matplotlib") is None:
        echo("no pictures were drawn: they need matplotlib; pip install 'bsk_torch[viz]'")
    else:
        with working("drawing"):
            draw(policy, results, config, folder)
    echo(told(training, results))
    return results.get(TRAINED), training.interrupted


def evaluated(name: str, policy: TensorDictModuleBase, env: Tasking, seed: int) -> Evaluation:
    """Return the results of a policy in unseen episodes of ``seed``."""
    with working(f"evaluating {name}"):
        return evaluate(policy, env, seed=seed + FRESH)


def draw(policy: TensorDictModuleBase, results: Mapping[str, Evaluation], config: PPOConfig, folder: Path) -> None:
    """Draw the learning curve and the first fresh episode."""
    levels = {name: (result.mean_return.mean, result.mean_return.half_width) for name, result in results.items()}
    log = read_log(folder / LOG) if (folder / LOG).is_file() else {}
    if log:  # a full disk may have kept it from being written
        from bsk_torch.viz.figures.curves import learning_curve

        learning_curve(log, folder / "learning_curve.png", levels, f"{config.preset}: learning")
    env = make(config.preset, num_envs=1, **config.options)
    pictures = extra("bsk_torch.viz.episodes")
    recording = record(env, shared(policy, env), seed=config.seed + FRESH)
    title = f"{config.preset}: one episode of the trained policy"
    pictures.draw(pictures.episode_of(recording), folder / f"{recording.kind}.png", title)
