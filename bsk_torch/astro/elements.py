"""Orbital elements as an object, and their conversion, for user functions that work on one orbit at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from bsk_torch.astro.orbit import Elements, elements_to_rv, rv_to_elements
from bsk_torch.vec3 import Vec3

__all__ = ["ClassicElements", "elem2rv", "rv2elem"]


@dataclass
class ClassicElements:
    """Classical orbital elements that can be changed, under the names of Basilisk's class; those that are not set are NaN.

    Attributes:
        a: Semi-major axis, m.
        e: Eccentricity.
        i: Inclination, rad.
        Omega: Right ascension of the ascending node, rad.
        omega: Argument of perigee, rad.
        f: True anomaly, rad.
    """

    a: float = math.nan
    e: float = math.nan
    i: float = math.nan
    Omega: float = math.nan
    omega: float = math.nan
    f: float = math.nan

    @property
    def rPeriap(self) -> float:
        """Radius of periapsis, m."""
        return self.a * (1.0 - self.e)

    @property
    def rApoap(self) -> float:
        """Radius of apoapsis, m."""
        return self.a * (1.0 + self.e)

    @property
    def rmag(self) -> float:
        """Present radius, m."""
        return self.a * (1.0 - self.e**2) / (1.0 + self.e * math.cos(self.f))

    @property
    def alpha(self) -> float:
        """Reciprocal of the semi-major axis, 1/m."""
        return 1.0 / self.a


def elem2rv(mu: float, elements: object) -> tuple[np.ndarray, np.ndarray]:
    """Return position [3], m, and velocity [3], m/s, of elements; see :func:`bsk_torch.astro.orbit.elements_to_rv`."""
    numbers = (torch.tensor(float(getattr(elements, name)), dtype=torch.float64) for name in Elements._fields)
    r, v = elements_to_rv(Elements(*numbers), mu)
    return np.array([float(x) for x in r]), np.array([float(x) for x in v])


def rv2elem(mu: float, rVec: object, vVec: object) -> ClassicElements:
    """Return the elements of a bound orbit from position [3], m, and velocity [3], m/s.

    See :func:`bsk_torch.astro.orbit.rv_to_elements`.
    """
    r, v = (Vec3.of(torch.as_tensor(np.asarray(x, dtype=float).reshape(3))) for x in (rVec, vVec))
    return ClassicElements(*(float(x) for x in rv_to_elements(r, v, mu)))
