"""Two-body orbits: elements, Hill frame. Source of the equations: Schaub and Junkins, chapters 9 and 14."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.constants import MU_EARTH
from bsk_torch.vec3 import Mat3, Vec3

__all__ = [
    "Elements",
    "angle_of",
    "elements_to_rv",
    "hill_frame",
    "hill_rate",
    "hill_to_inertial",
    "periapsis_radius",
    "rv_to_elements",
]

SMALL = 1e-11
"""Below this eccentricity or inclination Basilisk treats an orbit as circular or equatorial."""


class Elements(NamedTuple):
    """Classical orbital elements: a in m, e, and i, Omega, omega, f in rad; numbers or tensors of one shape.

    They are osculating: those of the Kepler orbit with the position and velocity of one time, here in the inertial axes N (J2000,
    to which GCRF is parallel). The numbers of a two-line set (TLE) are mean elements in other axes (TEME), which only SGP4 turns
    into positions.
    """

    a: Tensor
    e: Tensor
    i: Tensor
    Omega: Tensor
    omega: Tensor
    f: Tensor


def elements_to_rv(oe: Elements, mu: Tensor | float = MU_EARTH) -> tuple[Vec3, Vec3]:
    """Return position, m, and velocity, m/s, of elements, in the inertial axes N that they refer to.

    With ``p = a (1 - e^2)``, ``r = p / (1 + e cos f)`` and ``theta = omega + f``::

        r_N = r [cos th cos Om - cos i sin th sin Om,  cos th sin Om + cos i sin th cos Om,  sin th sin i]
        v_N = sqrt(mu / p) [-(cos Om (e sin om + sin th) + cos i (e cos om + cos th) sin Om),
                            -(sin Om (e sin om + sin th) - cos i (e cos om + cos th) cos Om),  (e cos om + cos th) sin i]

    Source: Schaub and Junkins, chapter 9.
    """
    p = oe.a * (1.0 - oe.e * oe.e)
    radius, theta = p / (1.0 + oe.e * torch.cos(oe.f)), oe.omega + oe.f
    c_node, s_node, c_i, s_i = torch.cos(oe.Omega), torch.sin(oe.Omega), torch.cos(oe.i), torch.sin(oe.i)
    c, s = torch.cos(theta), torch.sin(theta)
    r = Vec3(c * c_node - c_i * s * s_node, c * s_node + c_i * s * c_node, s * s_i) * radius
    down, up = oe.e * torch.sin(oe.omega) + s, oe.e * torch.cos(oe.omega) + c
    speed = mu / torch.sqrt(mu * p)
    v = Vec3(-(c_node * down + c_i * up * s_node), -(s_node * down - c_i * up * c_node), up * s_i) * speed
    return r, v


def angle_of(y: Tensor, x: Tensor) -> Tensor:
    """Return the angle, rad in (-pi, pi], of points (x, y) other than the origin: ``2 atan(y / (|(x, y)| + x))`` where x >= 0.

    The last bit of torch's atan2 depends on where in a tensor a number stands, so results would depend on the size of the batch.
    """
    angle = 2.0 * torch.atan(y / (torch.sqrt(x * x + y * y) + torch.abs(x)))
    return torch.where(x < 0.0, torch.where(y < 0.0, -math.pi - angle, math.pi - angle), angle)


def rv_to_elements(r: Vec3, v: Vec3, mu: Tensor | float = MU_EARTH, small: float = SMALL) -> Elements:
    """Return the elements of a bound, non-rectilinear orbit; angles in [0, 2 pi).

    From ``h = r x v`` and ``e = ((v^2 - mu / r) r - (r . v) v) / mu``: ``1 / a = 2 / r - v^2 / mu``, i is the angle between h and
    z, Omega that of the node ``n = z x h``, omega goes from n to e and f from e to r, about h (Schaub and Junkins, chapter 9;
    Vallado, algorithm 9).

    Orbits with an eccentricity below ``small`` get e = omega = 0 and the argument of latitude as f; those with an inclination
    below get Omega = 0. The first moves them by up to ``2 a small``, the second by ``a small``.
    """
    radius, v2 = r.norm(), v.dot(v)
    h = r.cross(v)
    eccentricity = r * ((v2 - mu / radius) / mu) - v * (r.dot(v) / mu)
    across = torch.sqrt(h.x * h.x + h.y * h.y)
    e, i = eccentricity.norm(), angle_of(across, h.z)
    zero, one = torch.zeros_like(e), torch.ones_like(e)
    equatorial, circular = across < small * h.norm(), e < small
    node = Vec3(torch.where(equatorial, one, -h.y), torch.where(equatorial, zero, h.x), zero)
    apse = Vec3(*(torch.where(circular, n, k) for n, k in zip(node, eccentricity, strict=True)))

    def angle(start: Vec3, end: Vec3) -> Tensor:
        sine = start.cross(end).dot(h) / h.norm()
        return torch.remainder(angle_of(sine, start.dot(end)), 2.0 * math.pi)

    raan = torch.remainder(angle_of(node.y, node.x), 2.0 * math.pi)
    a = 1.0 / (2.0 / radius - v2 / mu)
    return Elements(a, torch.where(circular, zero, e), i, raan, angle(node, apse), angle(apse, r))


def hill_frame(r: Vec3, v: Vec3) -> Mat3:
    """Return the DCM [HN] of the Hill frame.

    Its rows are ``o_r = r / |r|``, ``o_theta = o_h x o_r`` and ``o_h = r x v / |r x v|``: radial, along the track and along the
    orbit normal (Schaub and Junkins, section 14.2).
    """
    radial, normal = r.unit(), r.cross(v).unit()
    return Mat3(radial, normal.cross(radial), normal)


def hill_rate(r: Vec3, v: Vec3) -> Tensor:
    """Return the rate of the Hill frame about the orbit normal, rad/s: ``f' = |r x v| / |r|^2``."""
    return r.cross(v).norm() / r.dot(r)


def hill_to_inertial(r_CN_N: Vec3, v_CN_N: Vec3, rho_H: Vec3, rho_H_dot: Vec3) -> tuple[Vec3, Vec3]:
    """Return position, m, and velocity, m/s, in N of a deputy D from its motion relative to a chief C.

    ``r_D = r_C + [NH] rho`` and ``v_D = v_C + [NH] (rho' + omega_HN x rho)`` (Schaub and Junkins, section 14.2).

    Args:
        r_CN_N: Position of the chief, m.
        v_CN_N: Velocity of the chief, m/s.
        rho_H: Position of the deputy relative to the chief in the chief's Hill frame, m.
        rho_H_dot: Its rate of change as seen in that frame, m/s.
    """
    NH, rate = hill_frame(r_CN_N, v_CN_N).mT, hill_rate(r_CN_N, v_CN_N)
    turning = Vec3(-rho_H.y * rate, rho_H.x * rate, torch.zeros_like(rho_H.z))
    return r_CN_N + NH @ rho_H, v_CN_N + NH @ (rho_H_dot + turning)


def periapsis_radius(r: Vec3, v: Vec3, mu: Tensor | float = MU_EARTH) -> Tensor:
    """Return the radius of periapsis, m, of the osculating orbit: ``a (1 - e)``, with a and e as in :func:`rv_to_elements`."""
    radius, v2 = r.norm(), v.dot(v)
    eccentricity = r * ((v2 - mu / radius) / mu) - v * (r.dot(v) / mu)
    return (1.0 - eccentricity.norm()) / (2.0 / radius - v2 / mu)
