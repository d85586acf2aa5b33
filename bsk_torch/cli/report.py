"""``bsk-torch report``: one HTML page about a run."""

from __future__ import annotations

import json
import platform
import shlex
from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from bsk_torch.cli.results import Summary
from bsk_torch.cli.shared import check_writable, environment, environment_options
from bsk_torch.cli.terminal import echo, fail, working
from bsk_torch.recording import record
from bsk_torch.rl.evaluation.evaluate import FRESH, evaluate
from bsk_torch.rl.evaluation.results import EVALUATION
from bsk_torch.rl.marl.runs import PPO, algorithm_of, configure, read_config
from bsk_torch.rl.policies.files import POLICY, build_policy, check_fits, read_card
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.training.config import CONFIG, PPOConfig
from bsk_torch.rl.training.log import EVALUATIONS, LOG, read_log
from bsk_torch.untrusted import Word, read_json

if TYPE_CHECKING:
    from torch import Tensor

    from bsk_torch.recording import Recording

REPORT = "report.html"
"""File of the report."""

FLAGS = {"backend": "compiled", "device": "cpu", "time_limit": None}
"""Options of the environment that are flags of the command line, with their defaults."""

VERSIONS = ("bsk_torch", "torch", "torchrl", "matplotlib")
"""Packages whose versions a report notes."""


def report(run: Path, episodes: int, threads: int, backend: str, device: str) -> None:
    """Write report.html into the folder of a run; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    pages, config = _pages(), run_config(run)
    card, log, evaluations = run_card(run, device), _columns(run / LOG), _columns(run / EVALUATIONS)
    results = _results(run / EVALUATION)
    check_writable(run / REPORT)
    options = config.options | environment_options(backend, device, None)
    chosen, recording = _episodes(config, card, options, episodes, device)
    data = pages.RunData(
        name=run.resolve().name,
        preset=config.preset,
        log=log,
        evaluations=evaluations,
        results=results,
        episodes=[pages.Chosen(why, number, pages.episode_of(recording, k)) for k, (why, number) in enumerate(chosen.items())],
        flights=recording.html(),
        played=episodes,
        config=asdict(config),
        facts=_facts(card),
        command=command_of(config),
    )
    path = pages.write_report(data, run / REPORT)
    echo(f"{path} ({path.stat().st_size / 1e6:.1f} MB)\nopen it in a browser: {path.resolve().as_uri()}")


def _pages() -> Any:
    """Return the module that writes reports; ends the program if matplotlib or jinja2 is missing."""
    try:
        return import_module("bsk_torch.viz.report.page")
    except ModuleNotFoundError as error:
        fail(f"a report needs {error.name}; pip install 'bsk_torch[viz]'")


# -- the folder of a run ---------------------------------------------------------------------------------------------------------


def run_config(folder: Path) -> PPOConfig:
    """Configuration of a run; ends the program where there is none."""
    if not folder.is_dir():
        fail(f"there is no folder {str(folder)!r}; training prints its folder at the end")
    if not (folder / CONFIG).is_file():
        fail(f"{str(folder)!r} has no {CONFIG}; it is not a run folder")
    try:
        return read_config(folder)
    except ValueError as error:
        fail(str(error))


def run_card(folder: Path, device: str) -> dict[str, Any]:
    """The policy of a run; ends the program where there is none."""
    if not (folder / POLICY).is_file():
        fail(f"{str(folder)!r} has no {POLICY}; training leaves it at its end")
    try:
        return read_card(folder, device)
    except ValueError as error:
        fail(str(error))


def _columns(path: Path) -> dict[str, list[float]]:
    """Columns of a log; none where it was not written. Ends the program if it is no log."""
    try:
        return read_log(path) if path.is_file() else {}
    except ValueError as error:
        fail(str(error))


def _results(path: Path) -> dict[str, Any]:
    """Final evaluation; nothing where training was stopped before. Ends the program if the file is damaged."""
    try:
        return read_json(path, dict[Word, Summary], "holds no results of an evaluation by policy") if path.is_file() else {}
    except ValueError as error:
        fail(str(error))


def _facts(card: dict[str, Any]) -> dict[str, str]:
    made = {"policy trained with": f"bsk_torch {card['bsk_torch']}"}
    return made | {
        "report made with": ", ".join(f"{name} {version(name)}" for name in VERSIONS),
        "Python": platform.python_version(),
    }


# -- episodes --------------------------------------------------------------------------------------------------------------------


def _episodes(
    config: PPOConfig, card: dict[str, Any], options: dict[str, Any], episodes: int, device: str
) -> tuple[dict[str, int], Recording]:
    """The numbers of the best, the median and the worst of unseen episodes, and their recording."""
    env = environment(config.preset, episodes, options)
    try:
        check_fits(card, env, config.preset)
        policy = shared(build_policy(card, device), env)
    except ValueError as error:
        fail(str(error))
    seed = config.seed + FRESH
    with working(f"playing {episodes} unseen episodes"):
        returns = evaluate(policy, env, seed=seed).returns
    chosen = extremes(returns)
    recordings = []
    for why, number in chosen.items():
        with working(f"playing the {why} episode again"):
            one = environment(config.preset, 1, options | {"env_ids": [number]})
            recordings.append(record(one, policy, seed=seed, preset=config.preset, label="trained"))
    labels = (f"{why} episode (no. {number})" for why, number in chosen.items())
    tracks = [
        replace(part.tracks[0], scene=k, label=label) for k, (part, label) in enumerate(zip(recordings, labels, strict=True))
    ]
    title, scenes = f"{config.preset}: episodes of the report", [part.scenes[0] for part in recordings]
    return chosen, replace(recordings[0], title=title, scenes=scenes, tracks=tracks)


def extremes(returns: Tensor) -> dict[str, int]:
    """Numbers of the episodes with the highest, the median and the lowest of the ``returns`` [n]; each only once."""
    order = returns.argsort().tolist()
    chosen = {"best": order[-1], "median": order[(len(order) - 1) // 2], "worst": order[0]}
    return {why: number for k, (why, number) in enumerate(chosen.items()) if number not in list(chosen.values())[:k]}


# -- the command -----------------------------------------------------------------------------------------------------------------


def command_of(config: PPOConfig) -> str:
    """The shell command that trains with such a configuration."""
    limit = ["--minutes", f"{config.clock / 60.0:g}"] if config.clock is not None else []
    limit = limit if config.frames is None else ["--frames", str(config.frames)]
    algorithm = [] if algorithm_of(config) == PPO else ["--algorithm", algorithm_of(config)]
    flags = [*algorithm, "--network", config.network, *limit, "--seed", str(config.seed)]
    for name, usual in FLAGS.items():
        if config.options.get(name, usual) != usual:
            flags += [f"--{name.replace('_', '-')}", str(config.options[name])]
    return shlex.join(["bsk-torch", "train", config.preset, *flags, *_changes(config)])


def _changes(config: PPOConfig) -> Iterator[str]:
    """Settings that differ from the recipe's, as the command line takes them."""
    recipe = configure(config.preset, config.network, algorithm_of(config))
    said = {"preset", "algorithm", "network", "frames", "seed", "options"} | ({"seconds"} if config.frames is None else set())
    for part in fields(config):
        value = getattr(config, part.name)
        if part.name not in said and value != (None if part.name == "seconds" else getattr(recipe, part.name)):
            yield f"{part.name}={_said(value)}"
    for name, value in config.options.items():
        if name not in FLAGS and value != recipe.options.get(name):
            yield f"options.{name}={_said(value)}"


def _said(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
