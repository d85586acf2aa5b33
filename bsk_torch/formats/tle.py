"""Two-line element sets (TLE), with or without a line of the name.

Source of the columns: "Two-Line Element Set Format", CelesTrak (T. S. Kelso), and Spacetrack Report #3.
"""

from __future__ import annotations

import re
from datetime import date
from pathlib import Path
from typing import NamedTuple

from sgp4.alpha5 import from_alpha5

from bsk_torch.astro.element_sets import MAX_AGE_DAYS, ElementSet
from bsk_torch.formats.elements import check_satellites, element_set, epoch_of_day
from bsk_torch.formats.source import Source, read_source

__all__ = ["read_tle"]

COLUMNS = 69
"""Length of a line of a set."""

PIVOT = 57
"""Years of two digits from here on are of the 20th century, that of Sputnik; earlier ones are of the 21st."""


class Column(NamedTuple):
    """A field of a line: first and last column, counted from 1, and the pattern of its text."""

    line: int
    first: int
    last: int
    pattern: str
    example: str


DECIMAL = r" *\d+\.\d*"
COLUMN_TABLE = {
    "catalog number": Column(1, 3, 7, r"[ A-HJ-NP-Z0-9][ 0-9]{3}[0-9]", "25544"),
    "epoch year": Column(1, 19, 20, r"[0-9]{2}", "26"),
    "epoch day": Column(1, 21, 32, DECIMAL, "103.92936350"),
    "BSTAR": Column(1, 54, 61, r"[ +-][ 0-9]{5}[ +-][0-9]", " 55914-4"),
    "ephemeris type": Column(1, 63, 63, r"[ 0-9]", "0"),
    "inclination": Column(2, 9, 16, DECIMAL, "98.1985"),
    "node": Column(2, 18, 25, DECIMAL, "143.5711"),
    "eccentricity": Column(2, 27, 33, r"[ 0-9]{6}[0-9]", "0064246"),
    "perigee": Column(2, 35, 42, DECIMAL, "173.9227"),
    "mean anomaly": Column(2, 44, 51, DECIMAL, "286.4737"),
    "mean motion": Column(2, 53, 63, DECIMAL, "14.36137850"),
}
"""Fields that SGP4 needs, and the type of the theory."""


def read_tle(source: str | Path, *, gravity: str = "wgs72", max_age_days: float = MAX_AGE_DAYS) -> list[ElementSet]:
    """Return the element sets of a file of two-line sets, or of its text.

    Args:
        source: Path of a file, or the text. The line before a set, if any, is the name of the satellite, also as ``0 NAME``; a
            satellite without one is named by its catalog number.
        gravity: Constants of SGP4: ``"wgs72"``, with which element sets are fitted, or ``"wgs84"``.
        max_age_days: Days from the epoch of a set beyond which no episode may start.

    Raises:
        OSError: If the file cannot be read.
        ValueError: For wrong lines; the message names file, line, field and value, and nothing is read by halves.
    """
    text = read_source(source)
    element_sets: list[tuple[int, ElementSet]] = []
    name: tuple[int, str] | None = None
    first: tuple[int, str] | None = None
    for number, raw in enumerate(text.text.splitlines(), 1):
        line = raw.rstrip()
        if not line:
            continue
        if first is not None:
            if not line.startswith("2 "):
                text.fail(number, f"{line[:20]!r} must be the second line of the set that begins in line {first[0]}")
            title = name[1] if name else ""
            element_sets.append((first[0], _set(text, title, first, (number, line), gravity, max_age_days)))
            first = name = None
        elif re.match(r"1 [ A-Z0-9]{5}", line) and (len(line) > 24 or re.match(r"1 [A-Z0-9 ]{5}[UCS] ", line)):
            first = number, line
        elif line.startswith("2 ") and len(line) > 24:
            text.fail(number, f"{line[:20]!r} is the second line of a set without its first line")
        elif name is not None:
            text.fail(number, f"{line[:20]!r} follows the name {name[1]!r} in line {name[0]}; a line that begins with '1 ' must")
        else:
            name = number, line.removeprefix("0 ").strip()
    if first is not None:
        text.fail(first[0], "the set ends after its first line")
    if name is not None:
        text.fail(name[0], f"{name[1][:20]!r} has no set; two lines that begin with '1 ' and '2 ' must follow")
    check_satellites(text, [(number, elements.name, elements.norad_id) for number, elements in element_sets])
    return [elements for _, elements in element_sets]


def _set(
    text: Source, name: str, first: tuple[int, str], second: tuple[int, str], gravity: str, max_age_days: float
) -> ElementSet:
    for number, line in (first, second):
        if len(line) != COLUMNS:
            text.fail(number, f"it has {len(line)} columns; a line of a set has {COLUMNS}, of which the last is the checksum")
        total = sum(int(c) if c in "0123456789" else c == "-" for c in line[:-1]) % 10
        if line[-1] != str(total):
            text.fail(number, f"checksum {line[-1]!r} must be {total}; the line is damaged")
    fields = {}
    for field, column in COLUMN_TABLE.items():
        number, line = (first, second)[column.line - 1]
        value = line[column.first - 1 : column.last]
        if not re.fullmatch(column.pattern, value, re.A):
            text.fail(number, f"{field}={value!r} in columns {column.first} to {column.last} must be like {column.example!r}")
        fields[field] = value
    if first[1][2:7] != second[1][2:7]:
        text.fail(second[0], f"catalog number {second[1][2:7]!r} must be that of the first line, {first[1][2:7]!r}")
    if fields["ephemeris type"] not in " 02":
        text.fail(first[0], f"ephemeris type={fields['ephemeris type']} is not a set for SGP4, which has 0 or 2")
    year = int(fields["epoch year"])
    day = float(fields["epoch day"])
    year += 1900 if year >= PIVOT else 2000
    if not 1.0 <= day < 1.0 + (date(year + 1, 1, 1) - date(year, 1, 1)).days:
        text.fail(first[0], f"epoch day={day:g} must be a day of the year {year}, from 1 on")
    mantissa = float(fields["BSTAR"][:6].replace(" ", "") + "e-5") if fields["BSTAR"][1:6].strip() else 0.0
    norad_id = from_alpha5(fields["catalog number"].strip())
    return element_set(
        text,
        {"inclination": second[0], "mean motion": second[0], "eccentricity": second[0]},
        first[0],
        name or str(norad_id),
        norad_id,
        epoch_of_day(year, day),
        {field: float(fields[field]) for field in ("inclination", "node", "perigee", "mean anomaly", "mean motion")}
        | {"eccentricity": float(f"0.{fields['eccentricity'].replace(' ', '0')}")},
        mantissa * 10.0 ** int(fields["BSTAR"][6:].replace(" ", "+")),
        gravity,
        max_age_days,
    )
