"""Attitude as modified Rodrigues parameters (MRP) and direction-cosine matrices (DCM).

Equations: Schaub and Junkins, "Analytical Mechanics of Space Systems", chapter 3. All functions are branch-free and work on
vectors of any batch shape. ``sigma_BN`` is the attitude of B relative to N and ``BN`` maps N components to B components.
"""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.vec3 import Mat3, Vec3, select

__all__ = ["dcm_to_mrp", "mrp_add", "mrp_rate", "mrp_rate_to_omega", "mrp_shadow", "mrp_subtract", "mrp_switch", "mrp_to_dcm"]

SINGULAR = 0.1
"""Below this denominator Basilisk composes with the shadow set of the first rotation."""


def mrp_to_dcm(sigma: Vec3) -> Mat3:
    """Return the DCM [BN] of the MRP sigma_BN.

    ``[BN] = I + (8 S S - 4 (1 - s^2) S) / (1 + s^2)^2`` with S the cross-product matrix of sigma and ``s = |sigma|`` (Schaub and
    Junkins, chapter 3).
    """
    s2 = sigma.dot(sigma)
    scale = 1.0 / ((1.0 + s2) * (1.0 + s2))
    outer, skew = 8.0 * scale, 4.0 * (1.0 - s2) * scale
    diagonal = 1.0 - outer * s2
    xy, xz, yz = outer * sigma.x * sigma.y, outer * sigma.x * sigma.z, outer * sigma.y * sigma.z
    wx, wy, wz = skew * sigma.x, skew * sigma.y, skew * sigma.z
    return Mat3(
        Vec3(diagonal + outer * sigma.x * sigma.x, xy + wz, xz - wy),
        Vec3(xy - wz, diagonal + outer * sigma.y * sigma.y, yz + wx),
        Vec3(xz + wy, yz - wx, diagonal + outer * sigma.z * sigma.z),
    )


def dcm_to_mrp(dcm: Mat3) -> Vec3:
    """Return the MRP of a DCM C by Sheppard's method, with norm at most one.

    With the squares ``4 b0^2 = 1 + tr C`` and ``4 bi^2 = 1 + 2 C_ii - tr C`` of the Euler parameters, the largest of the four is
    taken and the others follow from ``4 b0 b1 = C_yz - C_zy``, ``4 b1 b2 = C_xy + C_yx`` and their cyclic permutations; then
    ``sigma = b / (1 + b0)`` with the sign that makes b0 positive (Schaub and Junkins, chapter 3). Euler parameters are
    used up to a common factor here, which normalizing by their length removes: ``sigma = q / (q0 + sign(q0) |(q0, q)|)``.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = dcm
    trace = xx + yy + zz
    b0, b1, b2, b3 = 1.0 + trace, 1.0 + 2.0 * xx - trace, 1.0 + 2.0 * yy - trace, 1.0 + 2.0 * zz - trace
    d1, d2, d3 = yz - zy, zx - xz, xy - yx
    s12, s13, s23 = xy + yx, zx + xz, yz + zy
    scalar_or_x, y_or_z = b0 >= b1, b2 >= b3
    first = torch.maximum(b0, b1) >= torch.maximum(b2, b3)

    def pick(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
        return torch.where(first, torch.where(scalar_or_x, a, b), torch.where(y_or_z, c, d))

    # Each row of four holds the quaternion times four times its largest component.
    q0, q = pick(b0, d1, d2, d3), Vec3(pick(d1, b1, s12, s13), pick(d2, s12, b2, s23), pick(d3, s13, s23, b3))
    length = torch.sqrt(q0 * q0 + q.dot(q))
    return q / (q0 + torch.where(q0 < 0.0, -length, length))


def mrp_shadow(sigma: Vec3) -> Vec3:
    """Return the other MRP of the same attitude, ``-sigma / |sigma|^2``; zero where sigma is zero."""
    s2 = sigma.dot(sigma)
    return -sigma / torch.where(s2 > 0.0, s2, torch.ones_like(s2))


def mrp_switch(sigma: Vec3) -> Vec3:
    """Return the MRP whose norm is at most one: the shadow ``-sigma / |sigma|^2`` where ``|sigma|^2 > 1``, else sigma."""
    return select(sigma.dot(sigma) > 1.0, mrp_shadow(sigma), sigma)


def _compose(first: Vec3, second: Vec3) -> tuple[Vec3, Tensor]:
    """Return numerator and denominator of the rotation ``first``, then ``second``; see :func:`mrp_add`."""
    f2, s2 = first.dot(first), second.dot(second)
    numerator = first * (1.0 - s2) + first.cross(second) * 2.0 + second * (1.0 - f2)
    return numerator, 1.0 + f2 * s2 - 2.0 * first.dot(second)


def mrp_add(first: Vec3, second: Vec3) -> Vec3:
    """Return the MRP of the rotation ``first`` q1 followed by ``second`` q2, with norm at most one (Basilisk's addMRP).

    ``q = [(1 - |q2|^2) q1 + 2 q1 x q2 + (1 - |q1|^2) q2] / D`` with ``D = 1 + |q1|^2 |q2|^2 - 2 q1 . q2`` (Schaub and Junkins,
    chapter 3). D is near zero where q is near its singularity at a whole turn: where ``|D| < 0.1``, the shadow of q1 takes its
    place, as in Basilisk.
    """
    denominator = _compose(first, second)[1]
    first = select(torch.abs(denominator) < SINGULAR, mrp_shadow(first), first)
    numerator, denominator = _compose(first, second)
    return mrp_switch(numerator / denominator)


def mrp_subtract(total: Vec3, reference: Vec3) -> Vec3:
    """Return the MRP of ``total`` q1 relative to ``reference`` q2, with norm at most one (Basilisk's subMRP).

    ``q = [(1 - |q2|^2) q1 + 2 q1 x q2 - (1 - |q1|^2) q2] / D`` with ``D = 1 + |q1|^2 |q2|^2 + 2 q1 . q2``, which is the rotation
    -q2 followed by q1: ``[BR] = [BN] [RN]^T``.
    """
    return mrp_add(-reference, total)


def mrp_rate(sigma: Vec3, omega: Vec3) -> Vec3:
    """Return the rate of the MRP sigma_BN, 1/s, at the body rate omega_BN, rad/s in B.

    ``sigma' = 1/4 B(sigma) omega`` with ``B = (1 - s^2) I + 2 S + 2 sigma sigma^T`` (Schaub and Junkins, chapter 3).
    """
    s2 = sigma.dot(sigma)
    return (omega * (1.0 - s2) + sigma.cross(omega) * 2.0 + sigma * (2.0 * sigma.dot(omega))) * 0.25


def mrp_rate_to_omega(sigma: Vec3, sigma_dot: Vec3) -> Vec3:
    """Return the body rate omega_BN, rad/s in B, at which sigma_BN has the rate sigma_dot, 1/s: inverse of :func:`mrp_rate`.

    ``omega = 4 B^-1 sigma'`` with ``B^-1 = B^T / (1 + s^2)^2`` (Schaub and Junkins, chapter 3).
    """
    s2 = sigma.dot(sigma)
    scale = 4.0 / ((1.0 + s2) * (1.0 + s2))
    return (sigma_dot * (1.0 - s2) - sigma.cross(sigma_dot) * 2.0 + sigma * (2.0 * sigma.dot(sigma_dot))) * scale
