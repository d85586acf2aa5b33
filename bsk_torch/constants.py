"""Physical constants in SI units, each with its source.

Where Basilisk's value differs from the modern one, Basilisk's is used: parity comes first.
"""

from __future__ import annotations

import math

__all__ = ["AU", "DAY", "MU_EARTH", "MU_SUN", "NANO", "RPM", "R_EARTH", "R_SUN", "SOLAR_FLUX"]

MU_EARTH = 398600.436e9
"""Earth's gravitational parameter, m^3/s^2 (Basilisk's body factory; its gravity file says 398600.4415e9)."""

R_EARTH = 6378136.6
"""Earth's equatorial radius, m (Basilisk's body factory; IAU 2009)."""

MU_SUN = 132712440023.310e9
"""Sun's gravitational parameter, m^3/s^2 (Basilisk's body factory)."""

R_SUN = 695000.0e3
"""Sun's radius used by Basilisk's eclipse model, m."""

AU = 149597870693.0
"""Astronomical unit used by Basilisk's solar panel, m."""

SOLAR_FLUX = 1361.0
"""Solar flux at one astronomical unit, W/m^2 (Basilisk's solar panel)."""

RPM = 2.0 * math.pi / 60.0
"""One revolution per minute, rad/s."""

DAY = 86400.0
"""Seconds in a day."""

NANO = 1e-9
"""Seconds in a nanosecond; Basilisk's clock counts nanoseconds."""
