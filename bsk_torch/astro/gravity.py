"""Gravity: the Earth's spherical harmonics and the Sun as third body.

The field is the Cunningham recursion in the form of Montenbruck and Gill, "Satellite Orbits", section 3.2.4, written on
separate tensors so that it fuses. Coefficients are GGM03S; the gravitational parameter and the radius are those of Basilisk's
body factory, which overrides the ones of the file.
"""

from __future__ import annotations

import functools
import importlib.resources
import math
from typing import NamedTuple

import numpy as np
from torch import Tensor

from bsk_torch.constants import MU_EARTH, MU_SUN, R_EARTH
from bsk_torch.vec3 import Vec3

DEGREE = 10
"""Degree and order of the Earth's field in bsk_rl."""


class Weights(NamedTuple):
    """What one pair of Cunningham functions V, W adds to the acceleration, per axis, in units of mu/R^2."""

    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]


def _unnormalised(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients C and S of GGM03S without normalisation, up to ``degree``."""
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
    """Weights of V[n, m] and W[n, m] in the acceleration, for a field of ``degree`` (0: point mass, 2: J2 and order 2)."""
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


def zonal_weights() -> dict[tuple[int, int], Weights]:
    """Weights of the point mass and J2 alone: a field that does not depend on the Earth's rotation angle."""
    two = field_weights(2)
    j2 = -float(_unnormalised(2)[0][2, 0])
    return {
        (1, 1): two[1, 1],
        (1, 0): two[1, 0],
        (3, 1): Weights((j2, 0.0), (0.0, j2), (0.0, 0.0)),
        (3, 0): Weights((0.0, 0.0), (0.0, 0.0), (3.0 * j2, 0.0)),
    }


def _cunningham(r: Vec3, order: int, zonal: bool) -> dict[tuple[int, int], tuple[Tensor, Tensor | float]]:
    """Cunningham functions V[n, m] and W[n, m] at the Earth-fixed position r, up to ``order`` (m at most 1 if zonal)."""
    inverse_r2 = 1.0 / r.dot(r)
    scaled = r * (R_EARTH * inverse_r2)
    rho = R_EARTH * R_EARTH * inverse_r2
    vw: dict[tuple[int, int], tuple[Tensor, Tensor | float]] = {(0, 0): (R_EARTH * inverse_r2.sqrt(), 0.0)}
    for m in range((1 if zonal else order) + 1):
        if m:
            v, w = vw[m - 1, m - 1]
            k = float(2 * m - 1)
            vw[m, m] = (k * (scaled.x * v - scaled.y * w), k * (scaled.x * w + scaled.y * v))
        for n in range(m + 1, order + 1):
            a, b = (2 * n - 1) / (n - m), (n + m - 1) / (n - m)
            v, w = vw[n - 1, m]
            if n == m + 1:
                vw[n, m] = (a * scaled.z * v, a * scaled.z * w if m else 0.0)
                continue
            v2, w2 = vw[n - 2, m]
            vw[n, m] = (a * scaled.z * v - b * rho * v2, (a * scaled.z * w - b * rho * w2) if m else 0.0)
    return vw


def _total(terms: list[Tensor]) -> Tensor:
    """Sum, smallest terms first."""
    total = terms[-1]
    for term in terms[-2::-1]:
        total = total + term
    return total


def field(r: Vec3, weights: dict[tuple[int, int], Weights]) -> Vec3:
    """Acceleration, m/s^2, of the Earth's field at the Earth-fixed position r, m (both in P axes)."""
    order = max(n for n, _ in weights)
    functions = _cunningham(r, order, zonal=max(m for _, m in weights) <= 1)
    axes: tuple[list[Tensor], ...] = ([], [], [])
    for key, weight in weights.items():
        for axis, (a, b) in zip(axes, weight, strict=True):
            v, w = functions[key]
            axis.extend(k * f for k, f in ((a, v), (b, w)) if k != 0.0 and isinstance(f, Tensor))
    return Vec3(*(_total(axis) for axis in axes)) * (MU_EARTH / R_EARTH**2)


def third_body(r: Vec3, r_body: Vec3, mu: float = MU_SUN) -> Vec3:
    """Acceleration, m/s^2, by a third body at r_body relative to the Earth's own (any common frame, m).

    The difference of two nearly equal terms is formed as in Battin, "An Introduction to the Mathematics and Methods of
    Astrodynamics", section 8.6, which keeps its digits.
    """
    body2 = r_body.dot(r_body)
    q = (r.dot(r) - 2.0 * r.dot(r_body)) / body2
    f = q * (3.0 + q * (3.0 + q)) / (1.0 + (1.0 + q) * (1.0 + q).sqrt())
    d = r - r_body
    d2 = d.dot(d)
    return (r + r_body * f) * (-mu / (d2 * d2.sqrt()))
