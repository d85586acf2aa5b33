"""Dictionaries that describe observed properties: ``prop`` or ``fn``, ``norm``, ``name``."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.sim.hooks import is_of_package

Norm = float | Tensor
"""Divisor: a number, or one for each component of a property."""


def parse_entries(entries: Iterable[Mapping[str, object]], allowed: set[str], title: str) -> tuple[dict[str, Any], ...]:
    """Return copies of a user's dictionaries, with ``norm`` and ``name`` set.

    ``fn`` takes precedence over ``prop``, which is then just the label. Names are ``name``; else ``prop``, or
    ``prop_0`` and so on for a function without one, with ``_normd`` where a norm divides it.
    """
    parsed = tuple(_parsed(entry, number, allowed, title) for number, entry in enumerate(entries))
    if not parsed:
        raise ValueError(f"{title} has no properties; give a dictionary for each, such as dict(prop='name of a property')")
    names = [entry["name"] for entry in parsed]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"{title} has several properties called {twice}; tell them apart by the key 'name'")
    return parsed


def _parsed(entry: object, number: int, allowed: set[str], title: str) -> dict[str, Any]:
    if not isinstance(entry, dict):
        raise TypeError(f"{title} got {entry!r}; it must be a dictionary, such as dict(prop={str(entry)!r})")
    unknown = set(entry) - allowed
    if unknown:
        raise ValueError(f"{title} got unknown keys {sorted(unknown)} in {entry}; allowed are {sorted(allowed)}")
    settings = {key: value for key, value in entry.items() if value is not None}
    if "prop" not in settings and "fn" not in settings:
        raise ValueError(f"{title} needs 'prop' or 'fn' in {entry}")
    if "fn" not in settings and not isinstance(settings["prop"], str):
        raise ValueError(f"{title}: prop={settings['prop']!r} must be the name of a property")
    if "fn" in settings and not callable(settings["fn"]):
        raise TypeError(f"{title}: fn={settings['fn']!r} must be a function")
    norm = parse_norm(settings.get("norm"), f"{title}: norm of {entry}")
    default = str(settings.get("prop", f"prop_{number}")) + ("_normd" if isinstance(norm, Tensor) or norm != 1.0 else "")
    return {**settings, "norm": norm, "name": str(settings.get("name", default))}


def parse_norm(norm: object, title: str) -> Norm:
    """Return a norm as a number or a tensor; 1 for None. ValueError unless it is a nonzero number."""
    no_gradient(title, norm)
    try:
        table = torch.as_tensor(1.0 if norm is None else norm, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        raise ValueError(f"{title} is {norm!r}; it must be a number, an array of numbers, or None for 1") from None
    if not bool(((table != 0.0) & torch.isfinite(table)).all()):
        raise ValueError(f"{title} is {norm!r}; it must not be zero, NaN or infinite")
    return table.item() if table.ndim == 0 else table


def scaled(value: Tensor, norm: Norm) -> Tensor:
    """Return the value divided by its norm."""
    if isinstance(norm, Tensor):
        return value / norm.to(value.device)
    return value if norm == 1.0 else value / norm


def is_own(function: Callable[..., object]) -> bool:
    """Return whether a function, or a partial of one, belongs to this package and so takes all satellites at once."""
    while isinstance(function, functools.partial):
        function = function.func
    return is_of_package(function)
