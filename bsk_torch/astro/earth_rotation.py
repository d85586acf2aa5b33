"""Precession, nutation and rotation of the Earth (IAU 2006/2000A), for the axes ITRF, TEME and GCRF; models of the rotation.

N, the simulation's axes, are those of J2000 in JPL's ephemerides, that is ICRF, to which GCRF is parallel. Epochs are ET, s past
J2000 (TDB, which is less than 2 ms from TT), float64 of any shape; UT1 is taken as UTC.

Sources:
    IERS Conventions (2010), IERS Technical Note 36, chapter 5: angles of precession (equation 5.40), nutation (tables 5.3a and
    5.3b), the locator s (table 5.2d), the Earth rotation angle (equation 5.15).
    Aoki et al. (1982): Greenwich mean sidereal time 1982, which connects TEME with the Earth (Vallado, Crawford, Hujsak and Kelso,
    "Revisiting Spacetrack Report #3", AIAA 2006-6753, appendix C).

Neglected, with sizes on the ground:
    terms of the nutation below 0.2 mas and of the planets: 1.5 mas, 5 cm;
    polar motion: up to 0.6 arcseconds, 18 m;
    UT1 - UTC: by definition below 0.9 s, 418 m at the equator; below 0.12 s, 56 m, since 2021;
    free core nutation, and rates of the pole that tables of the IERS add: 0.3 mas, 1 cm.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import CENTURY, DAY, earth_angles, earth_orientation, utc_seconds
from bsk_torch.vec3 import Mat3, Vec3

__all__ = [
    "EARTHS",
    "IAU_EARTH",
    "Earth",
    "intermediate_axes",
    "itrf_axes",
    "pole_matrix",
    "rotation_angle",
    "sidereal_time_1982",
    "teme_axes",
]

ARCSECOND = math.pi / 648000.0

ARGUMENTS = (
    (485868.249036, 1717915923.2178, 31.8792, 0.051635, -0.00024470),
    (1287104.793048, 129596581.0481, -0.5532, 0.000136, -0.00001149),
    (335779.526232, 1739527262.8478, -12.7512, -0.001037, 0.00000417),
    (1072260.703692, 1602961601.2090, -6.3706, 0.006593, -0.00003169),
    (450160.398036, -6962890.5431, 7.4722, 0.007702, -0.00005939),
)
"""Fundamental arguments l, l', F, D and Omega of the nutation: powers of T, Julian centuries, arcseconds (equation 5.43)."""

GAMMA = (-0.052928, 10.556378, 0.4932044, -0.00031238, -0.000002788, 0.0000000260)
PHI = (84381.412819, -46.811016, 0.0511268, 0.00053289, -0.000000440, -0.0000000176)
PSI = (-0.041775, 5038.481484, 1.5584175, -0.00018522, -0.000026452, -0.0000000148)
EPSILON = (84381.406, -46.836769, -0.0001831, 0.00200340, -0.000000576, -0.0000000434)
"""Angles of bias and precession by Fukushima and Williams: powers of T, arcseconds."""

LOCATOR = (94.0e-6, 3808.65e-6, -122.68e-6, -72574.11e-6, 27.98e-6, 15.62e-6)
LOCATOR_NODE, LOCATOR_TWICE = -2640.73e-6, -63.53e-6
"""``s + X Y / 2``: powers of T, and amplitudes of the sines of Omega and 2 Omega, arcseconds; the other terms are below 12e-6."""


def rotation_angle(et: Tensor) -> Tensor:
    """Return the Earth rotation angle, rad in [0, 2 pi): ``2 pi (0.7790572732640 + 1.00273781191135448 D)``, D days of UT1."""
    days = utc_seconds(et) / DAY
    turns = 0.7790572732640 + 0.00273781191135448 * days + torch.remainder(days, 1.0)
    return 2.0 * math.pi * torch.remainder(turns, 1.0)


