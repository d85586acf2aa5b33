"""Cells of areas: where they are, and which share of the surface each stands for."""

import json
import math

import numpy as np
import pytest

from bsk_torch.astro.geodetic import ECCENTRICITY2
from bsk_torch.formats.geojson import Region
from bsk_torch.tasks.areas import cap, cells, random_caps, read_areas, region_cells
from bsk_torch.tasks.areas.cells import on_ellipsoid
from tests.support.refusals import check_refusals, refusal

WORLD = Region("world", 1.0, ((np.array([[-180.0, -90], [180, -90], [180, 90], [-180, 90], [-180, -90]]),),))
HORSESHOE = Region("u", 2.0, ((np.array([[0.0, 0], [9, 0], [9, 9], [6, 9], [6, 3], [3, 3], [3, 9], [0, 9], [0, 0]]),),))


def degrees(area):
    """Geodetic longitude and latitude of the cells: on the ellipsoid, its tangent is (1 - e^2)^-1 times the geocentric one."""
    x, y, z = area.r_CP_P.T
    return np.degrees(np.stack([np.arctan2(y, x), np.arctan2(z, (1.0 - ECCENTRICITY2) * np.hypot(x, y))]))


def test_places_are_on_the_ellipsoid():
    erfa = pytest.importorskip("erfa")
    latitude, longitude = np.random.default_rng(0).uniform([[-math.pi / 2], [-math.pi]], [[math.pi / 2], [math.pi]], (2, 50))
    # erfa's WGS84 has the same two constants: rounding of 6.4e6 m
    assert np.abs(on_ellipsoid(latitude, longitude) - erfa.gd2gc(1, longitude, latitude, np.zeros(50))).max() < 1e-8


def test_shares_are_those_of_the_ellipsoid():
    pytest.importorskip("shapely")
    area = region_cells(WORLD, 1000e3)  # rows of 9 degrees
    e = math.sqrt(ECCENTRICITY2)

    def q(latitude):
        """Surface up to a latitude (Snyder, Map Projections, USGS 1395, equation 3-12)."""
        s = math.sin(math.radians(latitude))
        return (1.0 - e * e) * (s / (1.0 - e * e * s * s) - math.log((1.0 - e * s) / (1.0 + e * s)) / (2.0 * e))

    latitude = degrees(area)[1]
    for low, high in ((0.0, 27.0), (27.0, 54.0), (54.0, 90.0)):
        share = area.share[(latitude > low) & (latitude < high)].sum()
        # second order in cells of 9 degrees: (pi / 20)^2 / 24
        assert share == pytest.approx(0.5 * (q(high) - q(low)) / q(90.0), rel=(math.pi / 20.0) ** 2 / 24.0)
    assert area.share.sum() == pytest.approx(1.0)
    assert len(area.share) == pytest.approx(510.066e12 / 1000e3**2, rel=0.1)  # its surface; rows are divided at their longer edge


def test_cells_lie_within_their_region():
    shapely = pytest.importorskip("shapely")
    shape = shapely.Polygon(HORSESHOE.polygons[0][0])
    for cell, count in ((2000e3, 1), (333e3, 7), (50e3, 340)):
        area = region_cells(HORSESHOE, cell)
        assert (area.name, area.weight) == ("u", 2.0)
        assert shapely.contains(shape, shapely.points(degrees(area).T)).all()
        assert len(area.share) == pytest.approx(count, rel=0.1)
    assert area.share.max() < 2.0 * area.share.min()


def test_caps():
    area = cap("a", 60.0, 170.0, 400e3, 50e3)
    x, y = degrees(area)
    distance = np.linalg.norm(area.r_CP_P - on_ellipsoid(*np.deg2rad([60.0, 170.0])), axis=1)
    assert 390e3 < distance.max() < 402e3  # the last cell is within the edge; latitudes on a sphere are up to 0.5 percent off
    assert len(x) == round(math.pi * 400**2 / 50**2)
    apart = np.linalg.norm(area.r_CP_P[:, None] - area.r_CP_P, axis=-1) + 1e9 * np.eye(len(x))
    assert 35e3 < apart.min() < apart.min(1).max() < 65e3
    assert (np.abs(y - 60.0) < 4.0).all()
    first, again, other = random_caps(20, 100e3), random_caps(20, 100e3), random_caps(20, 100e3, seed=1)
    assert all((a.r_CP_P == b.r_CP_P).all() for a, b in zip(first, again, strict=True))
    assert not any(a.r_CP_P.shape == b.r_CP_P.shape and (a.r_CP_P == b.r_CP_P).all() for a, b in zip(first, other, strict=True))
    assert len(cap("small", 0.0, 0.0, 10.0, 100e3).share) == 1


def test_areas_of_a_file(tmp_path):
    pytest.importorskip("shapely")
    ring = [[179.0, 0.0], [-179.0, 0.0], [-179.0, 2.0], [179.0, 2.0], [179.0, 0.0]]
    entry = {
        "type": "Feature",
        "properties": {"name": "Fiji", "weight": 3},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    (tmp_path / "x.geojson").write_text(json.dumps(entry))
    (area,) = read_areas(tmp_path / "x.geojson", 111e3)
    assert (area.name, area.weight, len(area.share)) == ("Fiji", 3.0, 4)
    assert sorted(np.round(degrees(area)[0], 6)) == [-179.5, -179.5, 179.5, 179.5]


def test_wrong_arguments_are_refused(monkeypatch):
    pytest.importorskip("shapely")
    monkeypatch.setattr(cells, "MOST_CELLS", 100)
    check_refusals(
        refusal(lambda: region_cells(WORLD, 0.0), ValueError, "cell=0.0", "m"),
        refusal(lambda: region_cells(WORLD, 1e6), ValueError, "cell=1e+06 m", "'world'", "100 cells"),
        refusal(lambda: cap("a", 91.0, 0.0, 1e5, 1e4), ValueError, "latitude=91.0", "[-90, 90]"),
        refusal(lambda: cap("a", 0.0, 200.0, 1e5, 1e4), ValueError, "longitude=200.0", "[-180, 180]"),
        refusal(lambda: cap("a", 0.0, 0.0, 1e6, 1e3), ValueError, "cell=1000 m", "100 are allowed"),
        refusal(lambda: cap("", 0.0, 0.0, 1e5, 1e5), ValueError, "name"),
        refusal(lambda: random_caps(0, 1e5), ValueError, "count=0"),
        refusal(lambda: random_caps(2, 1e5, radius=(0.0, 1.0)), ValueError, "radius=0.0"),
    )
