"""Checks and draws of the arguments of target scenarios: numbers of targets, one number per target, and positions."""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch._checks import no_gradient, number
from bsk_torch.rand import Distribution, Key, PerEnv, first_key, seeded

Numbers = float | Sequence[float] | Distribution | Callable[[], float]
"""Numbers of the targets: one for all, a list, a distribution of :mod:`bsk_torch.rand`, or a callable without arguments."""

Count = int | tuple[int, int]
"""A number of targets, or a range of it with an exclusive end."""

MOST_TARGETS = 10**7
"""Upper bound of the number of targets, since every episode stores all of them."""

MIN_RADIUS = 6.3e6
"""Minimum distance of a target from the Earth's center, m; the poles are at 6.357e6."""

MAX_RADIUS_IN_KM = 1e7
"""A distance below the minimum in m, but between the minimum and this value in km, was probably given in km by mistake."""


def count_range(what: str, count: Count) -> tuple[int, int]:
    """Return the smallest number of targets and the exclusive end of its range, of the user's argument ``what``."""
    try:
        low, end = map(operator.index, count if isinstance(count, Sequence) else (count, count + 1))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what}={count!r} must be an integer, or a range (low, high) of two integers") from error
    if low < 0:
        raise ValueError(f"{what}={count!r} asks for {low} targets; there must be at least 0")
    if end > MOST_TARGETS:
        raise ValueError(f"{what}={count!r} asks for too many targets; there may be up to {MOST_TARGETS}")
    if end <= low:
        raise ValueError(f"{what}={count!r} is empty: high is exclusive, so it must be at least {low + 1}")
    return low, end


def columns_for(end: int) -> int:
    """Return the number of columns for fewer than ``end`` targets, at least one column of padding."""
    return max(1, end - 1)


def draw_exists(key: Key, low: int, end: int) -> Tensor:
    """Draw the number of targets uniformly from ``low`` to ``end - 1``; return 1.0 for the columns of targets, 0.0 for padding.

    The shape is [n, T], or [1, T] if the range contains a single number, with T from :func:`columns_for`.
    """
    columns = torch.arange(columns_for(end))
    if end == low + 1:
        return (columns < low).double().unsqueeze(0)
    return (columns < low + torch.floor(key.uniform(1) * (end - low))).double()


def calls_user(*values: object) -> bool:
    """Return whether one of the values is a user function."""
    return any(callable(value) and not isinstance(value, Distribution) for value in values)


def as_numbers(value: object) -> Tensor:
    """Return numbers, sequences, arrays or tensors as a float64 tensor on the CPU; TypeError, ValueError, RuntimeError else."""
    try:
        return torch.as_tensor(value.cpu() if isinstance(value, Tensor) else np.asarray(value, dtype=float)).double()
    except OverflowError as error:
        raise ValueError(str(error)) from error


def _drawn(value: object, key: Key, count: int) -> Tensor:
    if isinstance(value, Distribution):
        if dataclasses.is_dataclass(value) and getattr(value, "size", count) is None:
            value = dataclasses.replace(value, size=count)
        rows = as_numbers(value.draw(key))
        return rows.unsqueeze(-1).expand(-1, count) if isinstance(value, PerEnv) and rows.ndim == 1 else rows
    if callable(value):
        with seeded(key) as envs:
            return torch.tensor(
                [[float(no_gradient("a value of the function", value())) for _ in range(count)] for _ in envs],
                dtype=torch.float64,
            ).view(len(key), count)
    numbers = as_numbers(value)
    return numbers.unsqueeze(0) if numbers.ndim else numbers.expand(1, count)


