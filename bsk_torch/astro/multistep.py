"""Weights of a multistep method for orbits: accelerations at equal steps, integrated twice.

The method is Falkner's (Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", section III.10): position and
velocity at the last node, and the polynomial through the last accelerations. The first accelerations are found by iterating the
same integrals over a block of nodes. Weights are quotients of whole numbers, rounded once.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import lcm


@cache
def _whole(nodes: tuple[int, ...]) -> tuple[tuple[list[int], int], ...]:
    """Return the coefficients of :func:`lagrange` as whole numbers, and the positive number that divides them."""
    polynomials = []
    for node in nodes:
        terms, divisor = [1], 1
        for other in nodes:
            if other != node:
                terms = [a - other * b for a, b in zip([0, *terms], [*terms, 0], strict=True)]
                divisor *= node - other
        polynomials.append((terms, divisor) if divisor > 0 else ([-a for a in terms], -divisor))
    return tuple(polynomials)


def lagrange(nodes: tuple[int, ...]) -> tuple[tuple[Fraction, ...], ...]:
    """Return the coefficients, constant term first, of Lagrange's ``l_j(s) = prod_i (s - s_i) / (s_j - s_i)``, i != j."""
    return tuple(tuple(Fraction(term, divisor) for term in terms) for terms, divisor in _whole(nodes))


def _weights(nodes: Sequence[int], moments: list[int], scale: int) -> list[float]:
    """Return the weights of polynomials whose powers have these ``moments`` / ``scale``, quotients of whole numbers."""
    return [
        sum(c * m for c, m in zip(terms, moments, strict=True)) / (scale * divisor) for terms, divisor in _whole(tuple(nodes))
    ]


def velocity_weights(nodes: Sequence[int], start: int, end: int) -> list[float]:
    """Return the weights, in steps, of accelerations at ``nodes`` in the change of velocity from ``start`` to ``end``.

    ``v(end) - v(start) = h sum_j w_j a_j`` with ``w_j = int_start^end l_j(s) ds`` and the step h, s.
    """
    scale = lcm(*range(1, len(nodes) + 1))
    return _weights(nodes, [scale // k * (end**k - start**k) for k in range(1, len(nodes) + 1)], scale)


def position_weights(nodes: Sequence[int], start: int, end: int) -> list[float]:
    """Return the weights, in steps squared, of accelerations at ``nodes`` in the change of position from ``start`` to ``end``.

    ``r(end) = r(start) + h (end - start) v(start) + h^2 sum_j w_j a_j`` with ``w_j = int_start^end (end - s) l_j(s) ds``.
    """
    scale = lcm(*range(1, len(nodes) + 2))
    powers = [scale // k * (end**k - start**k) for k in range(1, len(nodes) + 2)]  # integrals of s^(k - 1), times the scale
    return _weights(nodes, [end * one - more for one, more in pairwise(powers)], scale)
