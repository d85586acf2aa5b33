"""Interpolation between positions at equal steps of time, by the polynomial through ten of them."""

from __future__ import annotations

import functools
import operator
from functools import cache

import torch
from torch import Tensor

from bsk_torch.astro.multistep import lagrange
from bsk_torch.vec3 import Vec3

COUNT, BEFORE = 10, 4
"""Nodes of an interpolating polynomial, and how many of them lie before the start of the middle interval."""


@cache
def _from_differences() -> tuple[tuple[float, ...], ...]:
    """Return the matrix from the nodes' differences to node :data:`BEFORE` to the coefficients of s, s^2, ... (rows), s in steps.

    Its columns are Lagrange's polynomials ``l_j(s)`` of the other nodes, exact fractions rounded once: the same on every
    processor. As ``sum_j l_j(s) = 1``, ``r(s) = r_m + sum_j (r_j - r_m) l_j(s)`` with the middle node m.
    """
    polynomials = lagrange(tuple(k - BEFORE for k in range(COUNT)))
    columns = [terms for k, terms in enumerate(polynomials) if k != BEFORE]
    return tuple(tuple(float(terms[power]) for terms in columns) for power in range(1, COUNT))


def coefficients(nodes: list[Vec3]) -> list[Vec3]:
    """Return the coefficients c_k, m, of ``r(s) = sum_k c_k s^k`` through COUNT nodes; s counts steps from node BEFORE."""
    middle = nodes[BEFORE]
    differences = [node - middle for k, node in enumerate(nodes) if k != BEFORE]
    rows = ([d * w for d, w in zip(differences, row, strict=True)] for row in _from_differences())
    return [middle, *(functools.reduce(operator.add, terms) for terms in rows)]


def position(c: list[Vec3], s: Tensor) -> Vec3:
    """Return the position ``r(s) = sum_k c_k s^k``, m, s steps after the middle node (Horner's rule).

    For a low orbit and steps of 60 s it is good to a few micrometers.
    """
    r = c[-1]
    for term in c[-2::-1]:
        r = term + r * s
    return r


def velocity(c: list[Vec3], s: Tensor, step: float) -> Vec3:
    """Return the velocity ``v(s) = sum_k k c_k s^(k-1) / step``, m/s, where a step lasts ``step`` seconds."""
    v = c[-1] * float(len(c) - 1)
    for k in range(len(c) - 2, 0, -1):
        v = c[k] * float(k) + v * s
    return v * (1.0 / step)


def positions(nodes: Tensor, s: Tensor) -> Tensor:
    """Return positions [m, 3], m, from nodes [m, COUNT, 3], s [m] steps after the middle node of each."""
    c = coefficients([Vec3.of(node) for node in nodes.unbind(-2)])
    return torch.stack(list(position(c, s)), -1)
