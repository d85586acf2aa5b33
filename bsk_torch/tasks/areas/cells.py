"""Areas as cells: points on the WGS84 ellipsoid, each of which stands for a share of the surface of its area.

Cells are made once, on the CPU; simulations read them as tables.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from bsk_torch._checks import number, text, whole
from bsk_torch.astro.geodetic import ECCENTRICITY2, SEMI_MAJOR_AXIS, geodetic_to_fixed
from bsk_torch.formats.geojson import Region, import_shapely, read_regions, shapes

MOST_CELLS = 10_000
"""Most cells of an area."""

GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
"""Angle between successive points of a sunflower, rad."""


class Area(NamedTuple):
    """An area of C cells.

    Attributes:
        name: Its name.
        weight: Value of seeing all of it.
        r_CP_P: Earth-fixed positions of its cells, [C, 3] m.
        share: Share of its surface that each cell stands for, [C]; they add up to 1.
    """

    name: str
    weight: float
    r_CP_P: np.ndarray
    share: np.ndarray


def on_ellipsoid(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Return Earth-fixed positions, [..., 3] m, of geodetic latitudes and longitudes, rad, on the WGS84 ellipsoid."""
    phi, lam = torch.tensor(np.asarray(latitude)), torch.tensor(np.asarray(longitude))
    return geodetic_to_fixed(phi, lam, torch.zeros_like(phi)).numpy()


def surface_density(latitude: np.ndarray) -> np.ndarray:
    """Return the surface of the WGS84 ellipsoid per squared radian of geodetic latitude and longitude, m^2.

    ``M N cos lat`` with the radii of curvature N and ``M = a (1 - e^2) / (1 - e^2 sin^2 lat)^(3/2)``.
    """
    return SEMI_MAJOR_AXIS**2 * (1.0 - ECCENTRICITY2) * np.cos(latitude) / (1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2) ** 2


def region_cells(region: Region, cell: float) -> Area:
    """Return a region as cells of about ``cell`` by ``cell`` m; those at its edges are cut.

    A cell is the part of the region between two parallels and two meridians, and its point is the centroid, or a point
    within where the centroid is outside. Its surface is the area in latitude and longitude times the density at the centroid,
    which is right to second order in the size of the cell.

    Raises:
        ValueError: For a cell that is not positive, or so small that there are more than :data:`MOST_CELLS`.
        ImportError: Without the extra ``areas``.
    """
    size = number("cell", cell, 1.0, 1e7, unit="m")
    shapely = import_shapely()
    pieces: list[Any] = []
    for shape in shapes(region):
        west, south, east, north = shape.bounds
        for strip in _divided(shapely, shape, 1, _edges(south, north, size)):
            west, south, east, north = strip.bounds
            widest = 0.0 if south < 0.0 < north else math.radians(min(abs(south), abs(north)))
            pieces += _divided(shapely, strip, 0, _edges(west, east, size / max(math.cos(widest), 1e-6)))
            if len(pieces) > MOST_CELLS:
                raise ValueError(
                    f"cell={cell:g} m divides {region.name!r} into more than {MOST_CELLS:,} cells; a larger cell is needed"
                )
    centers = shapely.centroid(pieces)
    outside = ~shapely.contains(pieces, centers)
    centers[outside] = shapely.point_on_surface(np.array(pieces)[outside])
    longitude, latitude = np.deg2rad(shapely.get_coordinates(centers)).T
    surface = shapely.area(pieces) * surface_density(latitude)
    return Area(region.name, region.weight, on_ellipsoid(latitude, longitude), surface / surface.sum())


def _edges(low: float, high: float, size: float) -> np.ndarray:
    """Return the edges, degrees, of equal intervals of about ``size`` m on a great circle."""
    count = max(1, round(math.radians(high - low) * SEMI_MAJOR_AXIS / size))
    return np.linspace(low, high, count + 1)


def _divided(shapely: Any, shape: Any, axis: int, edges: np.ndarray) -> Iterator[Any]:
    """Yield what is left of a shape between neighboring edges, by halves, so that each vertex is cut few times."""
    if shape.area <= 0.0:
        return
    if len(edges) == 2:
        yield shape
        return
    middle = len(edges) // 2
    for part in (edges[: middle + 1], edges[middle:]):
        box = [-1e3, -1e3, 1e3, 1e3]
        box[axis], box[axis + 2] = part[0], part[-1]
        yield from _divided(shapely, shape & shapely.box(*box), axis, part)


