"""Record eclipses of ten orbits as Skyfield and SGP4 see them, as a file that ``tests/sim/access/test_eclipses.py`` reads.

Usage, in a separate environment with ``pip install skyfield==1.55 skyfield-data==7.0.0``::

    python scripts/recorders/record_skyfield.py

An orbit starts with SGP4's state in GCRS. Skyfield's ``is_sunlit`` tells whether the Earth, a sphere with the radius of the
equator, hides the center of the Sun.
"""

from __future__ import annotations

import csv
import math
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sgp4.api import WGS72, Satrec
from skyfield.api import EarthSatellite, load, load_file
from skyfield_data import get_skyfield_data_path

FILE = Path(__file__).resolve().parents[2] / "tests/sim/access/skyfield_eclipses.csv"

EPOCH = datetime(2025, 7, 17, 12, tzinfo=timezone.utc)
BEGIN_OF_SGP4 = datetime(1949, 12, 31, tzinfo=timezone.utc)

ORBITS = (
    (15.2, 0.0005, 51.6, 100.0, 0.0, 10.0),
    (15.8, 0.001, 28.5, 40.0, 80.0, 200.0),
    (14.8, 0.001, 97.6, 205.0, 90.0, 0.0),
    (13.4, 0.002, 66.0, 300.0, 10.0, 120.0),
    (13.0, 0.004, 100.0, 25.0, 200.0, 60.0),
    (10.0, 0.1, 45.0, 150.0, 120.0, 30.0),
    (5.0, 0.3, 10.0, 220.0, 300.0, 90.0),
    (2.0057, 0.01, 55.0, 115.0, 45.0, 150.0),
    (2.0061, 0.7, 63.4, 120.0, 270.0, 20.0),
    (1.0027, 0.0002, 22.0, 0.0, 0.0, 300.0),
)
"""Mean motion, revolutions a day, eccentricity, and inclination, node, perigee and mean anomaly, degrees."""

STEP, REVOLUTIONS, HALVINGS = 5.0, 1.05, 13
"""Seconds between the samples of the search, how far it goes, and how often its intervals are halved: down to a millisecond."""


def satellite(orbit: tuple[float, ...], number: int, timescale: Any) -> EarthSatellite:
    """The satellite of mean elements without drag at the epoch."""
    motion, eccentricity, *angles = orbit
    inclination, node, perigee, anomaly = (math.radians(angle) for angle in angles)
    days = (EPOCH - BEGIN_OF_SGP4) / timedelta(days=1)
    rate = motion * 2.0 * math.pi / 1440.0
    record = Satrec()
    record.sgp4init(WGS72, "i", number, days, 0.0, 0.0, 0.0, eccentricity, perigee, inclination, anomaly, rate, node)
    return EarthSatellite.from_satrec(record, timescale)


def main() -> None:
    """Write the file."""
    timescale = load.timescale(builtin=True)
    ephemeris = load_file(Path(get_skyfield_data_path()) / "de421.bsp")
    zero = timescale.from_datetime(EPOCH)

    def lit(orbiter: EarthSatellite, seconds: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(orbiter.at(timescale.tt_jd(zero.tt + seconds / 86400.0)).is_sunlit(ephemeris))

    rows = []
    for number, orbit in enumerate(ORBITS, 1):
        orbiter = satellite(orbit, number, timescale)
        times = np.arange(0.0, REVOLUTIONS * 86400.0 / orbit[0], STEP)
        light = lit(orbiter, times)
        row = [EPOCH.strftime("%Y-%m-%dT%H:%M:%S"), *orbiter.at(zero).xyz.m, *orbiter.at(zero).velocity.m_per_s]
        for before in (True, False):
            (crossings,) = np.nonzero((light[:-1] == before) & (light[1:] != before))
            if not len(crossings):
                row.append("")
                continue
            a, b = times[crossings[0]], times[crossings[0] + 1]
            for _ in range(HALVINGS):
                middle = 0.5 * (a + b)
                a, b = (middle, b) if lit(orbiter, np.array([middle]))[0] == before else (a, middle)
            row.append(round(float(0.5 * (a + b)), 3))
        rows.append(row)
    with FILE.open("w", newline="", encoding="utf-8") as file:
        file.write(
            "# Skyfield 1.55, DE421: scripts/recorders/record_skyfield.py; the center of the Sun is hidden from start to end\n"
        )
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["utc", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s", "start_s", "end_s"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
