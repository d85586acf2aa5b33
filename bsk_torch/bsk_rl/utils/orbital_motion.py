"""Constants and conversions of orbits that programs read from ``bsk_rl.utils.orbital.orbitalMotion``.

Names and values are those of ``Basilisk.utilities.orbitalMotion``: lengths in km, gravitational parameters in km^3/s^2. Functions
take any consistent units. Equations: Schaub and Junkins, "Analytical Mechanics of Space Systems", chapter 9.
"""

from __future__ import annotations

import math

from bsk_torch import constants
from bsk_torch.astro.elements import ClassicElements, elem2rv, rv2elem

__all__ = [
    "AU",
    "D2R",
    "E2M",
    "J2_EARTH",
    "M2E",
    "MU_EARTH",
    "MU_MOON",
    "MU_SUN",
    "OMEGA_EARTH",
    "REQ_EARTH",
    "REQ_MOON",
    "REQ_SUN",
    "RP_EARTH",
    "ClassicElements",
    "E2f",
    "elem2rv",
    "f2E",
    "rv2elem",
]

AU = 149597870.693
D2R = math.pi / 180.0
MU_SUN = constants.MU_SUN * 1e-9
MU_EARTH = constants.MU_EARTH * 1e-9
MU_MOON = 4902.799
REQ_SUN = constants.R_SUN * 1e-3
REQ_EARTH = constants.R_EARTH * 1e-3
RP_EARTH = 6356.7519
REQ_MOON = 1737.4
J2_EARTH = 1082.616e-6
OMEGA_EARTH = 0.00007292115

KEPLER_ROUNDS = 200
"""Most rounds of :func:`M2E`."""


def E2f(Ecc: float, e: float) -> float:
    """Return the true anomaly, rad, of an eccentric anomaly: ``tan(f / 2) = sqrt((1 + e) / (1 - e)) tan(E / 2)``."""
    return 2.0 * math.atan2(math.sqrt(1.0 + e) * math.sin(0.5 * Ecc), math.sqrt(1.0 - e) * math.cos(0.5 * Ecc))


def f2E(f: float, e: float) -> float:
    """Return the eccentric anomaly, rad, of a true anomaly; see :func:`E2f`."""
    return 2.0 * math.atan2(math.sqrt(1.0 - e) * math.sin(0.5 * f), math.sqrt(1.0 + e) * math.cos(0.5 * f))


def E2M(Ecc: float, e: float) -> float:
    """Return the mean anomaly, rad, of an eccentric anomaly: Kepler's equation ``M = E - e sin E``."""
    return Ecc - e * math.sin(Ecc)


def M2E(M: float, e: float) -> float:
    """Return the eccentric anomaly, rad, of a mean anomaly, by Newton's method on Kepler's equation."""
    E = M if e < 0.8 else math.pi
    for _ in range(KEPLER_ROUNDS):
        step = (E - e * math.sin(E) - M) / (1.0 - e * math.cos(E))
        E -= step
        if abs(step) < 1e-13:
            break
    return E
