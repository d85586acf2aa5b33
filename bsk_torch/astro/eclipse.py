"""How much of the Sun a spacecraft sees past the Earth."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.constants import R_EARTH, R_SUN
from bsk_torch.vec3 import Vec3


def _in_shadow_cones(r: Vec3, r_sun: Vec3) -> Tensor:
    """Whether r lies inside the penumbral or umbral cone of the spherical Earth (Vallado, section 5.3)."""
    sun2 = r_sun.dot(r_sun)
    sun = sun2.sqrt()
    along = -r.dot(r_sun) / sun
    across = torch.sqrt(torch.clamp(r.dot(r) - along * along, min=0.0))
    sin_penumbra, sin_umbra = (R_SUN + R_EARTH) / sun, (R_SUN - R_EARTH) / sun
    # l = c tan(f) with c = along +- R / sin(f)
    penumbra = (along * sin_penumbra + R_EARTH) / torch.sqrt(1.0 - sin_penumbra * sin_penumbra)
    umbra = (along * sin_umbra - R_EARTH) / torch.sqrt(1.0 - sin_umbra * sin_umbra)
    return (across < torch.abs(penumbra)) | (across < torch.abs(umbra))


def visible_fraction(sun_radius: Tensor, planet_radius: Tensor, separation: Tensor) -> Tensor:
    """Fraction of a disc of apparent radius ``sun_radius`` that another, larger or smaller, disc leaves visible (all rad).

    Source: Montenbruck and Gill, "Satellite Orbits", section 3.4.2.
    """
    a, b, c = sun_radius, planet_radius, torch.clamp(separation, min=1e-12)
    x = torch.clamp((c * c + a * a - b * b) / (2.0 * c), min=-a, max=a)
    y = torch.sqrt(torch.clamp(a * a - x * x, min=0.0))
    overlap = a * a * torch.acos(x / a) + b * b * torch.acos(torch.clamp((c - x) / b, -1.0, 1.0)) - c * y
    disc = math.pi * a * a
    partial = torch.where(c < a + b, 1.0 - overlap / disc, torch.ones_like(c))
    annular = torch.where(separation < a - b, (b * b) / (a * a), partial)
    return torch.where(separation < b - a, torch.zeros_like(c), annular)


def illumination(r: Vec3, r_sun: Vec3) -> Tensor:
    """Illuminated fraction of the solar disc, 1 in full light and 0 in the umbra.

    Args:
        r: Spacecraft position relative to the Earth's centre, m.
        r_sun: Sun position relative to the Earth's centre, m, in the same axes.

    As in Basilisk, the discs are compared only inside the shadow cones of a spherical Earth, and an annular eclipse gives
    the hidden instead of the visible fraction.
    """
    to_sun = r_sun - r
    distance = to_sun.norm()
    radius = r.norm()
    sun_radius = torch.asin(torch.clamp(R_SUN / distance, max=1.0))
    planet_radius = torch.asin(torch.clamp(R_EARTH / radius, max=1.0))
    separation = torch.acos(torch.clamp(-r.dot(to_sun) / (radius * distance), -1.0, 1.0))
    fraction = visible_fraction(sun_radius, planet_radius, separation)
    dark_side = (to_sun.dot(to_sun) >= r_sun.dot(r_sun)) & _in_shadow_cones(r, r_sun)
    return torch.where(dark_side, fraction, torch.ones_like(fraction))
