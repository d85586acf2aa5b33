"""Where a satellite points as it takes an image: short of the target, on the side of the previous one.

The flight software takes an image as soon as the pointing error is below its limit. The satellite then still points short of
the target, toward the one that it comes from, so that turning back is quicker than turning further. Where it points depends on
the direction of the previous target on the ground. Directions are counted in *sectors*, so that a path in a graph can remember
them.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def sector_from(before_P: Tensor, at_P: Tensor, sectors: int) -> Tensor:
    """Return the sector in which a place lies as seen from another: 0 is east, and sectors go by north.

    Args:
        before_P: Earth-fixed positions of the places, [..., 3] m.
        at_P: Earth-fixed positions from which they are seen, [..., 3] m.
        sectors: Number of sectors, each centered on its direction.
    """
    east, north = _horizon(at_P)
    away = before_P - at_P
    azimuth = torch.atan2((away * north).sum(-1), (away * east).sum(-1))
    return torch.round(azimuth * (sectors / (2.0 * math.pi))).long() % sectors


def pointing(r_P: Tensor, at_P: Tensor, sector: Tensor, lag: float, sectors: int) -> Tensor:
    """Return the direction in which a satellite points that comes from a sector, [..., 3], of length one.

    Args:
        r_P: Earth-fixed positions of the satellite, [..., 3] m.
        at_P: Earth-fixed positions of the target, [..., 3] m.
        sector: Where it comes from, [...]; ``sectors`` for a satellite that points at the target itself.
        lag: Angle between this direction and the line of sight, rad.
        sectors: Number of sectors.
    """
    east, north = _horizon(at_P)
    azimuth = (sector.double() * (2.0 * math.pi / max(1, sectors))).unsqueeze(-1)
    towards = azimuth.cos() * east + azimuth.sin() * north
    sight = torch.nn.functional.normalize(at_P - r_P, dim=-1)
    aside = torch.nn.functional.normalize(towards - (towards * sight).sum(-1, keepdim=True) * sight, dim=-1)
    off = torch.where(sector < sectors, lag, 0.0).unsqueeze(-1)
    return sight * off.cos() + aside * off.sin()


def _horizon(at_P: Tensor) -> tuple[Tensor, Tensor]:
    """Return the directions of east and north on a sphere, [..., 3] each; at the poles, some directions in the horizon."""
    up = torch.nn.functional.normalize(at_P, dim=-1)
    axis = torch.zeros_like(up)
    axis[..., 2] = 1.0
    east = torch.linalg.cross(axis, up)
    pole = east.norm(dim=-1, keepdim=True) < 1e-9
    other = torch.zeros_like(up)
    other[..., 1] = 1.0
    east = torch.nn.functional.normalize(torch.where(pole, other, east), dim=-1)
    return east, torch.linalg.cross(up, east)
