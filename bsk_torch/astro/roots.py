"""Roots and maxima of many functions of one variable at once.

The steps of the searches are separate functions, which kernels take, too.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Function = Callable[[Tensor], Tensor]


def next_guess(a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor) -> Tensor:
    """Return the zero of the straight line through two points of f: ``c = b - f_b (b - a) / (f_b - f_a)``.

    Where f_b = f_a the quotient's divisor is taken for 1, so that the result is finite.
    """
    return b - f_b * (b - a) / torch.where(f_b == f_a, torch.ones_like(f_a), f_b - f_a)


def refined(a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor, c: Tensor, f_c: Tensor) -> tuple[Tensor, ...]:
    """Return the bracket a, b, f_a, f_b with the new point c: regula falsi, Illinois variant.

    c replaces b. Where f changes its sign between b and c, b becomes a; elsewhere a stays and f_a is halved, without which a
    would stay forever and convergence would be linear (Dowell and Jarratt, BIT 11, 1971).
    """
    crossed = (f_c < 0.0) ^ (f_b < 0.0)
    return torch.where(crossed, b, a), c, torch.where(crossed, f_b, 0.5 * f_a), f_c


def halved(a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor, c: Tensor, f_c: Tensor) -> tuple[Tensor, ...]:
    """Return the bracket a, b, f_a, f_b with its middle c: bisection."""
    crossed = (f_c < 0.0) ^ (f_b < 0.0)
    return torch.where(crossed, b, a), c, torch.where(crossed, f_b, f_a), f_c


def find_root(f: Function, a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor, iterations: int = 12, bisections: int = 0) -> Tensor:
    """Return a root of f between a and b, where its values f_a and f_b have opposite signs.

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
"""The golden ratio's inverse g, with ``g^2 = 1 - g``: one of the two points of a section is one of the next, shorter section."""


def sections(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Return the two points ``b - g (b - a)`` and ``a + g (b - a)`` of the golden section of an interval."""
    return b - GOLDEN * (b - a), a + GOLDEN * (b - a)


def narrowed(a: Tensor, b: Tensor, left: Tensor, f_left: Tensor, right: Tensor, f_right: Tensor) -> tuple[Tensor, ...]:
    """Return the interval a, b without the part that cannot hold the maximum, and the point in it to evaluate f at next."""
    higher = f_left < f_right
    a, b = torch.where(higher, left, a), torch.where(higher, b, right)
    return a, b, torch.where(higher, a + GOLDEN * (b - a), b - GOLDEN * (b - a))


def placed(left: Tensor, f_left: Tensor, right: Tensor, f_right: Tensor, new: Tensor, f_new: Tensor) -> tuple[Tensor, ...]:
    """Return the section's points left, f_left, right, f_right, once f has been evaluated at the new one."""
    higher = f_left < f_right
    old, f_old = torch.where(higher, right, left), torch.where(higher, f_right, f_left)
    return (
        torch.where(higher, old, new),
        torch.where(higher, f_old, f_new),
        torch.where(higher, new, old),
        torch.where(higher, f_new, f_old),
    )


def find_maximum(f: Function, a: Tensor, b: Tensor, iterations: int = 25) -> Tensor:
    """Return the place of the maximum of f, unimodal between a and b, to 6e-6 of their distance.

    Golden-section search (Press et al., "Numerical Recipes", chapter 10): every iteration shortens the interval by g = 0.618.
    """
    left, right = sections(a, b)
    f_left, f_right = f(left), f(right)
    for _ in range(iterations):
        a, b, new = narrowed(a, b, left, f_left, right, f_right)
        left, f_left, right, f_right = placed(left, f_left, right, f_right, new, f(new))
    return 0.5 * (a + b)
