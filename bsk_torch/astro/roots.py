"""Roots and maxima of many functions of one variable at once."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Function = Callable[[Tensor], Tensor]


def find_root(f: Function, a: Tensor, b: Tensor, f_a: Tensor, f_b: Tensor, iterations: int = 12) -> Tensor:
    """Root of f between a and b, where its values f_a and f_b have opposite signs (regula falsi, Illinois variant).

    For functions that are nearly straight in the bracket twelve iterations reach the rounding error.
    """
    for _ in range(iterations):
        c = b - f_b * (b - a) / torch.where(f_b == f_a, torch.ones_like(f_a), f_b - f_a)
        f_c = f(c)
        crossed = (f_c < 0.0) != (f_b < 0.0)
        a, f_a = torch.where(crossed, b, a), torch.where(crossed, f_b, 0.5 * f_a)
        b, f_b = c, f_c
    return b


GOLDEN = 0.5 * (5.0**0.5 - 1.0)


def find_maximum(f: Function, a: Tensor, b: Tensor, iterations: int = 25) -> Tensor:
    """Place of the maximum of f, unimodal between a and b, to 6e-6 of their distance (golden-section search)."""
    left, right = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
    f_left, f_right = f(left), f(right)
    for _ in range(iterations):
        higher = f_left < f_right
        a, b = torch.where(higher, left, a), torch.where(higher, b, right)
        new = torch.where(higher, a + GOLDEN * (b - a), b - GOLDEN * (b - a))
        f_new = f(new)
        left, f_left, right, f_right = (
            torch.where(higher, right, new),
            torch.where(higher, f_right, f_new),
            torch.where(higher, new, left),
            torch.where(higher, f_new, f_left),
        )
    return 0.5 * (a + b)
