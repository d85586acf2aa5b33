"""What users say about a set of targets, checked and drawn: how many, worth how much, and where."""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch.rand import Distribution, Key, PerEnv, first_key

Numbers = float | Distribution | Callable[[], float]
"""One number for each target: the same for all, a distribution of :mod:`bsk_torch.rand`, or a callable without arguments."""

Count = int | tuple[int, int]
"""A number of targets, or a range of it with an exclusive end."""

LOWEST = 6.3e6
"""Least distance from the Earth's centre at which a target may lie, m; the poles are at 6.357e6."""

HIGHEST = 1e7
"""Largest distance, m, that a position given in km by mistake is assumed to mean."""


def count_range(what: str, count: Count) -> tuple[int, int]:
    """Least number and exclusive end of the number of targets; ValueError unless there is always at least one."""
    try:
        low, end = map(operator.index, count if isinstance(count, Sequence) else (count, count + 1))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what}={count!r} must be an integer, or a range (low, high) of two integers") from error
    if low < 1:
        raise ValueError(f"{what}={count!r} asks for {low} targets; there must be at least 1")
    if end <= low:
        raise ValueError(f"{what}={count!r} is empty: high is exclusive, as in bsk_rl, so it must be at least {low + 1}")
    return low, end


def draw_exists(key: Key, low: int, end: int) -> Tensor:
    """1.0 for the first ``low`` to ``end - 1`` of ``end - 1`` columns, a uniformly drawn number of them, and 0.0 for the others.

    [n, end - 1], or [1, end - 1] where there is only one number.
    """
    columns = torch.arange(end - 1)
    if end == low + 1:
        return torch.ones(1, end - 1, dtype=torch.float64)
    return (columns < low + torch.floor(key.uniform(1) * (end - low))).double()


def calls_user(*values: Any) -> bool:
    """Whether one of the values is a callable of the user's."""
    return any(callable(value) and not isinstance(value, Distribution) for value in values)


def as_numbers(value: Any) -> Tensor:
    """Whatever holds numbers as a float64 tensor on the CPU; TypeError, ValueError or RuntimeError for anything else."""
    return torch.as_tensor(value.detach().cpu() if isinstance(value, Tensor) else np.asarray(value, dtype=float)).double()


def _drawn(value: Any, key: Key, count: int) -> Tensor:
    if isinstance(value, Distribution):
        if dataclasses.is_dataclass(value) and getattr(value, "size", count) is None:
            value = dataclasses.replace(value, size=count)
        rows = as_numbers(value.draw(key))
        return rows.unsqueeze(-1).expand(-1, count) if isinstance(value, PerEnv) and rows.ndim == 1 else rows
    if callable(value):
        return torch.tensor([[float(value()) for _ in range(count)] for _ in range(len(key))], dtype=torch.float64)
    given = as_numbers(value)
    return given.unsqueeze(0) if given.ndim else given.expand(1, count)


def draw_numbers(
    what: str, value: Any, key: Key, count: int, low: float = -math.inf, high: float = math.inf, unit: str = ""
) -> Tensor:
    """One number in [low, high] for each of ``count`` targets, [n or 1, count] float64 on the CPU.

    ValueError if ``value``, the user's argument ``what``, does not give as many, or gives others.
    """
    try:
        numbers, problem = _drawn(value, key, count), ""
    except (TypeError, ValueError, RuntimeError) as error:
        numbers, problem = torch.empty(0), f": {error}"
    if numbers.shape not in ((len(key), count), (1, count)):
        raise ValueError(
            f"{what}={value!r} does not give one number for each of {count} targets{problem}; allowed are a number, {count} "
            f"numbers, rand.Uniform, rand.Normal or rand.Choice without a size, another distribution that draws [n, {count}], "
            f"rand.per_env with {count} columns, or a callable without arguments"
        )
    bad = ~((numbers >= low) & (numbers <= high) & numbers.isfinite())
    if bool(bad.any()):
        row, column = (int(i) for i in torch.nonzero(bad)[0])
        asked = "it must be a finite number" + (f" in [{low:g}, {high:g}]" if math.isfinite(low) or math.isfinite(high) else "")
        worst = f"{numbers[row, column].item():g} {unit}".strip()
        raise ValueError(f"{what} is {worst} for target {column} of environment {int(key.env_id[row])}; {asked}")
    return numbers


def check_numbers(what: str, value: Any, count: int, **bounds: Any) -> None:
    """Raise what :func:`draw_numbers` would for the first episode, without calling functions of the user."""
    if not calls_user(value):
        draw_numbers(what, value, first_key(1), count, **bounds)


def check_radius(what: str, radius: float) -> float:
    """``radius`` in m; ValueError where that lies inside the Earth."""
    problem = _inside(torch.tensor(float(radius), dtype=torch.float64))
    if problem:
        raise ValueError(f"{what}={radius!r}: the distance {problem}")
    return float(radius)


def check_positions(r_LP_P: Tensor, of: str = "") -> None:
    """ValueError naming the first of the positions [T, 3] that no target can have; ``of`` says whose they are."""
    distance = r_LP_P.norm(dim=-1)
    bad = torch.nonzero(~((distance >= LOWEST) & distance.isfinite()))
    if len(bad):
        k = int(bad[0])
        raise ValueError(f"r_LP_P of target {k}{of} is {r_LP_P[k].tolist()}: its distance {_inside(distance[k])}")


def _inside(distance: Tensor) -> str:
    """What is wrong with a distance from the Earth's centre in m, if anything."""
    meant = " (km? then multiply by 1000)" if LOWEST <= 1000.0 * float(distance) <= HIGHEST else ""
    if distance.isfinite() and float(distance) >= LOWEST:
        return ""
    return f"from the Earth's centre is {float(distance):g} m{meant}; positions are Earth-fixed, in metres, at least {LOWEST:g} m"


def on_sphere(u: Tensor, west: Any = -math.pi, width: Any = 2.0 * math.pi, span: Any = (-1.0, 1.0)) -> Tensor:
    """Unit vectors [..., 3] for uniform numbers ``u`` [..., 2], uniform by area.

    Args:
        u: Numbers in [0, 1).
        west: Western edge, rad.
        width: Extent in longitude, rad.
        span: Sines of the least and of the largest latitude.
    """
    z = span[0] + (span[1] - span[0]) * u[..., 0]
    longitude = west + width * u[..., 1]
    rho = torch.sqrt((1.0 - z) * (1.0 + z))
    return torch.stack([rho * torch.cos(longitude), rho * torch.sin(longitude), z], -1)
