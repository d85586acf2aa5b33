"""Environments, seeds and files of several commands."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bsk_torch.cli.terminal import fail, refusing, working
from bsk_torch.files import unwritable

if TYPE_CHECKING:
    from bsk_torch.env import Tasking

LARGEST_SEED, MOST_SEEDS = 2**62, 10_000_000
"""Bounds of the seeds of episodes, and of their number, that a command plays."""

WORDS = {"true": True, "false": False, "none": None}
"""Values of options that are written otherwise in Python."""

OF_COMMANDS = {
    name: f"it is the option --{name.replace('_', '-')} of the command" for name in ("backend", "device", "time_limit")
}
OF_COMMANDS |= dict.fromkeys(("num_envs", "env_ids", "seed"), "it follows from the episodes; choose these with --seeds")
"""Options of environments that commands set, and where to set them."""


def preset_options(texts: Sequence[str] | None) -> dict[str, Any]:
    """Return options NAME=VALUE of an environment; ends the program for other texts, and for those of the command itself."""
    options = {}
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not equals or not name.isidentifier():
            fail(f"--option {text!r} must be NAME=VALUE, such as n_targets=1000")
        if name in OF_COMMANDS:
            fail(f"--option {text!r}: {OF_COMMANDS[name]}")
        try:
            options[name] = WORDS[value] if value in WORDS else ast.literal_eval(value)
        except (ValueError, SyntaxError):
            options[name] = value
    return options


def made(preset: str, num_envs: int, options: Mapping[str, object], why: str = "") -> Tasking:
    """Return an environment of a preset; ends the program if its arguments are wrong. ``why`` introduces unknown ones.

    Some arguments are known to be wrong only when the first episodes draw them; see :func:`~bsk_torch.cli.terminal.of_arguments`.
    """
    with working(f"building {preset}"):
        from bsk_torch.presets import make

        with refusing(KeyError, ImportError, ValueError), refusing(TypeError, why=why):
            return make(preset, num_envs=num_envs, **options)


def environment(preset: str, num_envs: int, options: Mapping[str, object], why: str = "") -> Tasking:
    """Return an environment in which policies are trained and evaluated; ends the program for agents of many satellites."""
    env = made(preset, num_envs, options, why)
    from bsk_torch.rl.policies.shared_policy import member_views

    with refusing(why=f"{preset} cannot be learned: "):
        member_views(env)
    return env


def seed_range(text: str, option: str = "--seeds") -> range:
    """Return the seeds that ``A:B`` or a single number names; ends the program for anything else."""
    first, colon, end = text.partition(":")
    try:
        seeds = range(int(first), int(end) if colon else int(first) + 1)
    except ValueError:
        fail(f"{option} {text!r} must be A:B, such as 0:1000, or a single number")
    if not seeds or seeds.start < 0:
        fail(f"{option} {text!r} names no episode; in A:B, A is at least 0 and B is larger")
    if seeds[-1] > LARGEST_SEED:
        fail(f"{option} {text!r}: seeds must be at most {LARGEST_SEED}")
    if seeds[-1] - seeds[0] >= MOST_SEEDS:
        fail(f"{option} {text!r} names more than {MOST_SEEDS} episodes")
    return seeds


def check_writable(*files: Path | None) -> None:
    """End the program if one of the files could not be written, before an hour of work is lost."""
    for path in (path for path in files if path is not None):
        if path.is_dir():
            fail(f"{str(path)!r} is a folder; name a file in it")
        if not path.parent.is_dir():
            fail(f"{str(path)!r} cannot be written: there is no folder {str(path.parent)!r}")
        if path.is_symlink() or (path.exists() and not path.is_file()):
            fail(f"{str(path)!r} is no ordinary file, which would be replaced; name another one")
        if (why := unwritable(path.parent)) is not None:
            fail(f"{str(path)!r} cannot be written: {why}")


PICTURES = (".png", ".svg", ".pdf")
"""What the names of pictures end with."""


def check_file(option: str, path: Path, kinds: Sequence[str]) -> None:
    """End the program if a file's name does not end with one of ``kinds``, or the file could not be written."""
    if path.suffix not in kinds:
        fail(f"{option} {str(path)!r} must end with {', '.join(kinds[:-1])} or {kinds[-1]}")
    check_writable(path)


def drawing(path: Path | None, figure: str) -> Any:
    """Return the module ``figure``, which draws the picture ``--draw``, if any; ends the program if it could not be written."""
    if path is None:
        return None
    check_file("--draw", path, PICTURES)
    return extra(figure)


def extra(module: str, extras: str = "viz") -> Any:
    """Return a module that needs the packages of ``extras``; ends the program if one is missing."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        fail(f"this needs {error.name}; pip install 'bsk_torch[{extras}]'")
