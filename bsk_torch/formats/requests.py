"""Files of requests for images: YAML, JSON and CSV, read into plain tables.

A file is a list of requests, or a mapping with a single list, ``requests`` or ``tasks``; a CSV file has a line with the names of
its columns, and one line for each request. Fields, with further names in :data:`NAMES`:

===================  ========  =================================================================================================
``id``               required  text, different for each request
``latitude``         required  geodetic latitude on WGS84, degrees, -90 to 90
``longitude``        required  degrees, -180 to 180
``height``           0         height above the ellipsoid, m, -1,000 to 10,000
``release``          0         first time of a look: seconds since the start, or ISO 8601 with a time zone
``due``              none      last time, likewise
``duration``         0         time for which a look lasts, s
``sensors``          any       sensor type that may serve the request, or several: a list, in CSV separated by ``|``
``weight``           1         value of the request
``min_elevation``    0         least elevation of the satellite above the target, degrees, below 90
``max_off_nadir``    90        largest angle between nadir and target at the satellite, degrees, above 0
``name``                       text for people, which is not read
===================  ========  =================================================================================================

So ``tasks.yaml`` of the benchmark ``aeossp_standard`` (https://github.com/Mtrya/astro-reason) is such a file, too.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bsk_torch.formats.places import angle_hint
from bsk_torch.sim.names import nearest
from bsk_torch.untrusted import Json, Node, one_line, parse_json, read_bytes, read_yaml

MOST_BYTES, MOST_REQUESTS = 2**26, 100_000
"""Largest file, bytes, and most requests in it."""

MOST_VALUES = 40 * MOST_REQUESTS
"""Most values in a file in YAML: each field has a name and some."""

NAMES = {
    "id": ("task_id", "request_id"),
    "latitude": ("latitude_deg", "lat"),
    "longitude": ("longitude_deg", "lon"),
    "height": ("height_m", "altitude_m", "altitude"),
    "release": ("release_time", "release_s"),
    "due": ("due_time", "due_s"),
    "duration": ("required_duration_s", "duration_s"),
    "sensors": ("required_sensor_type", "sensor_type", "sensor"),
    "weight": ("priority",),
    "min_elevation": ("min_elevation_deg",),
    "max_off_nadir": ("max_off_nadir_deg",),
    "name": (),
}
"""Fields of requests, each with its other names."""

FIELD = {name: field for field, others in NAMES.items() for name in (field, *others)}

REQUIRED = ("id", "latitude", "longitude")
LISTS = ("requests", "tasks")

LATEST = 1e9  # bound of times, s since the start: 32 years

BOUNDS: dict[str, tuple[float, float, float, str]] = {
    "latitude": (math.nan, -90.0, 90.0, "degrees"),
    "longitude": (math.nan, -180.0, 180.0, "degrees"),
    "height": (0.0, -1000.0, 10000.0, "m"),
    "release": (0.0, -LATEST, LATEST, "s"),
    "due": (LATEST, -LATEST, LATEST, "s"),
    "duration": (0.0, 0.0, LATEST, "s"),
    "weight": (1.0, -1e15, 1e15, ""),
    "min_elevation": (0.0, 0.0, math.nextafter(90.0, 0.0), "degrees"),
    "max_off_nadir": (90.0, math.nextafter(0.0, 1.0), 90.0, "degrees"),
}
"""Default, smallest and largest number, and unit, of each field."""

TIMES = ("release", "due")


@dataclass(frozen=True)
class RequestTable:
    """T requests.

    Attributes:
        ids: Their names.
        values: Numbers of the fields in :data:`BOUNDS`, [T] float64 each; times are s since the start, :data:`LATEST` for none.
        sensors: Sensor types that may serve each, None for any.
    """

    ids: tuple[str, ...]
    values: Mapping[str, np.ndarray[Any, np.dtype[np.float64]]]
    sensors: tuple[tuple[str, ...] | None, ...]


class Entry(NamedTuple):
    """A request as it is written: where, its fields, and whether numbers are text there."""

    place: str
    fields: Mapping[str, object]
    textual: bool


def read_requests(path: str | Path, start: datetime | None = None) -> RequestTable:
    """Return the requests in a file, by its name: ``.yaml``, ``.yml``, ``.json`` or ``.csv``.

    Args:
        path: The file.
        start: Time from which seconds count, with a time zone; needed for times of the calendar. Leap seconds are not counted.

    Raises:
        OSError: If the file cannot be read.
        ValueError: For other content, with the file, the line or entry, the field, its value, and what is allowed.
    """
    path = Path(path)
    read = {".yaml": _yaml_entries, ".yml": _yaml_entries, ".json": _json_entries, ".csv": _csv_entries}
    if start is not None and start.tzinfo is None:
        raise ValueError(f"start={start!r} has no time zone; write start=datetime(..., tzinfo=timezone.utc)")
    if path.suffix.lower() not in read:
        raise ValueError(f"{str(path)!r} must be a file with requests, whose name ends with one of {sorted(read)}")
    try:
        entries: list[Entry] = []
        for entry in read[path.suffix.lower()](read_bytes(path, MOST_BYTES)):
            if len(entries) == MOST_REQUESTS:
                raise ValueError(f"it has more than {MOST_REQUESTS:,} requests")
            entries.append(entry)
        if not entries:
            raise ValueError("it has no requests")
        return _table(entries, start)
    except (ValueError, RecursionError) as error:
        raise ValueError(one_line(f"{str(path)!r}: {error}")) from None


# -- three kinds of files -----------------------------------------------------------------------------------------------------


def _json_entries(content: bytes) -> Iterator[Entry]:
    data: Json = parse_json(content, Json)
    prefix = LISTS[0]
    if isinstance(data, dict):
        prefix = _list_name(list(data))
        data = data[prefix]
    if not isinstance(data, list):
        raise ValueError(f"{prefix!r} is no list of requests")
    for k, fields in enumerate(data):
        if not isinstance(fields, dict):
            raise ValueError(f"{prefix}[{k}] is no request with fields such as 'id' and 'latitude'")
        yield Entry(f"{prefix}[{k}]", fields, False)


def _list_name(names: Sequence[str]) -> str:
    """Return the name of the only list in a file."""
    if len(names) != 1 or names[0] not in LISTS:
        raise ValueError(f"it holds {list(names)!r:.80} where a list 'requests' or 'tasks' must be alone")
    return names[0]


def _csv_entries(content: bytes) -> Iterator[Entry]:
    rows = csv.reader(io.StringIO(_text(content), newline=""), strict=True)
    try:
        header = [name.strip() for name in next(rows, [])]
        twice = {name for name in header if header.count(name) > 1}
        if twice:
            raise ValueError(f"line 1: column {sorted(twice)[0]!r} is there twice")
        for row in rows:
            if not row:
                continue
            if len(row) != len(header):
                raise ValueError(f"line {rows.line_num}: it has {len(row)} values, but there are {len(header)} columns")
            fields = {name: value.strip() for name, value in zip(header, row, strict=True) if value.strip()}
            if "sensors" in map(FIELD.get, fields):
                name = next(name for name in fields if FIELD.get(name) == "sensors")
                fields |= {name: fields[name].split("|") if "|" in fields[name] else fields[name]}  # type: ignore[dict-item]
            yield Entry(f"line {rows.line_num}", fields, True)
    except csv.Error as error:
        raise ValueError(f"line {rows.line_num}: {error}") from None


def _text(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start:,} is no UTF-8") from None


def _yaml_entries(content: bytes) -> Iterator[Entry]:
    """Yield the requests of YAML; numbers are text, so that an identifier may look like one."""
    listed = read_yaml(content, typed=False, most=MOST_VALUES)
    if isinstance(listed.value, dict):
        listed = listed.value[_list_name(list(listed.value))]
    if not isinstance(listed.value, list):
        raise ValueError(f"line {listed.line}: there is no list of requests")
    for node in listed.value:
        if not isinstance(node.value, dict):
            raise ValueError(f"line {node.line}: there is no request with fields such as 'id' and 'latitude'")
        yield Entry(f"line {node.line}", {name: _plain(value) for name, value in node.value.items()}, True)


def _plain(node: Node) -> object:
    """Return the text of a field, or its list of texts."""
    parts = [node] if not isinstance(node.value, list) else node.value
    if any(isinstance(part.value, dict | list) for part in parts):
        raise ValueError(f"line {node.line}: a list or mapping of YAML stands where text or a number must")
    return [part.value for part in parts] if isinstance(node.value, list) else node.value


# -- fields -------------------------------------------------------------------------------------------------------------------


def _table(entries: Sequence[Entry], start: datetime | None) -> RequestTable:
    values = {name: np.full(len(entries), default) for name, (default, *_) in BOUNDS.items()}
    places: dict[str, str] = {}
    sensors = []
    for k, entry in enumerate(entries):
        fields = _by_field(entry)
        try:
            name = _word("id", fields["id"])
            if name in places:
                raise ValueError(f"id={name!r} is that of {places[name]}, too")
            places[name] = entry.place
            for field in (name for name in BOUNDS if name in fields):
                values[field][k] = _number(field, fields[field], entry.textual, start)
            sensors.append(_sensors(fields.get("sensors")))
            release, due, duration = (values[field][k] for field in ("release", "due", "duration"))
            if due < release:
                raise ValueError(f"due={fields['due']!r} comes {release - due:g} s before the release")
            if duration > due - release:
                raise ValueError(f"duration={duration:g} s is longer than the {due - release:g} s from release to due time")
        except ValueError as error:
            raise ValueError(f"{entry.place}: {error}") from None
    return RequestTable(tuple(places), values, tuple(sensors))


def _by_field(entry: Entry) -> dict[str, object]:
    fields: dict[str, object] = {}
    for name, value in entry.fields.items():
        if name not in FIELD:
            raise ValueError(f"{entry.place}: {name!r:.80} is no field of a request; {nearest(name[:80], FIELD)}")
        if FIELD[name] in fields:
            raise ValueError(f"{entry.place}: {FIELD[name]!r} is there twice, by another name as {name!r}")
        if value is not None:
            fields[FIELD[name]] = value
    for name in REQUIRED:
        if name not in fields:
            raise ValueError(f"{entry.place}: the request lacks {name!r}")
    return fields


def _word(field: str, value: object) -> str:
    if not isinstance(value, str) or not value.isprintable() or not 0 < len(value) <= 200:
        raise ValueError(f"{field}={value!r:.80} must be printable text of 1 to 200 characters")
    return value


def _sensors(value: object) -> tuple[str, ...] | None:
    if value is None:
        return None
    listed = value if isinstance(value, list) else [value]
    if not listed:
        raise ValueError("sensors=[] is empty; leave it out for any sensor")
    return tuple(_word("sensors", name) for name in listed)


def _number(field: str, value: object, textual: bool, start: datetime | None) -> float:
    _, low, high, unit = BOUNDS[field]
    quantity = math.nan
    if isinstance(value, int | float) and not isinstance(value, bool):
        quantity = float(value)
    elif isinstance(value, str) and textual:
        try:
            quantity = float(value)
        except ValueError:
            quantity = math.nan
    if math.isnan(quantity) and field in TIMES and isinstance(value, str):
        quantity = _seconds(field, value, start)
    if not low <= quantity <= high:
        also = ", or a time of ISO 8601 with a zone" if field in TIMES else ""
        wrong = f"{field}={value!r:.80} must be a number in [{low:g}, {high:g}] {unit}".rstrip()
        raise ValueError(wrong + also + angle_hint(field, quantity))
    return quantity


def _seconds(field: str, value: str, start: datetime | None) -> float:
    """Return the time of the calendar in s since the start."""
    example = "2026-02-05T09:12:05Z"
    try:
        time = datetime.fromisoformat(f"{value[:-1]}+00:00" if value[-1:] in "zZ" and value[:-1] else value)
    except ValueError:
        raise ValueError(f"{field}={value!r:.80} must be seconds since the start, or a time like {example!r}") from None
    if time.tzinfo is None:
        raise ValueError(f"{field}={value!r} has no time zone; write one, as in {example!r} or '2026-02-05T10:12:05+01:00'")
    if start is None:
        raise ValueError(f"{field}={value!r} is a time of the calendar; say with start= from which time seconds count")
    return (time - start).total_seconds()
