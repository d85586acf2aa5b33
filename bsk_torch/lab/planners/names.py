"""Planners by name."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

from bsk_torch.env import Tasking
from bsk_torch.lab.planners.beam import BeamSearch
from bsk_torch.lab.planners.cross_entropy import CrossEntropy
from bsk_torch.lab.planners.planner import Planner
from bsk_torch.lab.planners.rollout import Rollout
from bsk_torch.lab.planners.search import TreeSearch
from bsk_torch.sim.names import nearest, one_of

PLANNERS: dict[str, type[Planner]] = {kind.name: kind for kind in (Rollout, BeamSearch, TreeSearch, CrossEntropy)}
"""Planners by their names on the command line."""


def find_planner(name: str) -> type[Planner]:
    """Return one of :data:`PLANNERS`; ValueError, with the nearest name, for an unknown name."""
    return PLANNERS[one_of("planner", name, PLANNERS)]


def options_of(name: str) -> list[str]:
    """Return the arguments of a planner, without the environment; ValueError for an unknown planner."""
    table: dict[str, inspect.Parameter] = {}
    for kind in reversed([kind for kind in find_planner(name).__mro__ if issubclass(kind, Planner)]):
        table |= inspect.signature(vars(kind)["__init__"]).parameters
    return [
        name for name, parameter in table.items() if name not in ("self", "env") and parameter.kind is not parameter.VAR_KEYWORD
    ]


def planner(name: str, env: Tasking, **options: Any) -> Planner:
    """Return a planner by its name.

    Args:
        name: One of :data:`PLANNERS`.
        env: The environment in which the planner acts.
        **options: Arguments of the planner, such as ``base="hasty"`` and ``horizon=240.0``.

    Raises:
        TypeError: For an unknown argument, with the nearest name; or from the planner.
        ValueError: For an unknown planner, with the nearest name; or from the planner.
    """
    kind, allowed = find_planner(name), options_of(name)
    for option in options:
        if option not in allowed:
            raise TypeError(
                f"unexpected keyword argument {option!r}: planner {name!r} has no such option; {nearest(option, allowed)}"
            )
    return kind(env, **options)


BY_HAND = ("value", "price", "prior")
"""Options that are modules or functions, which texts cannot name."""


def options_in(name: str, texts: Sequence[str]) -> dict[str, Any]:
    """Return the options of a planner in texts ``NAME=VALUE``; ValueError for others, and for unknown or unfit names."""
    allowed = [option for option in options_of(name) if option not in BY_HAND]
    options: dict[str, object] = {}
    for text in texts:
        option, equals, value = text.partition("=")
        if not equals or not value:
            raise ValueError(f"{text!r} must be NAME=VALUE, such as horizon=240")
        if option in BY_HAND:
            raise ValueError(
                f"{text!r}: {option!r} is a module or a function; give it in Python, to bsk_torch.lab.planners.planner"
            )
        if option not in allowed:
            raise ValueError(f"{text!r}: plan:{name} has no option {option!r}; {nearest(option, allowed)}")
        options[option] = None if value == "none" else _value(value)
    return options


def _value(text: str) -> object:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
