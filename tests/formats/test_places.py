"""Lists of places and ground stations in files, also in those that make_samples and station_table have written."""

import pytest

from bsk_torch import scene
from bsk_torch.formats import SAMPLES
from bsk_torch.formats.places import read_csv, read_geojson
from bsk_torch.formats.stations import ground_stations, read_stations, station_names
from tests.support.refusals import check_refusals, refusal

CITIES = 'city,lat,lng,population\n"Alphaville, North",48.86,2.35,2100000\nBetatown,-33.87,151.21,5300000\n'


def points(*coordinates, properties=None, kind="Point"):
    import json

    features = [
        {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": place}} for place in coordinates
    ]
    return json.dumps({"type": "FeatureCollection", "features": features})


def test_csv(tmp_path):
    places = read_csv(CITIES)
    assert places.names == ["Alphaville, North", "Betatown"]
    assert (places.latitude, places.longitude, places.height) == ([48.86, -33.87], [2.35, 151.21], [0.0, 0.0])
    assert places.priority is None
    path = tmp_path / "cities.csv"
    path.write_text("\ufeff" + CITIES, encoding="utf-8")
    assert read_csv(path, {"priority": "population"}).priority == [2.1e6, 5.3e6]
    table = read_csv("Lat;Lon;Alt;Name;Weight\n1;2;300;A;0.5\n\n-1;-2;;B;1\n")
    assert (table.height, table.priority, table.names) == ([300.0, 0.0], [0.5, 1.0], ["A", "B"])


def test_geojson():
    places = read_geojson(points([2.35, 48.86], [151.21, -33.87, 58.0], properties={"Name": "x", "weight": 2}))
    assert (places.latitude, places.longitude, places.height) == ([48.86, -33.87], [2.35, 151.21], [0.0, 58.0])
    assert (places.names, places.priority) == (["x", "x"], [2.0, 2.0])
    assert read_geojson(points([0.0, 0.0])).names == [""]


def test_targets_have_the_names_and_positions_of_the_file():
    targets = scene.Targets.from_csv(CITIES, {"priority": "population"})
    same = scene.Targets.from_geodetic([48.86, -33.87], [2.35, 151.21], priority=[2.1e6, 5.3e6])
    assert targets.target_names == ["Alphaville, North", "Betatown"]
    assert targets.positions.equal(same.positions)
    assert targets.priorities == [2.1e6, 5.3e6]
    assert targets.vertical == same.vertical == "wgs84"
    assert scene.Targets.from_geojson(points([2.35, 48.86]), priority=3.0).priorities == 3.0
    assert scene.Targets.from_geojson(points([2.35, 48.86])).target_names == ["tgt-0"]


def test_wrong_files_are_refused_by_line_and_value():
    row = "name,lat,lon\nA,1,2\n"
    check_refusals(
        refusal(
            lambda: read_csv("name,lat,lon\nA,151,2\n"), ValueError, "line 2", "latitude='151'", "from -90 to 90", "exchanged"
        ),
        refusal(lambda: read_csv("name,lat,lon\nA,1,200\n"), ValueError, "line 2", "longitude='200'", "-180 to 180"),
        refusal(lambda: read_csv(row + "B,1\n"), ValueError, "line 3", "2 values", "3 columns"),
        refusal(lambda: read_csv(row + "B,x,1\n"), ValueError, "line 3", "latitude='x'"),
        refusal(lambda: read_csv(row + "B,nan,1\n"), ValueError, "line 3", "latitude='nan'"),
        refusal(lambda: read_csv("name,latt,lon\nA,1,2\n"), ValueError, "line 1", "latitude", "columns="),
        refusal(lambda: read_csv(row, {"priority": "nam"}), ValueError, "'nam'", "'name'"),
        refusal(lambda: read_csv(row, {"latitud": "lat"}), ValueError, "'latitud'", "'latitude'"),
        refusal(lambda: read_csv("name,lat,lon\n"), ValueError, "at least one"),
        refusal(lambda: read_csv("name,lat,lon\nA\x1b[2J,1,2\n"), ValueError, "line 2", "name"),
        refusal(lambda: read_geojson("[]"), ValueError, "FeatureCollection"),
        refusal(lambda: read_geojson(points([48.86, 97.0])), ValueError, "feature 0", "latitude=97.0", "exchanged"),
        refusal(
            lambda: read_geojson(points([[0.0, 0.0]], kind="Polygon")),
            ValueError,
            "feature 0",
            "'Polygon'",
            "bsk_torch.tasks.areas",
        ),
        refusal(lambda: read_geojson(points([1.0])), ValueError, "feature 0", "[longitude, latitude]"),
        refusal(lambda: read_geojson(points([1.0, True])), ValueError, "feature 0", "latitude=True"),
        refusal(lambda: scene.Targets.from_geodetic([1.0], [200.0]), ValueError, "longitude of target 0", "200", "180 degrees"),
        refusal(lambda: scene.Targets.from_geodetic([147.0], [20.0]), ValueError, "latitude of target 0", "exchanged"),
        refusal(lambda: scene.Targets.from_geodetic([1.0, 2.0], [20.0]), ValueError, "latitude has 2", "longitude 1"),
        refusal(lambda: scene.Targets.from_geodetic([1.0], [2.0], 1e8), ValueError, "height", "target 0"),
        refusal(lambda: scene.Targets.from_geodetic(1.0, [2.0]), ValueError, "latitude", "[T]"),
        refusal(lambda: scene.Targets([[7e6, 0.0, 0.0]], vertical="north"), ValueError, "vertical='north'", "wgs84"),
    )


def test_sample_files_are_read():
    assert len(read_csv(SAMPLES / "cities.csv").names) == 100


def test_ground_stations():
    assert ground_stations("Svalbard", "Troll")[0] == {"name": "Svalbard", "lat": 78.23, "long": 15.41, "elev": 0.0}
    assert len(station_names()) == len({*station_names()}) > 50
    assert read_stations("station,lat,lon,elev\nA,10,20,30\n") == [{"name": "A", "lat": 10.0, "long": 20.0, "elev": 30.0}]
    check_refusals(
        refusal(lambda: ground_stations("Svalbrd"), ValueError, "'Svalbrd'", "'Svalbard'"),
        refusal(lambda: read_stations("name,lat,lon\nA,1,2\nA,3,4\n"), ValueError, "2 stations", "'A'"),
    )


@pytest.mark.parametrize("text", ["name,lat,lon\n" + "A,1,2\n" * 3, "name;lat;lon\r\nA;1;2\r\nB;1;2\r\n"])
def test_names_of_targets_may_repeat_and_lines_may_end_as_they_like(text):
    assert len(read_csv(text).names) == text.count("1")
