"""Exponential atmosphere."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.vec3 import Scalar, Vec3

NEGLIGIBLE_DENSITY = 1e-20
"""Density, kg/m^3, below which drag moves a spacecraft by less than a micrometre in five orbits."""


def exponential_density(r: Vec3, radius: Scalar, base: Scalar, scale_height: Scalar) -> Tensor:
    """Density, kg/m^3, at r, m: ``base * exp(-(|r| - radius) / scale_height)``."""
    return base * torch.exp(-(r.norm() - radius) / scale_height)


def top_radius(radius: float, base: float, scale_height: float) -> float:
    """Radius, m, above which the density is negligible."""
    if base <= NEGLIGIBLE_DENSITY:
        return 0.0
    return radius + scale_height * math.log(base / NEGLIGIBLE_DENSITY)
