"""Regions from GeoJSON: what is read, cut and refused."""

import json
import sys

import numpy as np
import pytest

from bsk_torch.formats import geojson
from bsk_torch.formats.geojson import read_regions
from tests.support.refusals import check_refusals, refusal

pytest.importorskip("shapely")

SQUARE = [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]
HOLE = [[2, 2], [2, 4], [4, 4], [4, 2], [2, 2]]


def polygon(*rings):
    return {"type": "Polygon", "coordinates": [list(ring) for ring in rings]}


def feature(geometry, **properties):
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def collection(*features):
    return {"type": "FeatureCollection", "features": list(features)}


@pytest.fixture
def read(tmp_path):
    def read(content, **options):
        file = tmp_path / "areas.geojson"
        file.write_text(content if isinstance(content, str) else json.dumps(content))
        return read_regions(file, **options)

    return read


def area(region):
    """Area in degrees, by the shoelace formula; holes run the other way round or not."""

    def shoelace(ring):
        x, y = ring.T
        return abs(float(np.dot(x[:-1], y[1:]) - np.dot(x[1:], y[:-1]))) / 2.0

    return sum(shoelace(shell) - sum(map(shoelace, holes)) for shell, *holes in region.polygons)


def test_names_weights_and_holes(read):
    two = {"type": "MultiPolygon", "coordinates": [[SQUARE, HOLE], [[[20, 0, 5.0], [21, 0, 5.0], [20, 1, 5.0], [20, 0, 5.0]]]]}
    first, second = read(collection(feature(two, name="A", weight=2), feature(polygon(SQUARE), priority=0.5)), weight="priority")
    assert (first.name, first.weight, second.name, second.weight) == ("A", 1.0, "region-1", 0.5)
    assert sorted(len(rings) for rings in first.polygons) == [1, 2]
    assert area(first) == pytest.approx(96.5)
    assert area(read(polygon(SQUARE))[0]) == area(read(feature(polygon(SQUARE)))[0]) == 100.0


@pytest.mark.parametrize(
    ("ring", "size", "edges"),
    [
        ([[170, 0], [-170, 0], [-170, 10], [170, 10], [170, 0]], 200.0, {-180.0, 180.0, 170.0, -170.0}),
        ([[-170, 0], [-170, 10], [170, 10], [170, 0], [-170, 0]], 200.0, {-180.0, 180.0, 170.0, -170.0}),
        ([[0, 70], [90, 70], [180, 70], [-90, 70], [0, 70]], 7200.0, {-180.0, 180.0, 90.0, 0.0, -90.0}),  # around the north pole
        ([[0, -70], [-90, -70], [-180, -70], [90, -70], [0, -70]], 7200.0, {-180.0, 180.0, 90.0, 0.0, -90.0}),
        ([[-180, -90], [180, -90], [180, -70], [-180, -70], [-180, -90]], 7200.0, {-180.0, 180.0}),  # cut, as RFC 7946 says
        ([[-180, -70], [-180, -90], [180, -90], [180, -70], [-180, -70]], 7200.0, {-180.0, 180.0}),
    ],
)
def test_antimeridian_and_poles(read, ring, size, edges):
    (region,) = read(polygon(ring))
    assert area(region) == pytest.approx(size)
    assert {float(x) for rings in region.polygons for part in rings for x in part[:, 0]} == edges


def test_a_hole_at_the_antimeridian(read):
    (region,) = read(
        polygon([[170, 0], [-170, 0], [-170, 10], [170, 10], [170, 0]], [[-178, 2], [-178, 4], [-176, 4], [-176, 2], [-178, 2]])
    )
    assert area(region) == pytest.approx(196.0)


def test_wrong_files_are_refused(read, monkeypatch):
    monkeypatch.setattr(geojson, "MOST_VERTICES", 12)
    third = [[0, 0], [1, 0], "x", [0, 0]]
    crossing, beyond = [[0, 0], [10, 10], [10, 0], [0, 10], [0, 0]], [[200, 2], [2, 49], [3, 48], [200, 2]]
    many = polygon(SQUARE, HOLE, HOLE)
    twice = collection(feature(polygon(SQUARE), name="A"), feature(polygon(SQUARE), name="A"))
    overlap = {"type": "MultiPolygon", "coordinates": [[SQUARE], [[[5, 5], [15, 5], [15, 15], [5, 5]]]]}
    check_refusals(
        refusal(lambda: read("{"), ValueError, "areas.geojson", "JSON"),
        refusal(lambda: read([1]), ValueError, "areas.geojson", "FeatureCollection", "Polygon"),
        refusal(lambda: read({"type": "Point", "coordinates": [0, 0]}), ValueError, "'Point'", "MultiPolygon"),
        refusal(lambda: read(collection()), ValueError, "no features"),
        refusal(lambda: read(collection(feature(None, name="A"))), ValueError, "feature 0 ('A')", "None", "Polygon"),
        refusal(lambda: read({"type": "FeatureCollection", "features": 3}), ValueError, "features", "3", "list"),
        refusal(lambda: read(collection(polygon(SQUARE))), ValueError, "feature 0", "'Polygon'", "Feature"),
        refusal(lambda: read(polygon(SQUARE[:-1])), ValueError, "ring 0 is open", [0, 0], [0, 10]),
        refusal(lambda: read(polygon(SQUARE, HOLE[:3])), ValueError, "ring 1", "3 vertices", "4"),
        refusal(lambda: read(polygon(third)), ValueError, "vertex 2", "'x'", "[longitude, latitude]"),
        refusal(lambda: read(polygon(crossing)), ValueError, "polygon 0", "Self-intersection[5 5]"),
        refusal(lambda: read(polygon(SQUARE, [[5, 5], [5, 15], [7, 15], [5, 5]])), ValueError, "polygon 0", "not valid"),
        refusal(lambda: read(polygon([[0, 0], [1, 1], [2, 2], [0, 0]])), ValueError, "polygon 0"),
        refusal(lambda: read(overlap), ValueError, "feature 0", "overlap"),
        refusal(lambda: read(polygon(beyond)), ValueError, "vertex 0", "longitude 200", "[-180, 180]"),
        refusal(lambda: read(polygon([[10, 100], [20, 100], [20, 110], [10, 100]])), ValueError, "latitude 100", "swapped"),
        refusal(lambda: read(polygon([[100, 100], [20, 100], [20, 110], [100, 100]])), ValueError, "latitude 100", "[-90, 90]"),
        refusal(lambda: read(polygon([[0, 0], [90, 10], [180, -10], [-90, 0], [0, 0]])), ValueError, "around the Earth", "pole"),
        refusal(lambda: read(feature(polygon(SQUARE), weight=-1)), ValueError, "'weight' is -1", "from 0"),
        refusal(lambda: read(feature(polygon(SQUARE), weight=True)), ValueError, "'weight' is True", "number"),
        refusal(lambda: read(feature(polygon(SQUARE), name=3)), ValueError, "'name' is 3", "text"),
        refusal(lambda: read(twice), ValueError, "features 0 and 1", "'A'"),
        refusal(lambda: read(many), ValueError, "15 vertices", "12"),
        refusal(
            lambda: read(polygon(SQUARE) | {"crs": {"type": "name", "properties": {"name": "EPSG:3857"}}}),
            ValueError, "EPSG:3857", "WGS84",
        ),
    )  # fmt: skip


def test_without_shapely_the_extra_is_named(read, monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(ImportError, match=r"bsk_torch\[areas\]"):
        read(polygon(SQUARE))
