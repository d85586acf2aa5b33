"""Places on the WGS84 ellipsoid: latitude, longitude and height, and the local vertical."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from bsk_torch.vec3 import Vec3

SEMI_MAJOR_AXIS = 6378137.0  # m
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
SEMI_MINOR_AXIS = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
"""The ellipsoid of WGS84 (NGA.STND.0036, table 3.1)."""

Vertical = Literal["radius", "wgs84"]
"""Direction from which the elevation over a place is counted: from the Earth's center, or normal to the ellipsoid of WGS84."""

LARGEST_DEFLECTION = 3.4e-3
"""Bound of the angle between the two verticals, rad: 0.19 degrees at a latitude of 45 degrees."""


def geodetic_to_fixed(latitude: Tensor, longitude: Tensor, height: Tensor) -> Tensor:
    """Return the Earth-fixed position [..., 3], m, of geodetic latitude and longitude, rad, and height, m.

    With ``N = a / sqrt(1 - e^2 sin^2 lat)``, the position is
    ``((N + h) cos lat cos lon, (N + h) cos lat sin lon, (N (1 - e^2) + h) sin lat)`` (Vallado, section 3.2).
    """
    sine, cosine = torch.sin(latitude), torch.cos(latitude)
    N = SEMI_MAJOR_AXIS / torch.sqrt(1.0 - ECCENTRICITY2 * sine * sine)
    x, y = ((N + height) * cosine * f(longitude) for f in (torch.cos, torch.sin))
    return torch.stack(torch.broadcast_tensors(x, y, (N * (1.0 - ECCENTRICITY2) + height) * sine), -1)


def _normal(r_P: Vec3) -> tuple[Tensor, Tensor]:
    """Return multiples of sine and cosine of the geodetic latitude, by one step of Bowring's iteration.

    ``tan lat = (z + e'^2 b sin^3 beta) / (p - e^2 a cos^3 beta)`` with ``tan beta = a z / (b p)`` (Bowring, Survey Review 181,
    1976). The latitude is wrong by less than 1e-11 rad up to 10 km above the ellipsoid, and by 1e-8 rad in orbit.
    """
    p = torch.sqrt(r_P.x * r_P.x + r_P.y * r_P.y)
    up, out = SEMI_MAJOR_AXIS * r_P.z, SEMI_MINOR_AXIS * p
    length = torch.sqrt(up * up + out * out)
    sine, cosine = up / length, out / length
    second = ECCENTRICITY2 / (1.0 - ECCENTRICITY2) * SEMI_MINOR_AXIS
    return r_P.z + second * sine * sine * sine, p - ECCENTRICITY2 * SEMI_MAJOR_AXIS * cosine * cosine * cosine


def fixed_to_geodetic(r_P: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return geodetic latitude and longitude, rad, and height, m, of the Earth-fixed position [..., 3], m.

    The height is ``p cos lat + z sin lat - a sqrt(1 - e^2 sin^2 lat)``, which holds at the poles, too.
    """
    place = Vec3.of(r_P)
    latitude = torch.atan2(*_normal(place))
    sine = torch.sin(latitude)
    p = torch.hypot(place.x, place.y)
    height = p * torch.cos(latitude) + place.z * sine - SEMI_MAJOR_AXIS * torch.sqrt(1.0 - ECCENTRICITY2 * sine * sine)
    return latitude, torch.atan2(place.y, place.x), height


def axis_shift(r_P: Vec3) -> Tensor:
    """Return the distance along the Earth's axis, m, by which a place is shifted to lie on the local vertical through the center.

    The normal of the ellipsoid through the place meets the axis at ``z = -e^2 N sin lat``, so ``r + e^2 N sin lat z^`` is
    parallel to the vertical. Elevations over places on a sphere hold for the ellipsoid if both ends are shifted.
    """
    up, out = _normal(r_P)
    sine = up / torch.sqrt(up * up + out * out)
    return ECCENTRICITY2 * SEMI_MAJOR_AXIS * sine / torch.sqrt(1.0 - ECCENTRICITY2 * sine * sine)


def vertical_of(r_P: Vec3, vertical: Vertical) -> Vec3:
    """Return vectors along the vertical at Earth-fixed positions, m, as long as the normal down to the Earth's axis."""
    return Vec3(r_P.x, r_P.y, r_P.z + axis_shift(r_P)) if vertical == "wgs84" else r_P


def local_vertical(r_P: Tensor) -> Tensor:
    """Return the unit vectors [..., 3] normal to the ellipsoid of WGS84 at Earth-fixed positions [..., 3], m."""
    latitude, longitude, _ = fixed_to_geodetic(r_P)
    cosine = torch.cos(latitude)
    return torch.stack([cosine * torch.cos(longitude), cosine * torch.sin(longitude), torch.sin(latitude)], -1)
