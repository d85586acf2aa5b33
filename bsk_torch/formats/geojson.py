"""Regions of the Earth's surface from GeoJSON (RFC 7946): polygons in degrees, with names and weights.

Positions are ``[longitude, latitude]`` on WGS84, in this order; edges are straight in longitude and latitude.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bsk_torch.formats.source import read_source
from bsk_torch.untrusted import Json, parse_json

__all__ = ["Region", "read_regions"]

MOST_VERTICES = 10**6
"""Most vertices of all regions of a file."""

LONGITUDE, LATITUDE = 180.0, 90.0
"""Bounds of coordinates, degrees."""

WGS84 = ("urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:OGC::CRS84", "EPSG:4326", "urn:ogc:def:crs:EPSG::4326")
"""Names of the coordinate system in files older than RFC 7946, which allows no other."""

Rings = tuple[np.ndarray, ...]
"""Boundary of a polygon and of its holes, [V, 2] each: longitude and latitude, degrees, the first vertex again at the end."""


class Region(NamedTuple):
    """A region of the Earth's surface.

    Attributes:
        name: Its name, which no other region of the file has.
        weight: Its weight, not negative.
        polygons: Its polygons, apart from each other, with longitudes from -180 to 180 degrees: those that cross the antimeridian
            are cut there, and those that contain a pole reach down or up to it.
    """

    name: str
    weight: float
    polygons: tuple[Rings, ...]


def read_regions(source: Path | str, name: str = "name", weight: str = "weight") -> list[Region]:
    """Return the regions of GeoJSON: a FeatureCollection, a Feature, a Polygon or a MultiPolygon.

    A ring whose longitude jumps by 180 to 360 degrees between two vertices crosses the antimeridian, and one that goes around
    the Earth contains the pole of its hemisphere. Heights are ignored.

    Args:
        source: File, or its text.
        name: Property with the name of a feature (default without one: ``"region-0"`` and so on).
        weight: Property with its weight (1 without one).

    Raises:
        OSError: If the file cannot be read.
        ImportError: Without the extra ``areas``.
        ValueError: For any other content; the message names the file, feature, polygon, ring and vertex, and what is allowed.
    """
    text = read_source(source)
    try:
        features = _features(parse_json(text.text.encode(), Json))
        regions = [_region(k, feature, name, weight) for k, feature in enumerate(features)]
        if not regions:
            raise ValueError("it has no features; at least one is needed")
        first: dict[str, int] = {}
        for k, region in enumerate(regions):
            if first.setdefault(region.name, k) != k:
                raise ValueError(f"features {first[region.name]} and {k} are both named {region.name!r}; names must differ")
    except ValueError as error:
        text.fail(None, str(error))
    return regions


def _features(content: Json) -> list[Json]:
    kind = _kind(content, "the file", ("FeatureCollection", "Feature", "Polygon", "MultiPolygon"))
    system = content.get("crs")
    if system is not None and not (isinstance(system, dict) and (system.get("properties") or {}).get("name") in WGS84):
        raise ValueError(f"its coordinate system 'crs' is {system!r:.100}; only longitude and latitude on WGS84 are allowed")
    if kind == "FeatureCollection":
        features = content.get("features")
        if not isinstance(features, list):
            raise ValueError(f"'features' is {features!r:.60}; it must be a list")
        most = sum(_count(feature) for feature in features)
    else:
        features = [content] if kind == "Feature" else [{"type": "Feature", "properties": {}, "geometry": content}]
        most = _count(features[0])
    if most > MOST_VERTICES:
        raise ValueError(f"it has {most:,} vertices; up to {MOST_VERTICES:,} are allowed, simplify its polygons")
    return features


def _count(feature: Json) -> int:
    """Return the number of lists of numbers within a feature."""
    stack, count = [feature], 0
    while stack:
        part = stack.pop()
        if isinstance(part, dict):
            stack += part.values()
        elif isinstance(part, list):
            if part and isinstance(part[0], int | float):
                count += 1
            else:
                stack += part
    return count


def _kind(value: Json, title: str, allowed: Sequence[str]) -> str:
    kind = value.get("type") if isinstance(value, dict) else None
    if kind not in allowed:
        raise ValueError(f"{title} has type {kind!r:.60}; allowed are {', '.join(allowed)}")
    return str(kind)


def _region(k: int, feature: Json, name: str, weight: str) -> Region:
    title = f"feature {k}"
    _kind(feature, title, ("Feature",))
    properties = feature.get("properties") or {}
    if not isinstance(properties, dict):
        raise ValueError(f"{title}: 'properties' is {properties!r:.60}; it must be an object")
    called = properties.get(name)
    if called is not None and (not isinstance(called, str) or not called.isprintable() or not called):
        raise ValueError(f"{title}: {name!r} is {called!r:.60}; it must be a printable text")
    title = title if called is None else f"{title} ({called!r:.60})"
    worth = properties.get(weight, 1.0)
    if isinstance(worth, bool) or not isinstance(worth, int | float) or worth < 0.0:
        raise ValueError(f"{title}: {weight!r} is {worth!r:.60}; it must be a number from 0 on")
    geometry = feature.get("geometry")
    kind = _kind(geometry, f"{title}: its geometry", ("Polygon", "MultiPolygon"))
    coordinates = geometry.get("coordinates")
    polygons = [coordinates] if kind == "Polygon" else coordinates
    if not isinstance(polygons, list) or not polygons:
        raise ValueError(f"{title}: its coordinates are {polygons!r:.60}; a list of polygons is needed")
    return Region(called or f"region-{k}", float(worth), _parts(title, polygons))


def _parts(title: str, polygons: Sequence[Json]) -> tuple[Rings, ...]:
    """Return the polygons of a region, cut at the antimeridian."""
    shapely = import_shapely()
    shapes = [_shape(shapely, f"{title}, polygon {p}", rings) for p, rings in enumerate(polygons)]
    turns = [(shapely.box(360.0 * k - LONGITUDE, -LATITUDE, 360.0 * k + LONGITUDE, LATITUDE), k) for k in (-1, 0, 1)]
    pieces = []
    for shape in shapes:
        west, _, east, _ = shape.bounds
        cut = [(shape, 0)] if west >= -LONGITUDE and east <= LONGITUDE else [(shape & turn, k) for turn, k in turns]
        pieces += [shapely.transform(part, lambda v, k=k: v - [360.0 * k, 0.0]) for part, k in cut]
    whole = shapely.union_all(pieces)
    area = sum(shape.area for shape in shapes)
    if len(shapes) > 1 and whole.area < (1.0 - 1e-9) * area:
        raise ValueError(f"{title}: its polygons overlap; those of a MultiPolygon must lie apart")
    pieces_with_area = [part for part in shapely.get_parts(whole) if part.geom_type == "Polygon" and part.area > 0.0]
    return tuple(tuple(shapely.get_coordinates(ring) for ring in (part.exterior, *part.interiors)) for part in pieces_with_area)


def _shape(shapely: Any, title: str, rings: Json) -> Any:
    """Return a polygon of shapely, without jumps of longitude, from the rings of a file."""
    if not isinstance(rings, list) or not rings:
        raise ValueError(f"{title} is {rings!r:.60}; a list of rings is needed, the boundary first")
    shell, *holes = (_unwrapped(f"{title}, ring {r}", _ring(f"{title}, ring {r}", ring)) for r, ring in enumerate(rings))
    outer = shapely.Polygon(shell)
    shape = shapely.Polygon(shell, [_shifted_into(shapely, outer, hole) for hole in holes])
    if not shape.is_valid:
        reason = shapely.is_valid_reason(shape)
        raise ValueError(f"{title} is not valid: {reason} (longitude, latitude); rings must neither cross nor overlap each other")
    if not shape.area > 0.0:
        raise ValueError(f"{title} has no area; its vertices lie on a line")
    return shape


def _ring(title: str, ring: Json) -> np.ndarray:
    """Return the vertices of a ring as they are in the file, [V, 2] degrees."""
    if not isinstance(ring, list) or len(ring) < 4:
        size = f"has {len(ring)} vertices" if isinstance(ring, list) else f"is {ring!r:.60}"
        raise ValueError(f"{title} {size}; at least 4 vertices are needed, the last of which repeats the first")
    for v, vertex in enumerate(ring):
        numbers = isinstance(vertex, list) and all(isinstance(x, int | float) and not isinstance(x, bool) for x in vertex)
        if not numbers or not 2 <= len(vertex) <= 3:
            raise ValueError(f"{title}, vertex {v} is {vertex!r:.60}; it must be [longitude, latitude], degrees")
    table = np.array([vertex[:2] for vertex in ring], dtype=float)
    for column, bound, word in ((1, LATITUDE, "latitude"), (0, LONGITUDE, "longitude")):
        if (wrong := np.abs(table[:, column]) > bound).any():
            v = int(wrong.argmax())
            swapped = np.abs(table[:, 0]).max() <= LATITUDE < np.abs(table[:, 1]).max() <= LONGITUDE
            hint = "; GeoJSON lists longitude first: they are probably swapped" if swapped else ""
            value = table[v, column]
            raise ValueError(f"{title}, vertex {v}: {word} {value:g} must lie in [{-bound:g}, {bound:g}] degrees{hint}")
    if (table[0] != table[-1]).any():
        raise ValueError(f"{title} is open: its first vertex {ring[0]} must be repeated at its end, which is {ring[-1]}")
    return table


def _unwrapped(title: str, ring: np.ndarray) -> np.ndarray:
    """Return a ring without jumps of longitude; one that goes around the Earth is closed over the pole."""
    step = np.diff(ring[:, 0])
    jumps = (np.abs(step) > 180.0) & (np.abs(step) < 360.0)  # 360: of a box, or at a pole
    turns = np.where(jumps, -360.0 * np.sign(step), 0.0).cumsum()
    longitude = ring[:, 0] + np.concatenate([[0.0], turns])
    open_ring = np.stack([longitude, ring[:, 1]], 1)
    around = longitude[-1] - longitude[0]
    if around == 0.0:
        return open_ring
    south, north = ring[:, 1].min(), ring[:, 1].max()
    if abs(around) != 360.0 or south < 0.0 < north:
        raise ValueError(
            f"{title} goes around the Earth at latitudes from {south:g} to {north:g} degrees, so it is open what it contains; "
            "one that goes around once in one hemisphere contains the pole of this one, and others must be cut"
        )
    pole = LATITUDE if north > 0.0 else -LATITUDE
    return np.concatenate([open_ring, [[longitude[-1], pole], [longitude[0], pole], open_ring[0]]])


def _shifted_into(shapely: Any, outer: Any, hole: np.ndarray) -> np.ndarray:
    """Return a hole, shifted by whole turns so that it lies within a boundary, if it does after any."""
    shifted = [hole + np.array([360.0 * k, 0.0]) for k in (0, 1, -1)]
    return next((ring for ring in shifted if outer.contains(shapely.Polygon(ring))), hole)


def import_shapely() -> Any:
    """Return the library of geometries; ImportError, which names the extra, without it."""
    try:
        import shapely
    except ImportError as error:
        raise ImportError("polygons need the library shapely: pip install bsk_torch[areas]") from error
    return shapely


def shapes(region: Region) -> Iterator[Any]:
    """Yield the polygons of a region as polygons of shapely, degrees."""
    shapely = import_shapely()
    return (shapely.Polygon(shell, holes) for shell, *holes in region.polygons)
