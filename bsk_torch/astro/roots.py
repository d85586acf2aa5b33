"""Roots and maxima of many functions of one variable at once."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Function = Callable[[Tensor], Tensor]


def next_guess(a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor) -> Tensor:
    """Where the straight line through two points of f is zero; if they are equally high, f_b before b."""
    return b - f_b * (b - a) / torch.where(f_b == f_a, torch.ones_like(f_a), f_b - f_a)


def refined(a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor, c: Tensor, f_c: Tensor) -> tuple[Tensor, ...]:
    """The bracket a, b, f_a, f_b with the new point c: regula falsi, Illinois variant."""
    crossed = (f_c < 0.0) ^ (f_b < 0.0)
    return torch.where(crossed, b, a), c, torch.where(crossed, f_b, 0.5 * f_a), f_c


def halved(a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor, c: Tensor, f_c: Tensor) -> tuple[Tensor, ...]:
    """The bracket a, b, f_a, f_b with its middle c."""
    crossed = (f_c < 0.0) ^ (f_b < 0.0)
    return torch.where(crossed, b, a), c, torch.where(crossed, f_b, f_a), f_c


def find_root(f: Function, a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor, iterations: int = 12, bisections: int = 0) -> Tensor:
    """Root of f between a and b, where its values f_a and f_b have opposite signs.

    For functions that are nearly straight in the bracket twelve iterations reach the rounding error. Others, such as those that
    turn near one of its ends, need ``bisections`` first, until they are.
    """
    for _ in range(bisections):
        c = 0.5 * (a + b)
        a, b, f_a, f_b = halved(a, b, f_a, f_b, c, f(c))
    for _ in range(iterations):
        c = next_guess(a, b, f_a, f_b)
        a, b, f_a, f_b = refined(a, b, f_a, f_b, c, f(c))
    return b


GOLDEN = 0.5 * (5.0**0.5 - 1.0)


def sections(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """The two points of the golden section of an interval."""
    return b - GOLDEN * (b - a), a + GOLDEN * (b - a)


def narrowed(a: Tensor, b: Tensor, left: Tensor, f_left: Tensor, right: Tensor, f_right: Tensor) -> tuple[Tensor, ...]:
    """The interval a, b without what cannot hold the maximum, and the point in it that is still to be looked at."""
    higher = f_left < f_right
    a, b = torch.where(higher, left, a), torch.where(higher, b, right)
    return a, b, torch.where(higher, a + GOLDEN * (b - a), b - GOLDEN * (b - a))


def placed(left: Tensor, f_left: Tensor, right: Tensor, f_right: Tensor, new: Tensor, f_new: Tensor) -> tuple[Tensor, ...]:
    """The section's points left, f_left, right, f_right after the new one has been looked at."""
    higher = f_left < f_right
    old, f_old = torch.where(higher, right, left), torch.where(higher, f_right, f_left)
    return (
        torch.where(higher, old, new),
        torch.where(higher, f_old, f_new),
        torch.where(higher, new, old),
        torch.where(higher, f_new, f_old),
    )


def find_maximum(f: Function, a: Tensor, b: Tensor, iterations: int = 25) -> Tensor:
    """Place of the maximum of f, unimodal between a and b, to 6e-6 of their distance (golden-section search)."""
    left, right = sections(a, b)
    f_left, f_right = f(left), f(right)
    for _ in range(iterations):
        a, b, new = narrowed(a, b, left, f_left, right, f_right)
        left, f_left, right, f_right = placed(left, f_left, right, f_right, new, f(new))
    return 0.5 * (a + b)
