"""Illumination of a spacecraft that the Earth shades: Basilisk's module eclipse, with a spherical Earth.

Source of the equations: Montenbruck and Gill, "Satellite Orbits", section 3.4.2, and Vallado, section 5.3. Positions are relative
to the Earth's center, m, in common axes.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.constants import R_EARTH, R_SUN
from bsk_torch.vec3 import Vec3, only

__all__ = ["illumination", "in_umbra", "sunlight_margin", "umbra_depth", "visible_fraction"]

EDGE = 1e-3
"""Margin, as part of the square of its radius, around the edge of a shadow cone in which illumination is computed."""

TIP = 0.01
"""Radius of the umbra, as part of the Earth's, below which the same holds, as small angles leave few digits there."""


def _in_shadow_cones(r: Vec3, r_sun: Vec3) -> Tensor:
    """Return whether r lies inside the penumbral or the umbral cone of the spherical Earth (Vallado, section 5.3).

    With ``s0 = -r . r_S / |r_S|`` along and ``l`` across the axis of the shadow, ``l < |l1|`` or ``l < |l2|`` where
    ``l1 = (s0 + R / sin f1) tan f1``, ``sin f1 = (R_sun + R) / |r_S|``, and ``l2 = (s0 - R / sin f2) tan f2``,
    ``sin f2 = (R_sun - R) / |r_S|``.
    """
    sun2 = r_sun.dot(r_sun)
    sun = sun2.sqrt()
    along = -r.dot(r_sun) / sun
    across = torch.sqrt(torch.clamp(r.dot(r) - along * along, min=0.0))
    sin_penumbra, sin_umbra = (R_SUN + R_EARTH) / sun, (R_SUN - R_EARTH) / sun
    # (s0 +- R / sin f) tan f = (s0 sin f +- R) / cos f, without the division by a small sine
    penumbra = (along * sin_penumbra + R_EARTH) / torch.sqrt(1.0 - sin_penumbra * sin_penumbra)
    umbra = (along * sin_umbra - R_EARTH) / torch.sqrt(1.0 - sin_umbra * sin_umbra)
    return (across < torch.abs(penumbra)) | (across < torch.abs(umbra))


def visible_fraction(sun_radius: Tensor, planet_radius: Tensor, separation: Tensor) -> Tensor:
    """Return the fraction of the Sun's disc that the planet's leaves visible; an annular eclipse gives the hidden fraction.

    With the apparent radii a of the Sun and b of the planet and the separation c of their centers, rad::

        c < b - a                  0
        c < a - b                  b^2 / a^2
        c < a + b                  1 - A / (pi a^2),  A = a^2 acos(x / a) + b^2 acos((c - x) / b) - c y,
                                   x = (c^2 + a^2 - b^2) / (2 c),  y = sqrt(a^2 - x^2)
        otherwise                  1

    Source: Montenbruck and Gill, "Satellite Orbits", section 3.4.2, but for the second line, which is Basilisk's: it would be
    ``1 - b^2 / a^2``.
    """
    a, b, c = sun_radius, planet_radius, torch.clamp(separation, min=1e-12)
    x = torch.clamp((c * c + a * a - b * b) / (2.0 * c), min=-a, max=a)
    y = torch.sqrt(torch.clamp(a * a - x * x, min=0.0))
    overlap = a * a * torch.acos(x / a) + b * b * torch.acos(torch.clamp((c - x) / b, -1.0, 1.0)) - c * y
    disc = math.pi * a * a
    partial = torch.where(c < a + b, 1.0 - overlap / disc, torch.ones_like(c))
    annular = torch.where(separation < a - b, (b * b) / (a * a), partial)
    return torch.where(separation < b - a, torch.zeros_like(c), annular)


def in_umbra(r: Vec3, r_sun: Vec3) -> Tensor:
    """Return whether the Earth hides the whole Sun at r, so that :func:`illumination` is zero."""
    to_sun = r_sun - r
    return (to_sun.dot(to_sun) >= r_sun.dot(r_sun)) & _hidden(r, to_sun)[0]


def umbra_depth(r: Vec3, r_sun: Vec3) -> Tensor:
    """Return a number that is positive :func:`in_umbra`, and smooth where its sign changes: ``cos c - cos(b - a)``.

    The angles are those of :func:`visible_fraction`; positions as for :func:`illumination`.
    """
    to_sun = r_sun - r
    covers, sin_sun, sin_planet, cosine = _hidden(r, to_sun)
    cos_sun, cos_planet = torch.sqrt(1.0 - sin_sun * sin_sun), torch.sqrt(1.0 - sin_planet * sin_planet)
    depth = torch.abs(cosine - (cos_sun * cos_planet + sin_sun * sin_planet))
    return torch.where((to_sun.dot(to_sun) >= r_sun.dot(r_sun)) & covers, depth, -depth)


