"""Exponential atmosphere, as in Basilisk's module exponentialAtmosphere."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.vec3 import Scalar, Vec3

__all__ = ["exponential_density", "top_radius"]

NEGLIGIBLE_DENSITY = 1e-20
"""Density, kg/m^3, below which drag moves a spacecraft by less than a micrometer in five orbits."""


def exponential_density(r: Vec3, radius: Scalar, base: Scalar, scale_height: Scalar) -> Tensor:
    """Return the density, kg/m^3, at the position r, m, relative to the Earth's center, in any axes.

    ``rho = rho_0 exp(-(|r| - r_0) / H)`` with ``radius`` r_0, m, at which the density is ``base`` rho_0, kg/m^3, and the
    ``scale_height`` H, m (Vallado, section 8.6.2, with one layer).
    """
    return base * torch.exp(-(r.norm() - radius) / scale_height)


def top_radius(radius: float, base: float, scale_height: float) -> float:
    """Return the radius, m, above which the density is less than :data:`NEGLIGIBLE_DENSITY` rho_n; 0 where it always is.

    ``r = r_0 + H ln(rho_0 / rho_n)``, the inverse of :func:`exponential_density`.
    """
    if base <= NEGLIGIBLE_DENSITY:
        return 0.0
    return radius + scale_height * math.log(base / NEGLIGIBLE_DENSITY)
