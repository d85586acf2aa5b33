"""Flags of points on a spacecraft, for tensors and for the values of a kernel alike.

A point is seen by an inspector (has *access*) if the Earth does not stand between them, the inspector is within the point's range
and within a cone about its normal. It is *lit* if the Sun stands within a cone about its normal and the spacecraft is not too
deep in the Earth's shadow. The spacecraft itself hides nothing beyond the cones. This is Basilisk's spacecraftLocation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.sight import line_clearance, stretch
from bsk_torch.vec3 import Vec3

NO_RANGE = 1e200
"""Square of a range, m^2, that no distance exceeds; finite, so that products with it are."""

NO_CONE, NO_SHADE = -4.0, -1.0
"""Bounds below every signed square of a cosine, and below every illumination."""


class Point(NamedTuple):
    """A point on a spacecraft with body axes B, or several: numbers, or tensors of one shape."""

    r_PB_B: Vec3  # position, m
    n_B: Vec3  # unit normal of the surface
    cone: Tensor  # least signed square c |c| of the cosine c of the angle between the normal and the direction of the inspector
    range2: Tensor  # square of the longest distance of the inspector, m^2
    sun: Tensor  # least cosine of the angle between the normal and the direction of the Sun
    light: Tensor  # least illumination of the spacecraft

    @staticmethod
    def of(columns: Tensor | Sequence[Tensor]) -> Point:
        """Return the points of :func:`point_columns`, whose first dimension is that of the columns; or of as many planes."""
        return Point(Vec3(*columns[:3]), Vec3(*columns[3:6]), *columns[6:])


COLUMNS = 10
"""Numbers of a point."""


def point_columns(
    r_PB_B: Tensor,
    n_B: Tensor,
    theta_max: Tensor,
    range_max: Tensor,
    theta_solar_max: Tensor,
    min_illumination_factor: Tensor,
) -> Tensor:
    """Return the numbers of points, [10, ..., P] float64, from what users give; see :class:`Point`.

    Args:
        r_PB_B: Positions in body axes, [..., P, 3] m.
        n_B: Normals of any length, [..., P, 3].
        theta_max: Largest angle between normal and inspector, [..., P] rad; no limit if it is not positive.
        range_max: Longest distance of the inspector, [..., P] m; no limit if it is not positive.
        theta_solar_max: Largest angle between normal and Sun, [..., P] rad; no limit if it is negative.
        min_illumination_factor: Least visible fraction of the Sun, [..., P]; no limit if it is not positive.
    """
    normal = n_B / n_B.norm(dim=-1, keepdim=True)
    cosine = torch.cos(theta_max)
    limits = (
        torch.where((theta_max > 0.0) & (theta_max < math.pi), cosine * cosine.abs(), NO_CONE),
        torch.where(range_max > 0.0, range_max * range_max, NO_RANGE),
        torch.where((theta_solar_max >= 0.0) & (theta_solar_max < math.pi), torch.cos(theta_solar_max), NO_CONE),
        torch.where(min_illumination_factor > 0.0, min_illumination_factor, NO_SHADE),
    )
    return torch.stack([*r_PB_B.unbind(-1), *normal.unbind(-1), *limits]).double()


def sunlit(point: Point, s_B: Vec3, illumination: Tensor) -> Tensor:
    """Return whether a point is lit: ``n . s >= cos(theta_solar_max)`` and ``f >= min_illumination_factor``.

    Args:
        point: The point.
        s_B: Unit vector from the Earth's center to the Sun, in B.
        illumination: Visible fraction f of the Sun.
    """
    return (point.n_B.dot(s_B) >= point.sun) & (illumination >= point.light)


def faces(point: Point, rho_B: Vec3) -> Tensor:
    """Return whether an inspector is within range and cone of a point: ``|d| <= range_max`` and ``n . d >= |d| cos(theta_max)``.

    ``d = rho - r_PB`` is the way from the point to the inspector. The cosine is compared as signed squares, without a root.

    Args:
        point: The point.
        rho_B: Position of the inspector relative to the spacecraft, m in B.
    """
    d = rho_B - point.r_PB_B
    d2, along = d.dot(d), point.n_B.dot(d)
    return (d2 <= point.range2) & (along * torch.abs(along) >= point.cone * d2)


def in_view(point: Point, r_BN_B: Vec3, inspector_B: Vec3, pole_B: Vec3) -> Tensor:
    """Return whether the Earth leaves the line from a point to an inspector free.

    See :mod:`bsk_torch.sim.access.links.line_of_sight`.

    Args:
        point: The point.
        r_BN_B: Position of the spacecraft relative to the Earth's center, m in B.
        inspector_B: Stretched position of the inspector, m in B.
        pole_B: Unit vector along the Earth's axis, in B.
    """
    return line_clearance(stretch(r_BN_B + point.r_PB_B, pole_B), inspector_B) > 0.0
