"""Orbits about an oblate Earth in closed form: mean elements with secular rates and short-period terms of J2.

Source of the equations: Brouwer's theory to first order in J2, as Hoots and Roehrich, "Spacetrack Report No. 3" (SGP4) apply it,
without drag and without the odd zonal harmonics; short-period terms of the order of J2 times the eccentricity are left out.
"""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.astro.gravity import J2
from bsk_torch.astro.orbit import angle_of, rv_to_elements
from bsk_torch.constants import MU_EARTH, R_EARTH
from bsk_torch.vec3 import Vec3

__all__ = ["KEPLER_ITERATIONS", "mean_elements", "mean_position", "mean_rates"]

KEPLER_ITERATIONS = 4
"""Newton's iterations for Kepler's equation: they reach the rounding error for eccentricities up to 0.5."""

FIT_ITERATIONS = 6
"""Corrections of mean elements; each leaves about a hundredth of the error of the last."""


def mean_rates(oe: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the secular rates of node, perigee and mean anomaly, [...] rad/s, of mean elements [..., 6].

    With ``g = J2 R^2 / p^2``, ``c = cos i``, ``eta = sqrt(1 - e^2)`` and ``n = sqrt(mu / a^3)``::

        Omega' = -3/2 g n c     omega' = 3/4 g n (5 c^2 - 1)     M' = n (1 + 3/4 g eta (3 c^2 - 1))
    """
    a, e, i = oe[..., 0], oe[..., 1], oe[..., 2]
    eta2, c = 1.0 - e * e, torch.cos(i)
    n = torch.sqrt(MU_EARTH / a) / a
    g = J2 * R_EARTH * R_EARTH / (a * a * eta2 * eta2)
    return -1.5 * g * n * c, 0.75 * g * n * (5.0 * c * c - 1.0), n * (1.0 + 0.75 * g * torch.sqrt(eta2) * (3.0 * c * c - 1.0))


def _eccentric_anomaly(e: Tensor, anomaly: Tensor) -> tuple[Tensor, Tensor]:
    """Return sine and cosine of the eccentric anomaly: ``E - e sin E = M``, by Newton's method."""
    eccentric = anomaly + e * torch.sin(anomaly)
    for _ in range(KEPLER_ITERATIONS):
        sine, cosine = torch.sin(eccentric), torch.cos(eccentric)
        eccentric = eccentric - (eccentric - e * sine - anomaly) / (1.0 - e * cosine)
    return torch.sin(eccentric), torch.cos(eccentric)


def mean_position(oe: Tensor, time: Tensor) -> Vec3:
    """Return positions in N, [...] m, at times [...] s of mean elements [..., 6] at time zero; both broadcast.

    The Keplerian orbit of the mean elements at the time has the radius r and the argument of latitude u. To these, to node and
    inclination, J2 adds, with g, c and eta as in :func:`mean_rates`, ``s = sin i`` and ``k = J2 R^2 / p``::

        r     : k s^2 cos(2 u) / 4 - 3/4 g r eta (3 c^2 - 1)
        u     : -g (7 c^2 - 1) sin(2 u) / 8
        Omega : 3/4 g c sin(2 u)
        i     : 3/4 g c s cos(2 u)

    Args:
        oe: a in m, e, and i, Omega, omega, M in rad: what :func:`mean_elements` returns.
        time: Seconds.
    """
    a, e, i, node, perigee, anomaly = oe.unbind(-1)
    node_rate, perigee_rate, anomaly_rate = mean_rates(oe)
    sine, cosine = _eccentric_anomaly(e, anomaly + anomaly_rate * time)
    eta2 = 1.0 - e * e
    eta, p = torch.sqrt(eta2), a * eta2
    x, y, radius = a * (cosine - e), a * eta * sine, a * (1.0 - e * cosine)  # in the plane, x toward perigee
    omega = perigee + perigee_rate * time
    c_omega, s_omega = torch.cos(omega), torch.sin(omega)
    c_u, s_u = (x * c_omega - y * s_omega) / radius, (x * s_omega + y * c_omega) / radius
    c_2u, s_2u = c_u * c_u - s_u * s_u, 2.0 * c_u * s_u
    c, s = torch.cos(i), torch.sin(i)
    k = J2 * R_EARTH * R_EARTH / p
    g = k / p
    radius = radius * (1.0 - 0.75 * g * eta * (3.0 * c * c - 1.0)) + 0.25 * k * s * s * c_2u
    along = -0.125 * g * (7.0 * c * c - 1.0) * s_2u  # small angles: to the second order
    c_u, s_u = c_u - s_u * along - 0.5 * c_u * along * along, s_u + c_u * along - 0.5 * s_u * along * along
    now = node + node_rate * time + 0.75 * g * c * s_2u
    tilt = i + 0.75 * g * c * s * c_2u
    c_node, s_node, c_i, s_i = torch.cos(now), torch.sin(now), torch.cos(tilt), torch.sin(tilt)
    return Vec3(c_u * c_node - c_i * s_u * s_node, c_u * s_node + c_i * s_u * c_node, s_u * s_i) * radius


def _velocity(oe: Tensor) -> Vec3:
    """Return velocities in N at time zero, m/s, by a central difference of positions over two seconds, good to 1e-5 m/s."""
    ahead, behind = (mean_position(oe, torch.full_like(oe[..., 0], time)) for time in (1.0, -1.0))
    rate = mean_rates(oe)[2]
    return (ahead - behind) * (0.5 * (1.0 + rate * rate / 6.0))


def mean_elements(r_N: Tensor, v_N: Tensor) -> Tensor:
    """Return the mean elements, [..., 6], of osculating position [..., 3] m and velocity [..., 3] m/s in N at time zero.

    They are found by correcting the state whose Keplerian elements they are by the difference between the wanted state and the
    one that the theory gives, which is no larger than short-period terms.

    Returns:
        a in m, e, and i, Omega, omega, M in rad.
    """
    r, v = Vec3.of(r_N), Vec3.of(v_N)
    mean_r, mean_v = r, v
    for _ in range(FIT_ITERATIONS):
        oe = _elements(mean_r, mean_v)
        mean_r = mean_r + (r - mean_position(oe, torch.zeros_like(r.x)))
        mean_v = mean_v + (v - _velocity(oe))
    oe = _elements(mean_r, mean_v)
    return torch.cat([_axis(oe, _energy(r, v)).unsqueeze(-1), oe[..., 1:]], -1)


def _energy(r: Vec3, v: Vec3) -> Tensor:
    """Return the energy of a state, m^2/s^2: ``v^2 / 2 - mu / r + mu J2 R^2 (3 z^2 / r^2 - 1) / (2 r^3)``."""
    radius = r.norm()
    oblate = 0.5 * MU_EARTH * J2 * R_EARTH * R_EARTH / (radius * radius * radius) * (3.0 * r.z * r.z / (radius * radius) - 1.0)
    return 0.5 * v.dot(v) - MU_EARTH / radius + oblate


def _axis(oe: Tensor, energy: Tensor) -> Tensor:
    """Return the mean semi-major axis a, m, of the energy, which J2 leaves constant; e and i are those of mean elements.

    ``E = -mu / (2 a) + mu J2 R^2 (1 - 3 cos^2 i) / (4 a^3 eta^3)``. An error of a meter of a moves the satellite by nine meters
    along the track after one revolution, so a is found better in this way than by first-order short-period terms.
    """
    a, e, c = oe[..., 0], oe[..., 1], torch.cos(oe[..., 2])
    for _ in range(FIT_ITERATIONS):
        shift = 0.25 * MU_EARTH * J2 * R_EARTH * R_EARTH * (1.0 - 3.0 * c * c) / (a * torch.sqrt(1.0 - e * e)) ** 3
        a = -0.5 * MU_EARTH / (energy - shift)
    return a


def _elements(r: Vec3, v: Vec3) -> Tensor:
    """Return a, e, i, Omega, omega and the mean anomaly of a state: ``M = E - e sin E``."""
    oe = rv_to_elements(r, v)
    eta = torch.sqrt(1.0 - oe.e * oe.e)
    eccentric = angle_of(eta * torch.sin(oe.f), oe.e + torch.cos(oe.f))
    return torch.stack([*oe[:5], eccentric - oe.e * torch.sin(eccentric)], -1)
