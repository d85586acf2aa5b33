"""Earth-fixed positions, elevations and angles."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.constants import R_EARTH
from bsk_torch.vec3 import Vec3

__all__ = ["angle_between", "fixed_to_lla", "lla_to_fixed", "rotate_z", "sin_elevation"]


def lla_to_fixed(latitude: Tensor, longitude: Tensor, altitude: Tensor, radius: Tensor | float = R_EARTH) -> Tensor:
    """Return the Earth-fixed position [..., 3], m, of latitude and longitude, rad, and altitude, m, above a sphere.

    ``r_P = (R + h) (cos lat cos lon, cos lat sin lon, sin lat)`` with the ``radius`` R, m (Basilisk's groundLocation).
    """
    c = torch.cos(latitude)
    unit = torch.stack([c * torch.cos(longitude), c * torch.sin(longitude), torch.sin(latitude)], -1)
    return unit * torch.as_tensor(radius + altitude).unsqueeze(-1)


def fixed_to_lla(r_P: Tensor, radius: float = R_EARTH) -> tuple[Tensor, Tensor, Tensor]:
    """Return latitude and longitude, rad, and altitude, m, above a sphere of the Earth-fixed position [..., 3], m.

    ``lat = asin(z / |r_P|)``, ``lon = atan2(y, x)``, ``h = |r_P| - R``: the inverse of :func:`lla_to_fixed`.
    """
    distance = r_P.norm(dim=-1)
    return torch.asin(r_P[..., 2] / distance), torch.atan2(r_P[..., 1], r_P[..., 0]), distance - radius


def sin_elevation(r: Vec3, r_site: Vec3, vertical: Vec3 | None = None) -> Tensor:
    """Return the sine of the elevation of r above the horizon of r_site, positions in m in common axes.

    ``sin(el) = v . d / (|v| |d|)`` with ``d = r - r_site``; the horizon is the plane normal to the vertical v, of any length;
    r_site if None.
    """
    d, v = r - r_site, r_site if vertical is None else vertical
    return v.dot(d) / torch.sqrt(v.dot(v) * d.dot(d))


def rotate_z(r: Vec3, cos: Tensor, sin: Tensor) -> Vec3:
    """Return the components of r in axes turned about z by the angle with this cosine and sine: ``R3(angle) r``.

    ``R3 = [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]`` (Vallado, chapter 3).
    """
    return Vec3(cos * r.x + sin * r.y, cos * r.y - sin * r.x, r.z)


def angle_between(a: Vec3 | Tensor, b: Vec3 | Tensor) -> Tensor:
    """Return the angle, rad in [0, pi], between vectors (or tensors [..., 3]), accurate for small and for large angles.

    ``2 asin(|a^ - b^| / 2)`` below a right angle and ``pi - 2 asin(|a^ + b^| / 2)`` above, by the chords of the unit circle: acos
    of the scalar product loses half of the digits near 0 and pi.
    """
    if isinstance(a, Tensor) and isinstance(b, Tensor):  # in fewer operations than by component
        one, other = (x / torch.linalg.vector_norm(x, dim=-1, keepdim=True) for x in (a, b))
        chords = torch.linalg.vector_norm(torch.stack([one - other, one + other]), dim=-1)
        near, far = (2.0 * torch.asin(torch.clamp(0.5 * chords, max=1.0))).unbind(0)
        return torch.where((one * other).sum(-1) > 0.0, near, math.pi - far)
    a, b = ((x if isinstance(x, Vec3) else Vec3.of(x)).unit() for x in (a, b))
    near, far = (2.0 * torch.asin(torch.clamp(0.5 * chord.norm(), max=1.0)) for chord in (a - b, a + b))
    return torch.where(a.dot(b) > 0.0, near, math.pi - far)