def draw_numbers(
    what: str, value: object, key: Key, count: int, low: float = -math.inf, high: float = math.inf, unit: str = ""
) -> Tensor:
    """Draw one number for each of ``count`` targets, [n or 1, count] float64 on the CPU, of the user's argument ``what``."""
    no_gradient(what, value)
    try:
        numbers, problem = _drawn(value, key, count), ""
    except (TypeError, ValueError, RuntimeError) as error:
        numbers, problem = torch.empty(0, dtype=torch.float64), f": {error}"
    if numbers.shape not in ((len(key), count), (1, count)):
        raise ValueError(
            f"{what}={value!r} does not give one number for each of {count} targets{problem}; allowed are a number, {count} "
            f"numbers, rand.Uniform, rand.Normal or rand.Choice without a size, another distribution that draws [n, {count}], "
            f"rand.per_env with {count} columns, or a callable without arguments"
        )
    if numbers.numel() and not all(low <= end <= high and math.isfinite(end) for end in map(float, numbers.aminmax())):
        bad = ~((numbers >= low) & (numbers <= high) & numbers.isfinite())
        row, column = (int(i) for i in torch.nonzero(bad)[0])
        asked = "it must be a finite number" + (f" in [{low:g}, {high:g}]" if math.isfinite(low) or math.isfinite(high) else "")
        worst = f"{numbers[row, column].item():g} {unit}".strip()
        raise ValueError(f"{what} is {worst} for target {column} of environment {int(key.env_id[row])}; {asked}")
    return numbers


def check_numbers(what: str, value: Any, count: int, **bounds: Any) -> None:
    """Raise the errors of :func:`draw_numbers` for the first episode, without calling user functions."""
    if not calls_user(value):
        draw_numbers(what, value, first_key(1), count, **bounds)


def check_radius(what: str, radius: float) -> float:
    """Return ``radius``, m; ValueError if it lies inside the Earth."""
    found = number(what, radius, finite=False)
    problem = _inside(torch.tensor(found, dtype=torch.float64))
    if problem:
        raise ValueError(f"{what}={radius!r}: the distance {problem}")
    return found


def check_positions(r_LP_P: Tensor, of: str = "") -> None:
    """Raise ValueError for the first invalid position of [T, 3] m; ``of`` completes the message."""
    distance = r_LP_P.norm(dim=-1)
    bad = torch.nonzero(~((distance >= MIN_RADIUS) & distance.isfinite()))
    if len(bad):
        k = int(bad[0])
        raise ValueError(f"r_LP_P of target {k}{of} is {r_LP_P[k].tolist()}: its distance {_inside(distance[k])}")


def _inside(distance: Tensor) -> str:
    """Return the error in a distance from the Earth's center, m; an empty string for a valid distance."""
    meant = " (km? then multiply by 1000)" if MIN_RADIUS <= 1000.0 * float(distance) <= MAX_RADIUS_IN_KM else ""
    if distance.isfinite() and float(distance) >= MIN_RADIUS:
        return ""
    fault = f"from the Earth's center is {float(distance):g} m{meant}"
    return f"{fault}; positions are Earth-fixed, in meters, at least {MIN_RADIUS:g} m"


def on_sphere(
    u: Tensor,
    west: Tensor | float = -math.pi,
    width: Tensor | float = 2.0 * math.pi,
    span: tuple[Tensor | float, Tensor | float] = (-1.0, 1.0),
) -> Tensor:
    """Return unit vectors [..., 3], uniformly distributed by area, for uniform numbers ``u`` [..., 2].

    The sine of the latitude, z, and the longitude lambda are uniform: equal intervals of z bound equal areas of a sphere::

        z = z_south + (z_north - z_south) u_0        lambda = west + width u_1
        r = (sqrt(1 - z^2) cos(lambda), sqrt(1 - z^2) sin(lambda), z)

    Args:
        u: Numbers in [0, 1).
        west: Western edge, rad.
        width: Extent in longitude, rad.
        span: Sines of the southern and of the northern latitude.
    """
    z = span[0] + (span[1] - span[0]) * u[..., 0]
    longitude = west + width * u[..., 1]
    rho = torch.sqrt((1.0 - z) * (1.0 + z))
    return torch.stack([rho * torch.cos(longitude), rho * torch.sin(longitude), z], -1)


def horizontal(r: Tensor) -> tuple[Tensor, Tensor]:
    """Return two unit vectors [..., 3] perpendicular to places ``r`` [..., 3] and to each other."""
    up = r / r.norm(dim=-1, keepdim=True)
    # the axis farthest from the place, so that the cross product is well defined
    axis = torch.nn.functional.one_hot(up.abs().argmin(-1), 3).to(r)
    one = torch.linalg.cross(axis, up)
    one = one / one.norm(dim=-1, keepdim=True)
    return one, torch.linalg.cross(up, one)
