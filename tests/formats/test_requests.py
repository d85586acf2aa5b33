"""Files of requests: three kinds, the same content, and what is wrong with others."""

from __future__ import annotations

import json
import math
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from bsk_torch.formats.requests import LATEST, MOST_REQUESTS, read_requests
from tests.support.refusals import check_refusals, refusal

START = datetime(2026, 4, 14, 8, 0, tzinfo=timezone.utc)

YAML = """\
# as of aeossp_standard
tasks:
- task_id: task_0001
  name: "Ba\\u011Fc\\u0131lar, TR"
  latitude_deg: 41.03903
  longitude_deg: 28.85671
  altitude_m: 12.5
  release_time: '2026-04-14T08:31:00Z'
  due_time: '2026-04-14T10:57:00+02:00'
  required_duration_s: 45
  required_sensor_type: visible
  weight: 5.0
- task_id: b
  latitude_deg: -1
  longitude_deg: 180
  release_time:
  required_sensor_type: [visible, infrared]
  max_off_nadir_deg: 30
"""
JSON = [
    {
        "id": "task_0001",
        "latitude": 41.03903,
        "longitude": 28.85671,
        "height": 12.5,
        "release": 1860,
        "due": 3420.0,
        "duration": 45,
        "sensors": "visible",
        "weight": 5.0,
    },
    {"id": "b", "latitude": -1, "longitude": 180, "sensors": ["visible", "infrared"], "max_off_nadir": 30, "due": None},
]
CSV = """\
id,lat,lon,height_m,release,due,duration,sensors,weight,max_off_nadir
task_0001,41.03903,28.85671,12.5,2026-04-14T08:31:00Z,3420,45,visible,5,
"b",-1,180,,,,,visible|infrared,,30
"""


def file(tmp_path, kind, content):
    path = tmp_path / f"requests.{kind}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(("kind", "content"), [("yaml", YAML), ("json", json.dumps(JSON)), ("csv", CSV)])
def test_three_kinds_of_files_hold_the_same(kind, content, tmp_path):
    read = read_requests(file(tmp_path, kind, content), START)
    assert read.ids == ("task_0001", "b")
    assert read.sensors == (("visible",), ("visible", "infrared"))
    expected = {
        "latitude": (41.03903, -1.0),
        "longitude": (28.85671, 180.0),
        "height": (12.5, 0.0),
        "release": (1860.0, 0.0),
        "due": (3420.0, LATEST),
        "duration": (45.0, 0.0),
        "weight": (5.0, 1.0),
        "min_elevation": (0.0, 0.0),
        "max_off_nadir": (90.0, 30.0),
    }
    assert {name: tuple(values) for name, values in read.values.items()} == expected


def test_zones_and_starts(tmp_path):
    path = file(tmp_path, "csv", "id,lat,lon,release\na,1,2,2026-04-14T08:31:00.5Z\n")
    other = START.astimezone(timezone(timedelta(hours=9)))
    assert read_requests(path, other).values["release"][0] == 1860.5
    assert read_requests(path, START + timedelta(days=1)).values["release"][0] == 1860.5 - 86400.0


def one(**fields):
    return {"id": "a", "latitude": 1.0, "longitude": 2.0} | fields