def cap(name: str, latitude: float, longitude: float, radius: float, cell: float, weight: float = 1.0) -> Area:
    """Return a round area as cells of equal surface, about ``cell`` by ``cell`` m, on a sunflower's spiral.

    Args:
        name: Its name.
        latitude: Geodetic latitude of its center, degrees.
        longitude: Longitude of its center, degrees.
        radius: Its radius, m, on a sphere of the equatorial radius.
        cell: Side of a cell, m.
        weight: See :class:`Area`.

    Raises:
        ValueError: For a wrong argument, or more than :data:`MOST_CELLS` cells.
    """
    center = (
        math.radians(number("latitude", latitude, -90.0, 90.0)),
        math.radians(number("longitude", longitude, -180.0, 180.0)),
    )
    angle = number("radius", radius, 1.0, 1e7, unit="m") / SEMI_MAJOR_AXIS
    size = number("cell", cell, 1.0, 1e7, unit="m")
    count = max(1, round(2.0 * math.pi * (1.0 - math.cos(angle)) * (SEMI_MAJOR_AXIS / size) ** 2))
    if count > MOST_CELLS:
        raise ValueError(f"cell={cell:g} m divides {name!r} into {count:,} cells; up to {MOST_CELLS:,} are allowed")
    k = np.arange(count)
    height = 1.0 - (1.0 - math.cos(angle)) * (k + 0.5) / count
    out, turn = np.sqrt(1.0 - height**2), GOLDEN * k
    up, east, north = _local(*center)
    point = height[:, None] * up + out[:, None] * (np.cos(turn)[:, None] * east + np.sin(turn)[:, None] * north)
    r_CP_P = on_ellipsoid(np.arcsin(point[:, 2].clip(-1.0, 1.0)), np.arctan2(point[:, 1], point[:, 0]))
    return Area(text("name", name), number("weight", weight, 0.0), r_CP_P, np.full(count, 1.0 / count))


def _local(latitude: float, longitude: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the directions up, east and north at a place."""
    (sin, cos), (s, c) = ((math.sin(x), math.cos(x)) for x in (latitude, longitude))
    return np.array([cos * c, cos * s, sin]), np.array([-s, c, 0.0]), np.array([-sin * c, -sin * s, cos])


def read_areas(path: Path | str, cell: float, name: str = "name", weight: str = "weight") -> list[Area]:
    """Return the regions of a GeoJSON file as areas; see :func:`read_regions` and :func:`region_cells`, also for errors."""
    return [region_cells(region, cell) for region in read_regions(path, name, weight)]


def random_caps(
    count: int,
    cell: float,
    radius: tuple[float, float] = (100e3, 400e3),
    most_latitude: float = 75.0,
    seed: int = 0,
) -> list[Area]:
    """Return round areas at random places, uniform by surface between two parallels, with the same numbers for the same seed.

    Args:
        count: Number of areas, named ``"area-0"`` and so on.
        cell: Side of a cell, m.
        radius: Smallest and largest radius, m; radii are uniform between them.
        most_latitude: Largest latitude of centers, north and south, degrees.
        seed: Seed of numpy's generator.

    Raises:
        ValueError: For a wrong argument.
    """
    numbers = np.random.default_rng(seed).random((whole("count", count, 1), 3))
    low, high = (number("radius", bound, 1.0, 1e7, unit="m") for bound in radius)
    top = math.sin(math.radians(number("most_latitude", most_latitude, 0.0, 90.0)))
    latitude, longitude = np.degrees(np.arcsin(top * (2.0 * numbers[:, 0] - 1.0))), 360.0 * numbers[:, 1] - 180.0
    places = zip(latitude, longitude, low + (high - low) * numbers[:, 2], strict=True)
    return [cap(f"area-{k}", float(lat), float(lon), float(size), cell) for k, (lat, lon, size) in enumerate(places)]


def padded(areas: Sequence[Area], far: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of all areas as tables, [L, C, 3] m and shares [L, C]; padding is ``far`` m away, with share zero."""
    most = max(len(area.share) for area in areas)
    r_CP_P, share = np.full((len(areas), most, 3), far), np.zeros((len(areas), most))
    for k, area in enumerate(areas):
        r_CP_P[k, : len(area.share)], share[k, : len(area.share)] = area.r_CP_P, area.share
    return r_CP_P, share
