"""Initial velocities with which a flown orbit stays near an analytic theory, which lacks periodic terms of the Earth's field.

The state that SGP4 has at one time, flown in a full field, drifts along the track by kilometers in six hours: without the
periodic terms of the tesseral harmonics, its energy is that of an orbit tens of meters higher or lower. A least-squares fit of
the velocity to positions of the theory over hours removes the drift, and leaves the position at the start unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, coverage, sun_position
from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.gravity import DEGREE, field, field_weights, third_body
from bsk_torch.constants import MU_EARTH
from bsk_torch.vec3 import Vec3

__all__ = ["SPAN", "matched_velocity"]

SPAN = 12 * 3600.0
"""Seconds over which positions are matched."""

SPACING = 120.0
"""Seconds between the positions: 7.5 degrees of a low orbit."""

STENCIL = (-205.0 / 72.0, 8.0 / 5.0, -1.0 / 5.0, 8.0 / 315.0, -1.0 / 560.0)
SLOPE = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)
"""Weights of the second derivative by central differences of order eight at distances 0 to 4, and of the first at 1 to 4
(Fornberg, "Generation of finite difference formulas on arbitrarily spaced grids", 1988)."""


def matched_velocity(positions: Callable[[Tensor], Tensor], et: Tensor, axes: Tensor, meridian: Tensor) -> Tensor:
    """Return velocities [n, 3], m/s in T, whose orbits from the theory's position at ET [n], s, stay nearest to the theory.

    The distance x from the theory's path r follows ``x'' = G(r) x + a(r) - r''`` with the gradient G of the point mass and the
    acceleration a of the simulation, the Earth's field of degree 10 and the Sun. It is linear in the change of the velocity, so
    one solution of normal equations minimizes the sum of ``|x|^2`` over :data:`SPAN` s.

    Args:
        positions: Returns the theory's positions, [n, K, 3] m in the axes T, at times [K], s after ET.
        et: Epochs, [n] s.
        axes: DCM [TN] from N to T, [n, 3, 3]; z of T is the Earth's pole.
        meridian: Angle from x of T to the prime meridian at ET, [n] rad.
    """
    steps = 2 * math.ceil(0.5 * SPAN / SPACING)
    reach = len(STENCIL) - 1
    times = SPACING * torch.arange(-reach, steps + reach + 1, dtype=torch.float64, device=et.device)
    path = positions(times)
    inner = path[:, reach:-reach]
    curve = STENCIL[0] * inner
    for k in range(1, reach + 1):
        curve = curve + STENCIL[k] * (path[:, reach - k : -reach - k] + path[:, reach + k : path.shape[1] - reach + k])
    time = times[reach:-reach]
    angle = meridian.unsqueeze(-1) + EARTH_ROTATION_RATE * time
    cos, sin = torch.cos(angle), torch.sin(angle)
    r = Vec3.of(inner)
    pull = field(rotate_z(r, cos, sin), field_weights(DEGREE))
    sun = sun_position((et.unsqueeze(-1) + time).clamp(max=coverage()[1]))
    a = rotate_z(pull, cos, -sin) + third_body(r, Vec3.of((axes.unsqueeze(1) @ sun.unsqueeze(-1)).squeeze(-1)))
    # the theory's own velocities are no derivatives of its positions: for eccentric orbits, SGP4's are off by 1 m/s
    slope = sum(SLOPE[k - 1] * (path[:, reach + k] - path[:, reach - k]) for k in range(1, reach + 1)) / SPACING
    return slope + _least(inner, a.stack() - curve / SPACING**2)


def _least(r: Tensor, forcing: Tensor) -> Tensor:
    """Return the changes of velocity [n, 3] that minimize distances along paths r [n, K, 3], driven by a forcing [n, K, 3]."""
    n, count, _ = r.shape
    radius2 = (r * r).sum(-1)[..., None, None]
    strength = MU_EARTH / (radius2 * radius2.sqrt())
    eye = torch.eye(3, dtype=r.dtype, device=r.device)
    gradient = strength * (3.0 * r.unsqueeze(-1) * r.unsqueeze(-2) / radius2 - eye)
    driven = torch.cat([forcing.unsqueeze(-1), forcing.new_zeros(n, count, 3, 3)], -1)  # and the changes by each component
    x, w = r.new_zeros(n, 3, 4), torch.cat([r.new_zeros(n, 3, 1), eye.expand(n, 3, 3)], -1)
    h, normal, right = 2.0 * SPACING, r.new_zeros(n, 3, 3), r.new_zeros(n, 3, 1)

    def rate(k: int, x: Tensor) -> Tensor:
        return gradient[:, k] @ x + driven[:, k]

    for k in range(0, count - 2, 2):
        k1 = rate(k, x)
        k2 = rate(k + 1, x + 0.5 * h * w)
        k3 = rate(k + 1, x + 0.5 * h * w + 0.25 * h * h * k1)
        k4 = rate(k + 2, x + h * w + 0.5 * h * h * k2)
        x, w = x + h * w + (h * h / 6.0) * (k1 + k2 + k3), w + (h / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        normal = normal + x[..., 1:].mT @ x[..., 1:]
        right = right + x[..., 1:].mT @ x[..., :1]
    return -torch.linalg.solve(normal, right).squeeze(-1)
