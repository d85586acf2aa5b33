"""Geometry of the line of sight between two satellites, past an ellipsoidal Earth.

The Earth is an ellipsoid of revolution. Stretching all lengths along its axis turns it into a sphere and keeps lines straight, so
whether a line of sight is blocked is decided in stretched coordinates.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.orbit import periapsis_radius
from bsk_torch.astro.sight import TINY_LENGTH, line_clearance, stretch
from bsk_torch.vec3 import Vec3, select

SPEED_MARGIN = 1.02
"""Factor of :func:`speed_bound`: perturbations may make a satellite a little faster than at its osculating periapsis."""


def speed_bound(r_BN_N: Vec3, v_BN_N: Vec3) -> Tensor:
    """Return an upper bound of the speed on an orbit, m/s: that at the osculating periapsis, ``|r x v| / r_p``, and 2 % more."""
    return SPEED_MARGIN * r_BN_N.cross(v_BN_N).norm() / periapsis_radius(r_BN_N, v_BN_N)


class SatellitePositions(NamedTuple):
    """Positions in N, m, and the same in stretched coordinates."""

    r_BN_N: Vec3
    stretched: Vec3

    @staticmethod
    def of(r_BN_N: Vec3, pole: Vec3) -> SatellitePositions:
        """Return positions with their stretched coordinates, for a direction of the Earth's axis."""
        return SatellitePositions(r_BN_N, stretch(r_BN_N, pole))

    def map(self, function: Callable[[Tensor], Tensor]) -> SatellitePositions:
        """Apply ``function`` to every component."""
        return SatellitePositions(self.r_BN_N.map(function), self.stretched.map(function))

    def where(self, condition: Tensor, other: SatellitePositions) -> SatellitePositions:
        """Return these positions where ``condition`` holds, and those of ``other`` elsewhere."""
        return SatellitePositions(*map(functools.partial(select, condition), self, other))


def visibility_margin(one: SatellitePositions, other: SatellitePositions, max_range: Tensor) -> Tensor:
    """Return a margin, m, that is positive if ``other`` is visible from ``one``, whose sensor has a range, m; infinite: no limit.

    The margin is ``min(clearance, (max_range - |r_other - r_own|) / 2)``. Both parts change by no more than the larger
    displacement of the two satellites, which is what the search for lines of sight needs.
    """
    clearance = line_clearance(one.stretched, other.stretched)
    return torch.minimum(clearance, 0.5 * (max_range - (other.r_BN_N - one.r_BN_N).norm()) + TINY_LENGTH)
