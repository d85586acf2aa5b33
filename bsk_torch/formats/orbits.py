"""Orbits of real satellites from a file of any format that is read."""

from __future__ import annotations

from pathlib import Path

from bsk_torch.astro.element_sets import MAX_AGE_DAYS, ElementSet, Ephemeris
from bsk_torch.formats.ccsds import read_ccsds
from bsk_torch.formats.omm import read_omm
from bsk_torch.formats.source import read_source
from bsk_torch.formats.tle import read_tle

__all__ = ["ElementSet", "Ephemeris", "read_orbits"]


def read_orbits(
    source: str | Path, *, gravity: str = "wgs72", max_age_days: float = MAX_AGE_DAYS
) -> list[ElementSet] | list[Ephemeris]:
    """Return the satellites of two-line sets, an OMM (JSON, CSV, XML), an OEM or an OPM, recognized by the first line.

    Args:
        source: Path of a file, or its text.
        gravity: Constants of SGP4 for element sets, see :func:`~bsk_torch.formats.tle.read_tle`.
        max_age_days: Largest age of element sets, likewise.

    Raises:
        OSError: If the file cannot be read.
        ValueError: For wrong content; the message names file, line, field and value.
    """
    first = read_source(source).text.lstrip().split("\n", 1)[0].strip()
    if first.startswith("CCSDS_O"):
        return read_ccsds(source)
    if first[0] in "<{[" or "MEAN_MOTION" in first:
        return read_omm(source, gravity=gravity, max_age_days=max_age_days)
    return read_tle(source, gravity=gravity, max_age_days=max_age_days)
