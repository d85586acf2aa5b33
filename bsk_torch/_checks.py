"""Checks of values that users give: numbers within bounds, whole numbers, switches, functions, gradients. All raise ValueError.

Messages name the argument, the value and what is allowed. These functions are for arguments of constructors; tables of arguments
(:class:`bsk_torch.sim.component.Arg`) check tensors of values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np
from torch import Tensor

Value = TypeVar("Value")


def no_gradient(title: str, value: Value) -> Value:
    """Return a value of the user in which no tensor requires a gradient: the simulation does not differentiate.

    Args:
        title: What the user calls it, for the message.
        value: Anything; tensors are looked for in mappings, tensordicts, lists and tuples.

    Raises:
        ValueError: For a tensor that requires a gradient, which would be cut.
    """
    if isinstance(value, Tensor):
        if value.requires_grad:
            raise ValueError(
                f"{title} requires a gradient, and the simulation does not differentiate; use .detach(), or compute it under "
                "torch.no_grad(), as in: with torch.no_grad(): env.rollout(100, policy)"
            )
    elif isinstance(value, Mapping):
        for name, part in value.items():
            no_gradient(f"{title}[{name!r}]", part)
    elif isinstance(value, list | tuple):
        for k, part in enumerate(value):
            if not isinstance(part, Real):
                no_gradient(f"{title}[{k}]", part)
    return value


def interval(low: float, high: float, unit: str = "", above: bool = False, finite: bool = True) -> str:
    """Return bounds as text, such as ``"a number in (0, 60] s"``; ``above`` excludes ``low``, ``finite`` infinite bounds."""
    unit = f" {unit}" if unit else ""
    if low == -math.inf and high == math.inf:
        return f"a {'finite ' if finite else ''}number{f' of{unit}' if unit else ''}"
    begin = "(" if above or (finite and low == -math.inf) else "["
    end = ")" if finite and high == math.inf else "]"
    return f"a number in {begin}{low:g}, {high:g}{end}{unit}"


def number(
    title: str,
    value: object,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    unit: str = "",
    above: bool = False,
    finite: bool = True,
    none: bool = False,
) -> float:
    """Return a number of the user as a float.

    Args:
        title: What the user calls it, for the message.
        value: A number, or an array or tensor of one; neither a string nor a bool.
        low: Smallest allowed value.
        high: Largest allowed value.
        unit: Unit, for the message.
        above: Whether ``low`` itself is excluded.
        finite: Whether infinity is excluded.
        none: Whether the message also lists None as allowed; callers handle it before.

    Raises:
        ValueError: For anything else.
    """
    result = _real(no_gradient(title, value))
    within = result is not None and low <= result <= high and not (above and result == low)
    if result is None or not within or (finite and math.isinf(result)):
        raise ValueError(f"{title}={value!r} must be {interval(low, high, unit, above, finite)}{', or None' if none else ''}")
    return result


def _real(value: object) -> float | None:
    if isinstance(value, bool | np.bool_):
        return None
    if not isinstance(value, Real):
        # arrays and tensors of one number
        if getattr(value, "shape", None) not in ((), (1,)) or isinstance(value, np.generic) or not hasattr(value, "item"):
            return None
        return _real(value.item())
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf  # type: ignore[operator]


def whole(title: str, value: object, low: int, high: int | None = None) -> int:
    """Return a whole number of the user from ``low`` to ``high`` as an int; ValueError for anything else, floats included."""
    result = int(value) if isinstance(value, Integral) and not isinstance(value, bool | np.bool_) else None
    if result is None or result < low or (high is not None and result > high):
        allowed = f"from {low} on" if high is None else f"from {low} to {high}"
        raise ValueError(f"{title}={value!r} must be a whole number {allowed}")
    return result


def switch(title: str, value: object) -> bool:
    """Return a switch of the user; ValueError for anything but True and False (or 1 and 0)."""
    if isinstance(value, bool | np.bool_) or (isinstance(value, Integral) and value in (0, 1)):
        return bool(value)
    raise ValueError(f"{title}={value!r} must be True or False")


def text(title: str, value: object) -> str:
    """Return a text of the user; ValueError for anything but a string that is not empty."""
    if isinstance(value, str) and value:
        return value
    raise ValueError(f"{title}={value!r} must be a string that is not empty")


def parts(title: str, value: object, kind: type[Value], what: str, empty: bool = False) -> tuple[Value, ...]:
    """Return a list of the user as a tuple; ValueError, which asks for ``what``, unless all its entries are of a kind."""
    if isinstance(value, Sequence) and (value or empty) and all(isinstance(part, kind) for part in value):
        return tuple(value)
    raise ValueError(f"{title}={value!r} must be {what}")


def vector(title: str, value: object, zero: bool = False, longest: float = math.inf) -> tuple[float, float, float]:
    """Return three finite numbers of the user as a tuple; ValueError for anything else, and for only zeros unless ``zero``.

    ``longest`` is the greatest length that is allowed.
    """
    no_gradient(title, value)
    try:
        x, y, z = np.asarray(value.cpu() if isinstance(value, Tensor) else value, dtype=float).tolist()
        length = math.hypot(x, y, z)
    except (TypeError, ValueError, OverflowError):
        length = math.nan
    if not math.isfinite(length) or length > longest or (length == 0.0 and not zero):
        kind = "all finite" if zero else "finite and not all zero, such as [0, 0, 1]"
        limit = "" if math.isinf(longest) else f", of a length of at most {longest:g}"
        raise ValueError(f"{title}={value!r} must be three numbers, {kind}{limit}")
    return x, y, z


def function(title: str, value: object, what: str) -> Callable[..., Any]:
    """Return a user function; ValueError for what is none; ``what`` says of what it is a function."""
    if callable(value) and not isinstance(value, type):
        return value
    raise ValueError(f"{title}={value!r} must be a function of {what}")
