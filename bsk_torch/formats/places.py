"""Lists of places on the Earth: CSV and GeoJSON files of cities, targets and ground stations, in degrees on WGS84."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bsk_torch.formats.source import Source, read_source
from bsk_torch.sim.names import nearest
from bsk_torch.untrusted import Json, parse_json

MOST_PLACES = 10**6
"""Largest number of places of a file."""

COLUMNS = {
    "name": ("name", "city", "city_ascii", "station", "target", "id", "title"),
    "latitude": ("latitude", "lat", "latitude_deg", "y"),
    "longitude": ("longitude", "lon", "lng", "long", "longitude_deg", "x"),
    "height": ("height", "altitude", "alt", "elevation", "elev", "altitude_m", "height_m"),
    "priority": ("priority", "weight"),
}
"""Headings of columns and properties that are read, without regard to case, the first that a file has."""

LOWEST, HIGHEST = -1e4, 1e7
"""Bounds of heights, m."""


@dataclass(frozen=True)
class PlaceList:
    """Places on the Earth.

    Attributes:
        names: Name of each; empty strings where the file has none.
        latitude: Geodetic latitude of each, degrees, from -90 to 90.
        longitude: Longitude of each, degrees, from -180 to 180.
        height: Height of each above the ellipsoid, m.
        priority: Priority of each; None without such a column.
    """

    names: list[str]
    latitude: list[float]
    longitude: list[float]
    height: list[float]
    priority: list[float] | None


Record = tuple[int | None, str, Mapping[str, object]]
"""Line in the file, description of a place, and its values as in the file, by the names of :data:`COLUMNS`."""


def read_csv(source: str | Path, columns: Mapping[str, str] | None = None) -> PlaceList:
    """Return the places of a CSV file with a line of headings; the separator is a comma, a semicolon or a tab.

    Args:
        source: File, or its text.
        columns: Headings to read in place of those of :data:`COLUMNS`, such as ``{"priority": "population"}``.

    Raises:
        OSError: If the file cannot be read.
        ValueError: For anything else that is wrong; the message names file, line, column, value and what is allowed.
    """
    text = read_source(source)
    head = text.text.partition("\n")[0]
    rows = csv.reader(text.text.splitlines(), delimiter=max(",;\t", key=head.count), strict=True)
    try:
        headings = [heading.strip() for heading in next(rows)]
        which = _columns(text, headings, columns or {})
        return _places(text, _csv_records(text, rows, headings, which), "priority" in which)
    except csv.Error as error:
        text.fail(rows.line_num, str(error))


def _columns(text: Source, headings: Sequence[str], columns: Mapping[str, str]) -> dict[str, int]:
    """Return the columns to read, by the names of :data:`COLUMNS`."""
    for name, heading in columns.items():
        if name not in COLUMNS:
            raise ValueError(f"columns has {name!r}; {nearest(name, COLUMNS)}")
        if heading not in headings:
            text.fail(1, f"there is no column {heading!r}; {nearest(heading, headings)}")
    lower = [heading.lower() for heading in headings]
    which = {name: lower.index(word) for name, words in COLUMNS.items() for word in reversed(words) if word in lower}
    which |= {name: headings.index(heading) for name, heading in columns.items()}
    for name in ("latitude", "longitude"):
        if name not in which:
            text.fail(1, f"no column for the {name}, such as {COLUMNS[name][0]!r}; give columns={{{name!r}: ...}}: {headings}")
    return which


def _csv_records(
    text: Source, rows: Iterable[Sequence[str]], headings: Sequence[str], which: Mapping[str, int]
) -> Iterator[Record]:
    for row in rows:
        line: int = rows.line_num  # type: ignore[attr-defined]
        if not row:
            continue
        if len(row) != len(headings):
            text.fail(line, f"it has {len(row)} values for {len(headings)} columns")
        yield line, "", {name: row[k].strip() for name, k in which.items()}


def read_geojson(source: str | Path) -> PlaceList:
    """Return the points of a GeoJSON file (RFC 7946): a FeatureCollection of points, whose order is longitude, latitude, height.

    Properties with the names of :data:`COLUMNS` give names and priorities.

    Raises:
        OSError: If the file cannot be read.
        ValueError: For anything else that is wrong, or other geometries; the message names file, feature, value and what is
            allowed.
    """
    text = read_source(source)
    content: Json = parse_json(text.text.encode(), Json)
    features = content.get("features") if isinstance(content, dict) else None
    if not isinstance(features, list) or content.get("type") != "FeatureCollection":
        text.fail(None, "it must be a GeoJSON FeatureCollection")
    records = [_point(text, k, feature) for k, feature in enumerate(features)]
    return _places(text, records, any("priority" in values for _, _, values in records))


def _point(text: Source, k: int, feature: Json) -> Record:
    title = f"feature {k}"
    geometry, properties = (feature.get(name) if isinstance(feature, dict) else None for name in ("geometry", "properties"))
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if not isinstance(geometry, dict) or kind != "Point":
        advice = "; bsk_torch.tasks.areas reads polygons" if kind in ("Polygon", "MultiPolygon") else ""
        text.fail(None, f"{title} has geometry {kind!r}; it must be a 'Point'{advice}")
    place = geometry.get("coordinates")
    if not isinstance(place, list) or len(place) not in (2, 3):
        text.fail(None, f"{title} has coordinates {place!r}; they must be [longitude, latitude], or with a height in m")
    lower = {str(key).lower(): value for key, value in (properties or {}).items()} if isinstance(properties, dict | None) else {}
    values = {
        name: lower[word] for name in ("name", "priority") for word in reversed(COLUMNS[name]) if lower.get(word) is not None
    }
    return None, f"{title}: ", dict(zip(("longitude", "latitude", "height"), place, strict=False)) | values


def _places(text: Source, records: Iterable[Record], has_priority: bool) -> PlaceList:
    places = PlaceList([], [], [], [], [] if has_priority else None)
    for line, title, values in records:
        if len(places.names) == MOST_PLACES:
            text.fail(line, f"it has more than {MOST_PLACES:,} places")
        name = str(values.get("name", ""))
        if not name.isprintable():
            text.fail(line, f"{title}name {name!r} has characters that cannot be printed")
        places.names.append(name)
        latitude = _number(text, line, title, "latitude", values["latitude"], -90.0, 90.0, "degrees")
        places.latitude.append(latitude)
        places.longitude.append(_number(text, line, title, "longitude", values["longitude"], -180.0, 180.0, "degrees"))
        height = values.get("height")
        places.height.append(0.0 if height in (None, "") else _number(text, line, title, "height", height, LOWEST, HIGHEST, "m"))
        if places.priority is not None:
            places.priority.append(_number(text, line, title, "priority", values.get("priority")))
    if not places.names:
        text.fail(None, "it has no places; there must be at least one")
    return places


def _number(
    text: Source, line: int | None, title: str, name: str, value: object, low: float = -1e300, high: float = 1e300, unit: str = ""
) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not low <= number <= high:
        bounds = f" from {low:g} to {high:g} {unit}" if unit else ""
        text.fail(line, f"{title}{name}={value!r} must be a number{bounds}{angle_hint(name, number)}")
    return number


def angle_hint(name: str, degrees: float) -> str:
    """Return what a wrong ``latitude`` or ``longitude`` may be, as the end of a message; an empty string for other names."""
    if name not in ("latitude", "longitude"):
        return ""
    if abs(degrees) > 360.0:
        return "; are these projected coordinates in meters?"
    if name == "latitude":
        return "; are latitude and longitude exchanged?" if 90.0 < abs(degrees) <= 180.0 else ""
    return f"; {degrees:g} is {degrees - math.copysign(360.0, degrees):g}" if abs(degrees) > 180.0 else ""
