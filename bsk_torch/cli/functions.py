"""Policies of the user's own modules, named as ``package.module:name``."""

from __future__ import annotations

import inspect
import logging
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from torch import nn

from bsk_torch.cli.terminal import Failure, fail
from bsk_torch.env import Tasking
from bsk_torch.sim.names import nearest
from bsk_torch.wrappers.policies import Model

logger = logging.getLogger(__name__)

Enter = Callable[[str, Callable[..., Tasking]], Any]
"""Enters a policy: a function of the name of a preset and of a function that makes its environment. It is to return this
environment and a policy; what a user's function returns may be anything."""

OBSERVED = ("observation", "obs")
"""Names of the first argument of functions that are policies themselves."""


def entrant_of_user(name: str, texts: Sequence[str] = ()) -> Enter:
    """Return what enters the object ``package.module:name`` of the user's; ends the program if there is none.

    A torch module, a model of Stable-Baselines3, and a function whose first argument is called ``observation`` or ``obs`` are
    policies. Any other function is called with the name of the preset, a function that makes its environment, and ``texts``, and
    returns this environment and a policy.
    """
    named = imported(*name.split(":", 1))
    if isinstance(named, nn.Module | Model) or first_argument(named) in OBSERVED:
        return lambda preset, make: (make(), named)
    check_takes(named, name, texts)
    return lambda preset, make: named(preset, make, *texts)


def first_argument(function: Callable[..., object]) -> str | None:
    """Return the name of the first argument of a function; None if there is none, or no signature."""
    try:
        return next(iter(inspect.signature(function).parameters), None)
    except ValueError:  # of a function that is not written in Python
        return None


def message_of(error: BaseException) -> str:
    """Return the message of an error; its type precedes it unless the message is this package's, or tells what is wrong."""
    return (
        str(error) if isinstance(error, (TypeError, ValueError, Failure)) and str(error) else f"{type(error).__name__}: {error}"
    )


def imported(module: str, function: str) -> Any:
    """Return a function, module or model of the user's; ends the program if it cannot be imported."""
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # where a user's module is, as python -m would find it
    try:
        named = getattr(loaded := import_module(module), function, None)
    except Exception as error:  # a user's module may raise anything
        logger.debug("%s cannot be imported", module, exc_info=error)
        hint = f"; write {module.removesuffix('.py')}:{function}" if module.endswith(".py") else ""
        fail(f"{module}:{function} cannot be imported: {message_of(error)}{hint}")
    if named is None:
        own = [name for name, value in vars(loaded).items() if getattr(value, "__module__", None) == loaded.__name__]
        fail(f"{module}:{function} cannot be imported: {module} has no {function!r}; {nearest(function, own)}")
    if not callable(named) and not isinstance(named, Model):
        fail(f"{module}:{function} is neither a policy nor a function of a preset's name and make")
    return named


def check_takes(function: Callable[..., object], title: str, texts: Sequence[str]) -> None:
    """End the program for a function that cannot be called with the name of a preset, ``make`` and further ``texts``."""
    try:
        taken = inspect.signature(function)
    except ValueError:  # of a function that is not written in Python
        return
    try:
        taken.bind("preset", "make", *texts)
    except TypeError as error:
        further = f", and the {len(texts)} texts after its commas" if texts else ""
        fail(f"{title} takes {taken}; it must take the name of a preset and make, (preset, make){further}: {error}")