def _hidden(r: Vec3, to_sun: Vec3) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return whether the planet's disc covers the Sun's; sines of their apparent radii, and the cosine of their separation.

    ``sin a = R_sun / |r_S - r|``, ``sin b = R / |r|``, ``cos c = -r . (r_S - r) / (|r| |r_S - r|)``. The disc is covered where
    ``c < b - a``, that is ``cos c > cos(b - a)`` and ``b > a``, without inverse functions.
    """
    distance, radius = to_sun.norm(), r.norm()
    sin_sun, sin_planet = torch.clamp(R_SUN / distance, max=1.0), torch.clamp(R_EARTH / radius, max=1.0)
    cos_sun, cos_planet = torch.sqrt(1.0 - sin_sun * sin_sun), torch.sqrt(1.0 - sin_planet * sin_planet)
    cosine = -r.dot(to_sun) / (radius * distance)
    covers = (cosine > cos_sun * cos_planet + sin_sun * sin_planet) & (sin_planet > sin_sun)
    return covers, sin_sun, sin_planet, cosine


def sunlight_margin(r: Vec3, r_sun: Vec3, visible: float) -> Tensor:
    """Return a smooth measure that is positive where at least the part ``visible`` of the Sun's diameter is above the limb at r.

    With the apparent radii a of the Sun and b of the planet and the separation c of their centers, rad::

        cos(b + (2 visible - 1) a) - cos c

    For ``visible`` 0 it is positive outside the umbra (:func:`in_umbra`), for 1 outside the penumbra, at distances from the Earth
    at which the Sun looks smaller than it. Positions as for :func:`illumination`.
    """
    _, sin_sun, sin_planet, cosine = _hidden(r, r_sun - r)
    return torch.cos(torch.asin(sin_planet) + (2.0 * visible - 1.0) * torch.asin(sin_sun)) - cosine


def illumination(r: Vec3, r_sun: Vec3) -> Tensor:
    """Return the illuminated fraction of the solar disc, 1 in full light and 0 in the umbra; see :func:`visible_fraction`.

    Args:
        r: Spacecraft position relative to the Earth's center, m.
        r_sun: Sun position relative to the Earth's center, m, in the same axes.

    As in Basilisk, the discs are compared only inside the shadow cones of a spherical Earth, and an annular eclipse gives
    the hidden instead of the visible fraction.
    """
    to_sun = r_sun - r
    night = to_sun.dot(to_sun) >= r_sun.dot(r_sun)
    light, dark = _clearly(r, r_sun)
    far = torch.where(night & dark, torch.zeros_like(r.x), torch.ones_like(r.x))
    return only(night & ~(light | dark), lambda: _shaded(r, r_sun, to_sun, night), far)


def _clearly(r: Vec3, r_sun: Vec3) -> tuple[Tensor, Tensor]:
    """Return whether r lies clearly outside both shadow cones, and whether clearly in the umbra, on the night side.

    Neither holds within :data:`EDGE` of a cone or near the umbra's tip. The comparisons are those of :func:`_in_shadow_cones`,
    squared, and cost one division instead of six and eight square roots::

        l^2 cos^2 f = (r . r - s0^2) cos^2 f   against   (s0 sin f +- R)^2
    """
    inverse = 1.0 / r_sun.dot(r_sun)
    along = -r.dot(r_sun) * inverse  # s0 / |r_S|
    across2 = r.dot(r) + along * r.dot(r_sun)

    def cone(radius: float) -> tuple[Tensor, Tensor]:
        """Square of the distance from the axis, times cos^2 f, and ``s0 sin f``, with ``sin f = radius / |r_S|``."""
        return across2 * (1.0 - radius * radius * inverse), along * radius

    from_penumbra, widening = cone(R_SUN + R_EARTH)
    from_umbra, narrowing = cone(R_SUN - R_EARTH)
    penumbra, umbra = R_EARTH + widening, R_EARTH - narrowing
    outside, inside = (from_umbra * scale for scale in (1.0 - EDGE, 1.0 + EDGE))
    light = (from_penumbra * (1.0 - EDGE) > penumbra * penumbra) & (outside > umbra * umbra)
    return light, (inside < umbra * umbra) & (umbra > TIP * R_EARTH)


def _shaded(r: Vec3, r_sun: Vec3, to_sun: Vec3, night: Tensor) -> Tensor:
    """Return the illumination on the night side; apparent radii become angles only where the discs' edges cross."""
    hidden, sin_sun, sin_planet, cosine = _hidden(r, to_sun)
    inside = night & _in_shadow_cones(r, r_sun)  # by day the cones have a mirror image

    def fraction() -> Tensor:
        angles = torch.asin(sin_sun), torch.asin(sin_planet), torch.acos(torch.clamp(cosine, -1.0, 1.0))
        return visible_fraction(*angles)

    partial = only(inside & ~hidden, fraction, torch.zeros_like(cosine))
    return torch.where(inside, partial, torch.ones_like(cosine))
