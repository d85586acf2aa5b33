"""Weights of a multistep method for orbits: accelerations at equal steps, integrated twice.

The method is Falkner's (Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", section III.10): position and
velocity at the last node, and the polynomial through the last accelerations. The first accelerations are found by iterating the
same integrals over a block of nodes. Weights are exact fractions, rounded once.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cache


@cache
def lagrange(nodes: tuple[int, ...]) -> tuple[tuple[Fraction, ...], ...]:
    """Return the coefficients, constant term first, of Lagrange's ``l_j(s) = prod_i (s - s_i) / (s_j - s_i)``, i != j."""
    polynomials = []
    for node in nodes:
        terms = [Fraction(1)]
        for other in nodes:
            if other != node:
                scale = Fraction(1, node - other)
                shifted, scaled = [Fraction(0), *terms], [*terms, Fraction(0)]
                terms = [(a - other * b) * scale for a, b in zip(shifted, scaled, strict=True)]
        polynomials.append(tuple(terms))
    return tuple(polynomials)


def velocity_weights(nodes: Sequence[int], start: int, end: int) -> list[float]:
    """Return the weights, in steps, of accelerations at ``nodes`` in the change of velocity from ``start`` to ``end``.

    ``v(end) - v(start) = h sum_j w_j a_j`` with ``w_j = int_start^end l_j(s) ds`` and the step h, s.
    """
    return [
        float(sum(c * Fraction(end ** (k + 1) - start ** (k + 1), k + 1) for k, c in enumerate(terms)))
        for terms in lagrange(tuple(nodes))
    ]


def position_weights(nodes: Sequence[int], start: int, end: int) -> list[float]:
    """Return the weights, in steps squared, of accelerations at ``nodes`` in the change of position from ``start`` to ``end``.

    ``r(end) = r(start) + h (end - start) v(start) + h^2 sum_j w_j a_j`` with ``w_j = int_start^end (end - s) l_j(s) ds``.
    """

    def moment(k: int) -> Fraction:
        """Integral of (end - s) s^k from start to end."""
        constant = Fraction(end ** (k + 1) - start ** (k + 1), k + 1) * end
        return constant - Fraction(end ** (k + 2) - start ** (k + 2), k + 2)

    moments = [moment(k) for k in range(len(nodes))]
    return [float(sum(c * m for c, m in zip(terms, moments, strict=True))) for terms in lagrange(tuple(nodes))]