def sidereal_time_1982(et: Tensor) -> Tensor:
    """Return Greenwich mean sidereal time by its definition of 1982, rad in [0, 2 pi).

    ``67310.54841 + (876600 h + 8640184.812866) T + 0.093104 T^2 - 6.2e-6 T^3`` s, with T Julian centuries of UT1.
    """
    ut1 = utc_seconds(et)
    T = ut1 / CENTURY
    seconds = 67310.54841 + T * (8640184.812866 + T * (0.093104 - 6.2e-6 * T)) + torch.remainder(ut1, DAY)
    return 2.0 * math.pi * torch.remainder(seconds / DAY, 1.0)


@cache
def _series(device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the multiples of the arguments, [K, 5], and amplitudes, [K, 6] rad, of the nutation."""
    table = files("bsk_torch.astro").joinpath("tables/nutation_iau2000a.csv").read_text(encoding="utf-8")
    rows = torch.tensor([[float(x) for x in line.split(",")] for line in table.splitlines()[1:]], dtype=torch.float64)
    return rows[:, :5].to(device), (rows[:, 5:] * (1e-7 * ARCSECOND)).to(device)


def _power_sum(powers: tuple[float, ...], T: Tensor) -> Tensor:
    total = torch.full_like(T, powers[-1])
    for power in powers[-2::-1]:
        total = power + T * total
    return total * ARCSECOND


def _nutation(T: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the nutation in longitude and obliquity, rad, at T Julian centuries, and the Moon's mean node, rad.

    Precession of 2006 changes the amplitudes of 2000 by the factors that IERS Conventions, section 5.6.3, give.
    """
    multiples, amplitudes = _series(T.device)
    angles = [_power_sum(powers, T) for powers in ARGUMENTS]
    phase = sum(angle.unsqueeze(-1) * multiples[:, k] for k, angle in enumerate(angles))
    assert isinstance(phase, Tensor)
    sin, cos, rate = torch.sin(phase), torch.cos(phase), T.unsqueeze(-1)
    psi_sin, psi_sin_rate, psi_cos, eps_cos, eps_cos_rate, eps_sin = amplitudes.unbind(-1)
    psi = ((psi_sin + psi_sin_rate * rate) * sin + psi_cos * cos).sum(-1)
    eps = ((eps_cos + eps_cos_rate * rate) * cos + eps_sin * sin).sum(-1)
    flattening = -2.7774e-6 * T
    return psi * (1.0 + 0.4697e-6 + flattening), eps * (1.0 + flattening), angles[4]


def intermediate_axes(et: Tensor) -> Mat3:
    """Return the DCM [EN] from N to the celestial intermediate axes: z along the pole, x toward the intermediate origin.

    With the pole (X, Y), the third row of ``R1(-eps) R3(-psi) R1(phi) R3(gamma)``, and the locator s::

        [EN] = R3(-s) [1 - a X^2, -a X Y, -X; -a X Y, 1 - a Y^2, -Y; X, Y, 1 - a (X^2 + Y^2)],  a = 1 / (1 + Z)

    Source: IERS Conventions (2010), equations 5.6 to 5.10.
    """
    T = et / CENTURY
    psi, eps, node = _nutation(T)
    gamma, phi = _power_sum(GAMMA, T), _power_sum(PHI, T)
    psi, eps = psi + _power_sum(PSI, T), eps + _power_sum(EPSILON, T)
    s_eps, c_eps, s_psi, c_psi = torch.sin(eps), torch.cos(eps), torch.sin(psi), torch.cos(psi)
    s_phi, c_phi, s_gamma, c_gamma = torch.sin(phi), torch.cos(phi), torch.sin(gamma), torch.cos(gamma)
    across, along = s_eps * s_psi, s_eps * c_psi * c_phi - c_eps * s_phi
    X, Y = across * c_gamma - along * s_gamma, across * s_gamma + along * c_gamma
    s = _power_sum(LOCATOR, T) + ARCSECOND * (LOCATOR_NODE * torch.sin(node) + LOCATOR_TWICE * torch.sin(2.0 * node))
    s = s - 0.5 * X * Y
    Z = torch.sqrt(1.0 - X * X - Y * Y)
    a = 1.0 / (1.0 + Z)
    x, y = Vec3(1.0 - a * X * X, -a * X * Y, -X), Vec3(-a * X * Y, 1.0 - a * Y * Y, -Y)
    cos, sin = torch.cos(s), torch.sin(s)
    return Mat3(x * cos - y * sin, x * sin + y * cos, Vec3(X, Y, Z))


def _turned(axes: Mat3, angle: Tensor) -> Tensor:
    cos, sin = torch.cos(angle), torch.sin(angle)
    return Mat3(axes.x * cos + axes.y * sin, axes.y * cos - axes.x * sin, axes.z).stack()


def itrf_axes(et: Tensor) -> Tensor:
    """Return the DCM from N to ITRF without polar motion, [*et.shape, 3, 3]: ``R3(ERA) [EN]``."""
    return _turned(intermediate_axes(et), rotation_angle(et))


def teme_axes(et: Tensor) -> Tensor:
    """Return the DCM from N to TEME, the axes of SGP4's positions, [*et.shape, 3, 3]: ``R3(ERA - GMST82) [EN]``.

    ITRF is reached from TEME by the mean sidereal time of 1982, ``[ITRF, TEME] = R3(GMST82)``.
    """
    return _turned(intermediate_axes(et), rotation_angle(et) - sidereal_time_1982(et))


# -- models of the rotation -----------------------------------------------------------------------------------------------------


class Earth(NamedTuple):
    """A model of the Earth's rotation.

    The axes E have z along the pole and x toward the node of the equator, about 90 degrees east of the x axis of N; Earth-fixed axes
    follow by the angle W of the prime meridian, ``[PN] = R3(W) [EN]``.
    """

    pole: Callable[[Tensor], Mat3]  # [EN] at ET
    meridian: Callable[[Tensor], Tensor]  # W, rad, at ET
    orientation: Callable[[Tensor], Tensor]  # [PN] at ET, [..., 3, 3]


def pole_matrix(et: Tensor) -> Mat3:
    """Return the DCM [EN] at ET [n], s: the frame IAU_EARTH without its spin.

    ``[EN] = R1(90 deg - delta) R3(90 deg + alpha)`` with right ascension alpha and declination delta of the pole; see
    :func:`bsk_torch.astro.ephemeris.earth_angles`.
    """
    alpha, delta, _ = earth_angles(et)
    ca, sa, cd, sd = torch.cos(alpha), torch.sin(alpha), torch.cos(delta), torch.sin(delta)
    zero = torch.zeros_like(ca)
    return Mat3(Vec3(-sa, ca, zero), Vec3(-sd * ca, -sd * sa, cd), Vec3(cd * ca, cd * sa, sd))


def _itrf_pole(et: Tensor) -> Mat3:
    """Return [EN] of ITRF: the intermediate axes, turned by 90 degrees so that x is where IAU_EARTH has the node, within 0.3."""
    x, y, z = intermediate_axes(et)
    return Mat3(y, x * -1.0, z)


IAU_EARTH = Earth(pole_matrix, lambda et: earth_angles(et)[2], earth_orientation)
"""The frame IAU_EARTH of the NAIF kernel pck00010.tpc, as in Basilisk: 9.6 km from ITRF at the equator in 2026, in longitude."""

ITRF = Earth(_itrf_pole, lambda et: torch.remainder(rotation_angle(et) - 0.5 * math.pi, 2.0 * math.pi), itrf_axes)
"""ITRF without polar motion, with UT1 = UTC. Between records an hour apart, the simulation turns it at the rates of IAU_EARTH, which
is worth 0.1 m."""

EARTHS = {"IAU_EARTH": IAU_EARTH, "ITRF": ITRF}
"""Models by the values of the argument ``earthRotation``."""
