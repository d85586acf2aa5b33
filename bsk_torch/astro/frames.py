"""Earth-fixed points and what sees them."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.constants import R_EARTH
from bsk_torch.vec3 import Vec3


def lla_to_fixed(latitude: Tensor, longitude: Tensor, altitude: Tensor, radius: Tensor | float = R_EARTH) -> Tensor:
    """Earth-fixed position [..., 3], m, of latitude and longitude in rad and altitude in m above a sphere."""
    c = torch.cos(latitude)
    unit = torch.stack([c * torch.cos(longitude), c * torch.sin(longitude), torch.sin(latitude)], -1)
    return unit * torch.as_tensor(radius + altitude).unsqueeze(-1)


def fixed_to_lla(r_P: Tensor, radius: float = R_EARTH) -> tuple[Tensor, Tensor, Tensor]:
    """Latitude and longitude, rad, and altitude, m, above a sphere of the Earth-fixed position [..., 3], m."""
    distance = r_P.norm(dim=-1)
    return torch.asin(r_P[..., 2] / distance), torch.atan2(r_P[..., 1], r_P[..., 0]), distance - radius


def sin_elevation(r: Vec3, r_site: Vec3) -> Tensor:
    """Sine of the elevation of r above the plane normal to r_site (any common frame, m)."""
    d = r - r_site
    return r_site.dot(d) / torch.sqrt(r_site.dot(r_site) * d.dot(d))


def rotate_z(r: Vec3, cos: Tensor, sin: Tensor) -> Vec3:
    """Components of r in axes turned about z by the angle with this cosine and sine."""
    return Vec3(cos * r.x + sin * r.y, cos * r.y - sin * r.x, r.z)


def angle_between(a: Vec3 | Tensor, b: Vec3 | Tensor) -> Tensor:
    """Angle, rad in [0, pi], between vectors (or tensors [..., 3]), accurate for small and for large angles."""
    a, b = ((Vec3.of(x) if isinstance(x, Tensor) else x).unit() for x in (a, b))
    near, far = (2.0 * torch.asin(torch.clamp(0.5 * chord.norm(), max=1.0)) for chord in (a - b, a + b))
    return torch.where(a.dot(b) > 0.0, near, math.pi - far)
