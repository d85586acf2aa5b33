"""What is in the folder of a run, and the command that trained it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval
from pydantic import AllowInfNan
from typing_extensions import NotRequired, TypedDict

from bsk_torch.cli.terminal import fail, refusing
from bsk_torch.rl.marl.runs import PPO, algorithm_of, configure, read_config
from bsk_torch.rl.policies.files import POLICY, read_card
from bsk_torch.rl.training.config import CONFIG, PPOConfig
from bsk_torch.rl.training.log import read_log
from bsk_torch.untrusted import Count, Word, read_json

FLAGS = {"backend": "compiled", "device": "cpu", "time_limit": None}
"""Options of the environment that are flags of the command line, with their defaults."""

Amount = Annotated[float, Interval(ge=-1e15, le=1e15)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Maybe = Annotated[float, AllowInfNan(True)]
"""A number that is infinite or NaN where episodes are too few."""


class Estimate(TypedDict):
    """A mean and the half width of its interval."""

    mean: Amount
    half_width: Maybe


class Measure(TypedDict):
    """The same of a measure, which may be unknown."""

    mean: Maybe
    half_width: Maybe


Summary = TypedDict(
    "Summary",
    {
        "return": Estimate,
        "episodes": NotRequired[Count],
        "survival": NotRequired[Share | None],
        "survival_interval": NotRequired[list[Share]],
        "collected": NotRequired[Maybe | None],
        "fill": NotRequired[Maybe | None],
        "decisions": NotRequired[Amount],
        "simulated_per_decision": NotRequired[Amount | None],
        "deaths": NotRequired[dict[Word, Count]],
        "counts": NotRequired[dict[Word, Amount]],
        "measures": NotRequired[dict[Word, Measure]],
        "gain": NotRequired[dict[Word, Estimate]],
    },
)
"""What an evaluation says of a policy; see :meth:`bsk_torch.rl.evaluation.evaluate.Evaluation.summary`."""


def run_config(folder: Path) -> PPOConfig:
    """Configuration of a run; ends the program where there is none."""
    if not folder.is_dir():
        fail(f"there is no folder {str(folder)!r}; training prints its folder at the end")
    if not (folder / CONFIG).is_file():
        fail(f"{str(folder)!r} has no {CONFIG}; it is not a run folder")
    with refusing():
        return read_config(folder)


def run_card(folder: Path, device: str) -> dict[str, Any]:
    """The policy of a run; ends the program where there is none."""
    if not (folder / POLICY).is_file():
        fail(f"{str(folder)!r} has no {POLICY}; training leaves it at its end")
    with refusing():
        return read_card(folder, device)


def columns(path: Path) -> dict[str, list[float]]:
    """Columns of a log; none where it was not written. Ends the program if it is no log."""
    with refusing():
        return read_log(path) if path.is_file() else {}


def results(path: Path) -> dict[str, Any]:
    """Final evaluation; nothing where training was stopped before. Ends the program if the file is damaged."""
    with refusing():
        return read_json(path, dict[Word, Summary], "holds no results of an evaluation by policy") if path.is_file() else {}


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
    flags = {"preset", "algorithm", "network", "frames", "seed", "options"} | ({"seconds"} if config.frames is None else set())
    for part in fields(config):
        value = getattr(config, part.name)
        if part.name not in flags and value != (None if part.name == "seconds" else getattr(recipe, part.name)):
            yield f"{part.name}={_text(value)}"
    for name, value in config.options.items():
        if name not in FLAGS and value != recipe.options.get(name):
            yield f"options.{name}={_text(value)}"


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
