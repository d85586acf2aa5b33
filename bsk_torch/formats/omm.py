"""CCSDS Orbit Mean-Elements Messages (OMM): JSON, CSV and XML as CelesTrak and Space-Track write them.

Source: "Orbit Data Messages", CCSDS 502.0-B-3, section 4.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from bsk_torch.astro.element_sets import MAX_AGE_DAYS, ElementSet
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.formats.elements import check_satellites, element_set
from bsk_torch.formats.source import Source, read_source
from bsk_torch.sim.names import nearest
from bsk_torch.untrusted import Json, parse_json

__all__ = ["read_omm"]

MOST_SETS = 200_000
"""Most sets in a file."""

NUMBERS = {
    "INCLINATION": "inclination",
    "RA_OF_ASC_NODE": "node",
    "ECCENTRICITY": "eccentricity",
    "ARG_OF_PERICENTER": "perigee",
    "MEAN_ANOMALY": "mean anomaly",
    "MEAN_MOTION": "mean motion",
}
"""Fields of a message, in degrees and revolutions a day, and what messages call them."""

ALLOWED = {
    "CENTER_NAME": ("EARTH",),
    "REF_FRAME": ("TEME",),
    "TIME_SYSTEM": ("UTC",),
    "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4"),
    "EPHEMERIS_TYPE": ("0", "2"),
}
"""Fields with the meaning of the numbers, where present, and the values that SGP4 takes."""


class _Message(NamedTuple):
    line: int | None  # line of the text, None where the format has no lines
    place: str  # which message it is, where the format has no lines
    fields: Mapping[str, str]


def read_omm(source: str | Path, *, gravity: str = "wgs72", max_age_days: float = MAX_AGE_DAYS) -> list[ElementSet]:
    """Return the element sets of OMM messages in JSON, CSV or XML, which the first character tells apart.

    Args:
        source: Path of a file, or the text.
        gravity: See :func:`~bsk_torch.formats.tle.read_tle`.
        max_age_days: Likewise.

    Raises:
        OSError: If the file cannot be read.
        ValueError: For anything but messages; the message names file, line or entry, field and value.
    """
    text = read_source(source)
    first = text.text.lstrip()[0]
    messages = _xml(text) if first == "<" else _json(text) if first in "[{" else _csv(text)
    element_sets: list[ElementSet] = []
    names: list[tuple[int, str, object]] = []
    for message in messages:
        if len(element_sets) == MOST_SETS:
            text.fail(message.line, f"more than {MOST_SETS:,} element sets; split the file")
        made = _set(text, message, gravity, max_age_days)
        element_sets.append(made)
        names.append((message.line or len(element_sets), made.name, made.norad_id))
    if not element_sets:
        text.fail(None, "it holds no element set")
    check_satellites(text, names)
    return element_sets


def _set(text: Source, message: _Message, gravity: str, max_age_days: float) -> ElementSet:
    fields = message.fields

    def value(field: str) -> str:
        entry = fields.get(field)
        if entry is None or entry == "":
            text.fail(message.line, f"{message.place}{field} is missing; {nearest(field, fields)}")
        return entry

    def number(field: str) -> float:
        if not re.fullmatch(r"\s*[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*", value(field), re.A | re.I):
            text.fail(message.line, f"{message.place}{field}={value(field)!r:.40} must be a number")
        return float(value(field))

    for field, allowed in ALLOWED.items():
        if fields.get(field) and fields[field].strip().upper() not in allowed:
            text.fail(
                message.line, f"{message.place}{field}={fields[field]!r:.40} must be {' or '.join(allowed)}, which SGP4 takes"
            )
    if not re.fullmatch(r"\d{1,9}", value("NORAD_CAT_ID").strip(), re.A):
        text.fail(message.line, f"{message.place}NORAD_CAT_ID={value('NORAD_CAT_ID')!r:.40} must be a whole number")
    norad_id = int(value("NORAD_CAT_ID"))
    try:
        epoch = parse_utc(value("EPOCH").strip())
    except ValueError as error:
        text.fail(message.line, f"{message.place}EPOCH: {error}")
    name = fields.get("OBJECT_NAME", "").strip() or str(norad_id)
    numbers = {short: number(field) for field, short in NUMBERS.items()}
    try:
        return element_set(text, {}, message.line, name, norad_id, epoch, numbers, number("BSTAR"), gravity, max_age_days)
    except ValueError as error:
        if not message.place:
            raise
        raise ValueError(str(error).replace(": ", f": {message.place}", 1)) from None


def _json(text: Source) -> Iterator[_Message]:
    try:
        content = parse_json(text.text.encode(), Json)
    except ValueError as error:
        text.fail(None, str(error))
    entries = content if isinstance(content, list) else [content]
    for k, entry in enumerate(entries):
        if not isinstance(entry, dict):
            text.fail(None, f"entry [{k}] must be an object with the fields of a message")
        yield _Message(None, f"entry [{k}]: ", {key: "" if part is None else str(part) for key, part in entry.items()})


def _csv(text: Source) -> Iterator[_Message]:
    table = csv.reader(io.StringIO(text.text), strict=True)
    try:
        header = [field.strip() for field in next(table)]
        if "MEAN_MOTION" not in header:
            text.fail(1, f"{','.join(header)!r:.60} must be the header of OMM, with OBJECT_NAME, EPOCH, MEAN_MOTION and so on")
        for row in table:
            if row:
                if len(row) != len(header):
                    text.fail(table.line_num, f"it has {len(row)} fields, the header {len(header)}")
                yield _Message(table.line_num, "", dict(zip(header, row, strict=True)))
    except csv.Error as error:
        text.fail(table.line_num, str(error))


def parse_xml(text: Source) -> ElementTree.Element:
    """Return the root of an XML text; ValueError for a document type or entities, which could expand, and for other text."""
    if declaration := re.search(r"<!(DOCTYPE|ENTITY)", text.text, re.I):
        text.fail(text.text.count("\n", 0, declaration.start()) + 1, f"{declaration[0]!r} is not read: files of orbits have none")
    try:
        return ElementTree.fromstring(text.text.lstrip())  # a text, whatever encoding it declares
    except ElementTree.ParseError as error:
        text.fail(error.position[0], f"it is no XML: {error}")


def _xml(text: Source) -> Iterator[_Message]:
    for k, message in enumerate(parse_xml(text).iter("omm")):
        fields = {part.tag: (part.text or "").strip() for part in message.iter() if len(part) == 0}
        yield _Message(None, f"message {k}: ", fields)
