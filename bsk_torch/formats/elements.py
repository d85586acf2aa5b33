"""Checks that all formats of orbits share, and element sets from their numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np
import torch

from bsk_torch._checks import number
from bsk_torch.astro.element_sets import GRAVITIES, ElementSet
from bsk_torch.astro.ephemeris import et_of_utc
from bsk_torch.constants import MU_EARTH, R_EARTH
from bsk_torch.formats.source import Source
from bsk_torch.sim.names import name_fault, one_of

BOUNDS = {
    "inclination": (0.0, 180.0, "degrees"),
    "node": (-360.0, 360.0, "degrees"),
    "eccentricity": (0.0, 0.999, ""),
    "perigee": (-360.0, 360.0, "degrees"),
    "mean anomaly": (-360.0, 360.0, "degrees"),
    "mean motion": (0.01, 18.0, "revolutions a day"),
}
"""Allowed numbers of an element set: 18 revolutions a day lie below the surface."""

LOWEST_PERIGEE = 6.458e6
"""Least distance of the perigee from the Earth's center, m: 80 km above the equator, below which nothing stays in orbit."""

LARGEST_BSTAR = 10.0
"""Largest drag term, 1/Earth radii: bodies in the last hours before their fall have 0.1."""


def check_satellites(source: Source, names: Sequence[tuple[int, str, object]]) -> None:
    """Raise ValueError for names that cannot be a satellite's, and names or identifiers that repeat.

    ``names`` holds the line, the name and the identifier of each satellite.
    """
    lines: dict[tuple[str, object], int] = {}
    for line, name, identifier in names:
        if fault := name_fault(name):
            source.fail(line, f"name={name!r} {fault}")
        for what, value in (("identifier", identifier), ("name", name)):
            if (what, value) in lines:
                source.fail(line, f"{what} {value!r} is also in line {lines[what, value]}; each satellite needs its own")
            lines[what, value] = line


def epoch_of_day(year: int, day: float) -> float:
    """Return ET, s, of a day of the year in UTC, which counts from 1."""
    midnight = (datetime(year, 1, 1) - datetime(2000, 1, 1, 12)).total_seconds()
    return float(et_of_utc(np.float64(midnight + (day - 1.0) * 86400.0)))


def element_set(
    source: Source,
    lines: Mapping[str, int],
    line: int | None,
    name: str,
    norad_id: int,
    epoch: float,
    values: Mapping[str, float],
    bstar: float,
    gravity: str,
    max_age_days: float,
) -> ElementSet:
    """Return the element set of checked numbers in degrees and revolutions a day; ValueError, with the line, for others.

    ``lines`` has the lines of fields outside of ``line``.
    """
    one_of("gravity", gravity, GRAVITIES)
    number("max_age_days", max_age_days, 0.0, unit="days")
    for field, (low, high, unit) in BOUNDS.items():
        if not low <= values[field] <= high:
            source.fail(
                lines.get(field, line), f"{field}={values[field]:g} must be a number in [{low:g}, {high:g}] {unit}".rstrip()
            )
    if not abs(bstar) <= LARGEST_BSTAR:
        source.fail(line, f"BSTAR={bstar:g} must be a number in [-{LARGEST_BSTAR:g}, {LARGEST_BSTAR:g}]")
    made = ElementSet(
        name=name,
        norad_id=norad_id,
        epoch=epoch,
        inclination=math.radians(values["inclination"]),
        node=math.radians(values["node"]),
        eccentricity=values["eccentricity"],
        perigee=math.radians(values["perigee"]),
        mean_anomaly=math.radians(values["mean anomaly"]),
        mean_motion=values["mean motion"] * 2.0 * math.pi / 1440.0,
        bstar=bstar,
        gravity=gravity,
        max_age_days=max_age_days,
    )
    axis = (MU_EARTH * (60.0 / made.mean_motion) ** 2) ** (1.0 / 3.0)
    if axis * (1.0 - made.eccentricity) < LOWEST_PERIGEE:
        perigee = (axis * (1.0 - made.eccentricity) - R_EARTH) / 1e3
        source.fail(line, f"{name!r} ({norad_id}) has decayed: its perigee is {perigee:.0f} km above the equator, below 80")
    try:
        made.teme_states(torch.tensor([epoch], dtype=torch.float64))
    except ValueError as error:
        source.fail(line, str(error))
    return made
