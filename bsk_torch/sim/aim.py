"""Where targets stand as seen from the satellites, for all of them in one call."""

from __future__ import annotations

from functools import cache
from typing import Any

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.lanes.loop import Loop
from bsk_torch.sim.paths import Sketch
from bsk_torch.vec3 import Mat3, Vec3

SEEN_FROM = ("r_BN_P", "v_BN_P", "c_hat_P", "omega_BP_P")
"""Properties of a satellite that the geometry of places depends on."""

WIDTH = 5
"""Numbers of each place: :func:`aim`'s position in the Hill frame, angle and rate."""


def aim(r_BN_P: Vec3, v_BN_P: Vec3, c_hat_P: Vec3, omega_BP_P: Vec3, r_LP_P: Vec3) -> list[Any]:
    """A place L as seen from the satellite B, whose instrument points along c; everything Earth-fixed, the velocity too.

    Returns:
        The position of the place relative to the satellite in the Hill frame, m, three numbers; the angle between instrument and
        line of sight, rad in [0, pi]; and ``|w_BP - v x rho / rho^2|``, rad/s, the rate at which the body must turn, relative to
        its own, to follow the place along the line of sight ``rho``.
    """
    rho = r_LP_P - r_BN_P
    zero = torch.zeros_like(r_BN_P.x)
    v_N = v_BN_P + Vec3(zero, zero, zero + EARTH_ROTATION_RATE).cross(r_BN_P)  # inertial velocity in Earth-fixed axes
    radial, normal = r_BN_P.unit(), r_BN_P.cross(v_N).unit()
    r_LB_H = Mat3(radial, normal.cross(radial), normal) @ rho
    range2 = rho.dot(rho)
    angle = torch.acos(torch.clamp(rho.dot(c_hat_P) / torch.sqrt(range2), -1.0, 1.0))
    turn = v_BN_P.cross(rho) / range2
    return [*r_LB_H, angle, (omega_BP_P - turn).norm()]


@cache
def aim_kernel() -> Loop:
    """:func:`aim` of pairs of satellite and place, 15 numbers each."""
    sketch = Sketch()
    r, v, c, omega, site = sketch.vectors("own", 5)
    return Loop("aim at targets", sketch.program, [], (), aim(r, v, c, omega, site), clock="start")


def aims(satellite: tuple[Tensor, ...], r_LP_P: Tensor, compiled: bool) -> Tensor:
    """:func:`aim` of every satellite at places ``r_LP_P`` [N, n, 3] m, [N, n, WIDTH].

    ``satellite`` are its properties :data:`SEEN_FROM`, [N, 3] each.
    """
    batch = r_LP_P.shape[:2]
    if not compiled:
        r, v, c, omega = (Vec3.of(vector.unsqueeze(1)) for vector in satellite)
        return torch.stack([value.expand(batch) for value in aim(r, v, c, omega, Vec3.of(r_LP_P))], -1)
    own = torch.cat([*(vector.mT.unsqueeze(-1).expand(3, *batch) for vector in satellite), r_LP_P.permute(2, 0, 1)])
    written = r_LP_P.new_empty(batch.numel(), 1, WIDTH)
    aim_kernel()(own.flatten(1)[:1], 1, (), own=own.flatten(1), written=written)
    return written.view(*batch, WIDTH)
