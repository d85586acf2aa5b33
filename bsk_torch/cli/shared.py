"""What several commands need: options, environments and errors."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console

from bsk_torch.env import SatelliteTasking, Tasking
from bsk_torch.presets import make
from bsk_torch.rl.baselines import BASELINES

console = Console()

Preset = Annotated[str, typer.Argument(help="Name of an environment; see 'bsk-torch list'.")]
Seed = Annotated[int, typer.Option(help="Seed of networks, actions and episodes.")]
Episodes = Annotated[int, typer.Option(min=1, help="Fresh episodes for every evaluation.")]
Threads = Annotated[int, typer.Option(min=1, help="Threads of torch; one is fastest for these sizes.")]
Backend = Annotated[str, typer.Option(help="'compiled', or 'eager' for debugging.")]
Device = Annotated[str, typer.Option(help="Where to simulate and learn, such as 'cuda'.")]
TimeLimit = Annotated[float | None, typer.Option(help="Length of an episode, s, instead of the preset's.")]


def environment_options(backend: str, device: str, time_limit: float | None) -> dict[str, Any]:
    """Arguments of the environment that the command line sets."""
    return {"backend": backend, "device": device} | ({} if time_limit is None else {"time_limit": time_limit})


def made(preset: str, num_envs: int, options: Mapping[str, Any]) -> Tasking:
    """An environment of a preset; ends the program where arguments do not allow it."""
    try:
        return make(preset, num_envs=num_envs, **options)
    except ValueError as error:
        fail(str(error))


def environment(preset: str, num_envs: int, options: Mapping[str, Any]) -> SatelliteTasking:
    """An environment of one satellite; ends the program for constellations."""
    env = made(preset, num_envs, options)
    if not isinstance(env, SatelliteTasking):
        fail(f"{preset} has many satellites; train and evaluate it with scripts/train_constellation.py --preset {preset}")
    return env


def fail(message: str) -> NoReturn:
    """Say what is wrong, and end the program."""
    typer.secho(message, err=True, fg="red")
    raise typer.Exit(1)


def fits(name: str, env: SatelliteTasking) -> bool:
    """Whether a baseline knows what to do with the environment's observations and actions."""
    try:
        BASELINES[name](env, 0)
    except (KeyError, ValueError):
        return False
    return True


def extra(module: str, extras: str = "train,viz") -> Any:
    """A module that needs what ``extras`` install; ends the program where that is missing."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        fail(f"this needs {error.name}; pip install 'bsk_torch[{extras}]'")
