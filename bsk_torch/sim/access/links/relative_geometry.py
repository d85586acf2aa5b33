"""Position, angle and angular rate of places on the ground relative to satellites, for all of them in one call."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.stored import stored_kernel
from bsk_torch.sim.orbit.builder import KernelBuilder
from bsk_torch.vec3 import Mat3, Vec3

SATELLITE_PROPERTIES = ("r_BN_P", "v_BN_P", "c_hat_P", "omega_BP_P")
"""Properties of a satellite that the relative geometry depends on."""

GEOMETRY_WIDTH = 5  # numbers that relative_geometry returns for each place


def relative_geometry(r_BN_P: Vec3, v_BN_P: Vec3, c_hat_P: Vec3, omega_BP_P: Vec3, r_LP_P: Vec3) -> list[Tensor]:
    """Return position, pointing error and tracking rate of a place L relative to a satellite B, all in Earth-fixed axes.

    With the line of sight ``rho = r_LP - r_BN``, m, the velocity v relative to the rotating Earth, m/s, and the body's rate
    omega_BP, rad/s::

        r_LB_H = [HP] rho, m                           Hill frame: radial, along-track, orbit normal of the inertial velocity
        angle  = acos(c_hat . rho / |rho|), rad        of the instrument's direction c_hat
        rate   = |omega_BP - v x rho / |rho|^2|, rad/s

    ``v x rho / |rho|^2`` is the angular velocity of the line of sight to a fixed place in Earth-fixed axes, without spin about
    itself.
    """
    rho = r_LP_P - r_BN_P
    zero = torch.zeros_like(r_BN_P.x)
    v_N = v_BN_P + Vec3(zero, zero, zero + EARTH_ROTATION_RATE).cross(r_BN_P)  # inertial velocity in Earth-fixed axes
    radial, normal = r_BN_P.unit(), r_BN_P.cross(v_N).unit()
    r_LB_H = Mat3(radial, normal.cross(radial), normal) @ rho
    range2 = rho.dot(rho)
    angle = torch.acos(torch.clamp(rho.dot(c_hat_P) / torch.sqrt(range2), -1.0, 1.0))
    omega_line = v_BN_P.cross(rho) / range2
    return [*r_LB_H, angle, (omega_BP_P - omega_line).norm()]


@stored_kernel
def relative_geometry_kernel() -> Kernel:
    """Return the kernel of :func:`relative_geometry` for pairs of satellite and place, 15 numbers each."""
    builder = KernelBuilder()
    r, v, c, omega, site = builder.vectors("own", 5)
    return Kernel("aim at targets", builder.loop([], relative_geometry(r, v, c, omega, site), (), "start"))


def relative_geometries(satellite: Tensor, r_LP_P: Tensor, compiled: bool) -> Tensor:
    """Return the :func:`relative_geometry` of every satellite and its places, [N, n, 3] m, [N, n, GEOMETRY_WIDTH].

    ``satellite`` are the properties :data:`SATELLITE_PROPERTIES` side by side, [N, 12]; the kernel computes the result where
    ``compiled``.
    """
    batch = r_LP_P.shape[:2]
    if not compiled:
        r, v, c, omega = (Vec3.of(vector) for vector in satellite.unsqueeze(1).split(3, -1))
        values = relative_geometry(r, v, c, omega, Vec3.of(r_LP_P))
        return torch.stack([value.expand(batch) for value in values], -1)
    inputs = torch.cat([satellite.mT.unsqueeze(-1).expand(-1, *batch), r_LP_P.permute(2, 0, 1)]).flatten(1)
    written = r_LP_P.new_empty(batch.numel(), 1, GEOMETRY_WIDTH)
    relative_geometry_kernel()(inputs[:1], 1, (), own=inputs, written=written)
    return written.view(*batch, GEOMETRY_WIDTH)
