"""Gravity: the Earth's spherical harmonics and the Sun as third body.

The field is the Cunningham recursion in the form of Montenbruck and Gill, "Satellite Orbits", section 3.2.4, written on
separate tensors so that it fuses. Coefficients are GGM03S; the gravitational parameter and the radius are those of Basilisk's
body factory, which overrides the ones of the file.
"""

from __future__ import annotations

import functools
import importlib.resources
import math
import operator
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from bsk_torch.constants import MU_EARTH, MU_SUN, R_EARTH
from bsk_torch.vec3 import Vec3

__all__ = ["Weights", "field", "field_weights", "third_body"]

DEGREE = 10
"""Degree and order of the Earth's field."""


class Weights(NamedTuple):
    """Coefficients of one pair of Cunningham functions V, W in the acceleration, for each axis, in units of mu/R^2."""

    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]


def _unnormalised(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients C and S of GGM03S without normalization, up to ``degree``.

    ``C_nm = sqrt((2 - d_0m) (2 n + 1) (n - m)! / (n + m)!) Cbar_nm`` and S likewise (Montenbruck and Gill, section 3.2).
    """
    path = importlib.resources.files("bsk_torch.astro") / "tables" / "ggm03s_degree10.csv"
    with path.open() as file:
        lines = [line for line in file if line[0].isdigit()]
    c, s = np.zeros((degree + 1, degree + 1)), np.zeros((degree + 1, degree + 1))
    for line in lines:
        degree_text, order_text, c_nm, s_nm = line.split(",")
        n, m = int(degree_text), int(order_text)
        if n <= degree:
            factor = math.sqrt((2 - (m == 0)) * (2 * n + 1) * math.factorial(n - m) / math.factorial(n + m))
            c[n, m], s[n, m] = float(c_nm) * factor, float(s_nm) * factor
    return c, s


@functools.lru_cache
def field_weights(degree: int) -> dict[tuple[int, int], Weights]:
    """Return the weights of V[n, m] and W[n, m] in the acceleration, for a field of ``degree`` and order.

    Degree 0 is the point mass. In units of mu/R^2 the acceleration of the term n, m is (Montenbruck and Gill, section 3.2.5,
    equation 3.33), for m = 0::

        x: -C_n0 V_n+1,1        y: -C_n0 W_n+1,1        z: -(n + 1) C_n0 V_n+1,0

    and for m > 0, with ``p = (n - m + 1) (n - m + 2)``::

        x: 1/2 [-C V_n+1,m+1 - S W_n+1,m+1 + p (C V_n+1,m-1 + S W_n+1,m-1)]
        y: 1/2 [-C W_n+1,m+1 + S V_n+1,m+1 + p (-C W_n+1,m-1 + S V_n+1,m-1)]
        z: (n - m + 1) (-C V_n+1,m - S W_n+1,m)

    so that each V and W gets one weight per axis, summed over all terms.
    """
    c, s = _unnormalised(degree)
    c[0, 0] = 1.0
    sums = {(n, m): np.zeros((3, 2)) for n in range(1, degree + 2) for m in range(n + 1)}
    for n in range(degree + 1):
        for m in range(n + 1):
            cs = np.array([c[n, m], s[n, m]])
            swapped = np.array([s[n, m], -c[n, m]])
            down = (n - m + 1) * (n - m + 2)
            half = 0.5 if m else 1.0
            sums[n + 1, m + 1][0] -= half * cs
            sums[n + 1, m + 1][1] += half * swapped
            sums[n + 1, m][2] -= (n - m + 1) * cs
            if m:
                sums[n + 1, m - 1][0] += half * down * cs
                sums[n + 1, m - 1][1] += half * down * swapped
    return {key: Weights(*((float(a), float(b)) for a, b in value)) for key, value in sums.items() if value.any()}


J2 = -float(_unnormalised(2)[0][2, 0])
"""The Earth's oblateness."""


def _total(terms: list[Tensor]) -> Tensor:
    """Return the sum, smallest terms (the last) first, which rounds least."""
    return functools.reduce(operator.add, reversed(terms))


def _column(m: int, order: int, z: Tensor, rho: Tensor) -> list[Tensor]:
    """Return the factors P[n, m] that V[n, m] and W[n, m] have in common, for n = m to ``order``, without that of P[m, m].

    ``P_n = ((2 n - 1) z P_n-1 - (n + m - 1) rho P_n-2) / (n - m)`` with ``P_m = 1`` and ``P_m-1 = 0``, where z stands for
    ``z R / r^2`` and rho for ``R^2 / r^2`` (Montenbruck and Gill, section 3.2.4, equation 3.30).
    """
    column: list[Any] = [1.0, (2.0 * m + 1.0) * z]
    for n in range(m + 2, order + 1):
        a, b = (2 * n - 1) / (n - m), (n + m - 1) / (n - m)
        column.append(a * z * column[-1] - b * rho * column[-2])
    return column[: order - m + 1]


def _sums(m: int, column: list[Any], weights: Mapping[tuple[int, int], Weights]) -> list[tuple[Any, Any]]:
    """Return, for each axis, the sums over n of the weights of V and of W times the column; None if all weights are zero."""
    scale = float(math.prod(range(1, 2 * m, 2)))
    pairs = []
    for axis in range(3):
        parts = []
        for part in range(2):
            terms = [
                weights[m + k, m][axis][part] * scale * value
                for k, value in enumerate(column)
                if (m + k, m) in weights and weights[m + k, m][axis][part] != 0.0
            ]
            parts.append(_total(terms) if terms else None)
        pairs.append((parts[0], parts[1]))
    return pairs


def field(r: Vec3, weights: Mapping[tuple[int, int], Weights]) -> Vec3:
    """Return the acceleration, m/s^2, by the Earth's field at the Earth-fixed position r, m (both in P axes).

    ``a = (mu / R^2) sum_nm (v_nm V_nm + w_nm W_nm)`` with the weights v and w of :func:`field_weights` and the functions
    ``V_nm + i W_nm = P_nm(z R / r^2, R^2 / r^2) (x + i y)^m (R / r^2)^m R / r``. The polynomial P, with the factor (2 m - 1)!!,
    serves both, so the sums over n come first.
    """
    order = max(n for n, _ in weights)
    inverse_r2 = 1.0 / r.dot(r)
    scaled, rho = r * (R_EARTH * inverse_r2), R_EARTH * R_EARTH * inverse_r2
    cosine, sine = torch.ones_like(r.x), torch.zeros_like(r.x)
    axes: tuple[list[Any], ...] = ([], [], [])
    for m in range(order + 1):
        if m:
            cosine, sine = scaled.x * cosine - scaled.y * sine, scaled.x * sine + scaled.y * cosine
        for axis, sums in zip(axes, _sums(m, _column(m, order, scaled.z, rho), weights), strict=True):
            axis.extend(total * function for total, function in zip(sums, (cosine, sine), strict=True) if total is not None)
    size = (MU_EARTH / R_EARTH) * inverse_r2.sqrt()
    return Vec3(*(_total(axis) for axis in axes)) * size


def third_body(r: Vec3, r_body: Vec3, mu: float = MU_SUN) -> Vec3:
    """Return the acceleration, m/s^2, by a third body at ``r_body`` s, relative to the Earth's own, at r (m, in common axes).

    ``a = -mu (d / |d|^3 + s / |s|^3)`` with ``d = r - s``. The difference of two nearly equal terms is formed as in Battin, "An
    Introduction to the Mathematics and Methods of Astrodynamics", section 8.6, which keeps its digits::

        a = -(mu / |d|^3) (r + f s),  f = q (3 + 3 q + q^2) / (1 + (1 + q)^(3/2)),  q = r . (r - 2 s) / |s|^2
    """
    body2 = r_body.dot(r_body)
    q = (r.dot(r) - 2.0 * r.dot(r_body)) / body2
    f = q * (3.0 + q * (3.0 + q)) / (1.0 + (1.0 + q) * (1.0 + q).sqrt())
    d = r - r_body
    d2 = d.dot(d)
    return (r + r_body * f) * (-mu / (d2 * d2.sqrt()))