def test_wrong_entries(tmp_path):
    def of(*entries, start=START, kind="json"):
        content = json.dumps(list(entries)) if kind == "json" else entries[0]
        return lambda: read_requests(file(tmp_path, kind, content), start)

    def bad(field, value, *names):
        return refusal(of(one(), one(id="b") | {field: value}), ValueError, "requests.json", "requests[1]", field, *names)

    lacking = {"id": "a", "latitude": 1.0}
    check_refusals(
        bad("latitude", 91.0, 91.0, 90, "degrees"),
        bad("latitude", 147.0, 147.0, "exchanged"),
        bad("longitude", 200, 200, 180, "degrees", "200 is -160"),
        bad("longitude", 1.1e6, "meters"),
        bad("height", 2e4, 20000.0, "m"),
        bad("weight", "5", "'5'", "number"),
        bad("weight", True, True, "number"),
        bad("duration", -1, -1, "s"),
        bad("min_elevation", 90.0, 90.0, "degrees"),
        bad("max_off_nadir", 0, 0, "degrees"),
        bad("release", "2026-04-14T08:31:00", "2026-04-14T08:31:00", "time zone"),
        bad("release", "tomorrow", "'tomorrow'", "2026-02-05T09:12:05Z"),
        bad("due", "2026-13-14T08:31:00Z", "2026-13-14", "seconds"),
        bad("due", -5.0, -5.0, "release"),
        bad("sensors", [], "sensors"),
        bad("sensors", [1], "sensors", 1),
        bad("id", 7, 7, "text"),
        bad("dueration", 7, "'dueration'", "'duration'"),
        bad("lat", 7.0, "twice", "'lat'"),
        bad("id", "\x1b[2J", "printable"),
        refusal(of(one(due=100.0, release=50.0, duration=51.0)), ValueError, "requests[0]", "duration=51", "50 s"),
        refusal(of(one(), one()), ValueError, "requests[1]", "'a'", "requests[0]"),
        refusal(of(lacking), ValueError, "requests[0]", "'longitude'"),
        refusal(of(), ValueError, "no requests"),
        refusal(of("x"), ValueError, "requests[0]"),
        refusal(of(one(release="2026-04-14T08:31:00Z"), start=None), ValueError, "start="),
        refusal(of(one(), start=datetime(2026, 1, 1)), ValueError, "start", "time zone"),
        refusal(of('{"a": 1, "requests": []}', kind="JSON"), ValueError, "requests.JSON", "requests"),
        refusal(lambda: read_requests(tmp_path / "x.txt"), ValueError, "x.txt", ".csv", ".yaml"),
        refusal(lambda: read_requests(tmp_path / "missing.csv"), OSError, "missing.csv"),
    )


def test_wrong_lines(tmp_path):
    def of(kind, content):
        return lambda: read_requests(file(tmp_path, kind, content), START)

    head = "id,lat,lon\na,1,2\n"
    entry = "- id: a\n  lat: 1\n  lon: 2\n"
    bomb = "- &a [x, x]\n- &b [*a, *a]\n- [*b, *b]\n"
    check_refusals(
        refusal(of("csv", head + "b,1\n"), ValueError, "line 3", 2, 3),
        refusal(of("csv", head + "\nb,1,x\n"), ValueError, "line 4", "longitude='x'"),
        refusal(of("csv", "id,lat,lat\n"), ValueError, "line 1", "'lat'", "twice"),
        refusal(of("csv", 'id,lat,lon\n"a,1,2\n'), ValueError, "line 2"),
        refusal(of("csv", "id,lat,lon\n,1,2\n"), ValueError, "line 2", "'id'"),
        refusal(of("csv", b"id,lat,lon\n\xff,1,2\n"), ValueError, "byte 11", "UTF-8"),
        refusal(of("csv", ""), ValueError, "no requests"),
        refusal(of("yaml", entry + "- id: b\n  lat: 1\n  lon: 200\n"), ValueError, "line 4", "longitude='200'", 180),
        refusal(of("yaml", entry + "  lat: 3\n"), ValueError, "line 4", "'lat'", "twice"),
        refusal(of("yaml", entry + "- 7\n"), ValueError, "line 4", "'id'"),
        refusal(of("yaml", "requests: 7\n"), ValueError, "line 1", "list"),
        refusal(of("yaml", "a: []\n"), ValueError, "'a'", "'requests'"),
        refusal(of("yaml", "requests: []\nother: 1\n"), ValueError, "'other'"),
        refusal(of("yaml", "- id: {a: 1}\n"), ValueError, "line 1", "mapping"),
        refusal(of("yaml", "- id: !!python/name:os.system a\n"), ValueError, "line 1", "tag"),
        refusal(of("yaml", bomb), ValueError, "line 1"),
        refusal(of("yaml", "- id: &x a\n"), ValueError, "line 1"),
        refusal(of("yaml", entry + "- id: *x\n"), ValueError, "line 4"),
        refusal(of("yaml", "- id: [\n"), ValueError, "line"),
        refusal(of("yaml", ""), ValueError, "list"),
    )


def test_a_million_rows_are_refused_early(tmp_path):
    rows = "id,lat,lon\n" + "".join(f"{k},1,2\n" for k in range(MOST_REQUESTS + 1))
    check_refusals(refusal(lambda: read_requests(file(tmp_path, "csv", rows)), ValueError, "100,000 requests"))


def test_bounds_of_floats(tmp_path):
    path = file(tmp_path, "csv", f"id,lat,lon,min_elevation\na,1,2,{math.nextafter(90.0, 0.0)!r}\n")
    assert np.sin(np.radians(read_requests(path).values["min_elevation"][0])) <= 1.0
