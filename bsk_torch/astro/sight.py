"""Lines of sight past the Earth: elevations above a place on the ground, and lines between two spacecraft."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.constants import R_EARTH
from bsk_torch.vec3 import Vec3

POLAR_STRETCH = 1.0 / 0.98
"""Factor for lengths along the Earth's axis: the polar radius is set to 0.98 of the equatorial one."""

TINY_LENGTH = 1e-300
"""A positive number, far below the rounding error of positions, which keeps quotients finite and ranges inclusive."""


def elevation_clearance(
    r_BP_P: Vec3, r_LP_P: Vec3, sin_min_elevation: Tensor | float, shift: Tensor | float | None = None
) -> Tensor:
    """Return a measure of how far a satellite B is above the minimum elevation over a place L; positive if it is visible.

    The measure is ``cos(theta) - cos(theta_max)``, with theta the angle at the Earth's center between B and L::

        theta_max = acos(q cos e) - e        cos(theta_max) = q cos^2 e + sin e sqrt(1 - q^2 cos^2 e)

    where e is the minimum elevation and ``q = |r_LP| / |r_BP|`` (law of sines in the triangle center, L, B; Wertz and Larson,
    Space Mission Analysis and Design, section 5.2). Unlike the elevation, it is nearly a sinusoid of time, so the parabola
    through three samples gives the height of a culmination between them.

    Elevations are counted from the place's radius, or from the normal of the ellipsoid if both positions are shifted along the
    Earth's axis, so that the center of the triangle lies on that normal.

    Args:
        r_BP_P: Earth-fixed position of the satellite, m.
        r_LP_P: Earth-fixed position of the place, m.
        sin_min_elevation: Sine of the minimum elevation.
        shift: :func:`bsk_torch.astro.geodetic.axis_shift` of the place, m; None for elevations from the radius.
    """
    if shift is not None:
        r_BP_P, r_LP_P = (Vec3(r.x, r.y, r.z + shift) for r in (r_BP_P, r_LP_P))
    radius, distance = r_LP_P.norm(), r_BP_P.norm()
    q, cos2 = radius / distance, 1.0 - sin_min_elevation * sin_min_elevation
    cos_theta_max = q * cos2 + sin_min_elevation * torch.sqrt(torch.clamp(1.0 - q * q * cos2, min=0.0))
    return r_LP_P.dot(r_BP_P) / (radius * distance) - cos_theta_max


def max_central_angle(radius_ratio: Tensor, sin_min_elevation: Tensor) -> Tensor:
    """Return the angle at the Earth's center, rad, at which a satellite is at the minimum elevation e.

    ``theta_max = acos(q cos e) - e``, see :func:`elevation_clearance`; ``radius_ratio`` is q.
    """
    cosine = torch.sqrt(1.0 - sin_min_elevation * sin_min_elevation)
    return torch.acos(torch.clamp(radius_ratio * cosine, -1.0, 1.0)) - torch.asin(sin_min_elevation)


def stretch(r_BN_N: Vec3, pole: Vec3) -> Vec3:
    """Return the position with its component along the unit vector ``pole`` multiplied by :data:`POLAR_STRETCH`.

    The Earth is an ellipsoid of revolution. Stretching all lengths along its axis turns it into a sphere and keeps lines
    straight, so whether a line of sight is blocked is decided in stretched coordinates.
    """
    return r_BN_N + pole * ((POLAR_STRETCH - 1.0) * r_BN_N.dot(pole))


def line_clearance(p: Vec3, q: Vec3) -> Tensor:
    """Return the distance, m, from the surface of a spherical Earth to the segment between p and q; negative if it is blocked.

    The nearest point of the segment to the Earth's center is ``p + k (q - p)`` with ``k = p . (p - q) / |p - q|^2`` clamped to
    [0, 1]; its squared distance is ``p . p - k (2 p . (p - q) - k |p - q|^2)``. The distance of a segment from a point changes by
    no more than the larger displacement of its ends.
    """
    p2, q2, pq = p.dot(p), q.dot(q), p.dot(q)
    along = p2 - pq
    d2 = along + (q2 - pq)
    k = torch.clamp(along / torch.clamp(d2, min=TINY_LENGTH), 0.0, 1.0)
    return torch.sqrt(torch.clamp(p2 - k * (2.0 * along - k * d2), min=0.0)) - R_EARTH
