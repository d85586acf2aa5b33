"""``bsk-torch windows`` against Skyfield."""

import csv
import json

import numpy as np
import pytest
from scipy.optimize import brentq
from skyfield.api import EarthSatellite, load, wgs84
from typer.testing import CliRunner

from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.cli import app
from tests.formats.samples import EPOCH, FLEET, OPM

PLACES = """name,lat,lon,height
Helsinki,60.170,24.938,26
La Paz,-16.5,-68.15,3640
Singapore,1.352,103.82,15
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "fleet.tle").write_text(FLEET)
    (tmp_path / "places.csv").write_text(PLACES)
    return tmp_path


def run(folder, *options):
    arguments = [
        "--tle",
        str(folder / "fleet.tle"),
        "--targets",
        str(folder / "places.csv"),
        "--start",
        EPOCH,
        "--backend",
        "eager",
    ]
    return CliRunner().invoke(app, ["windows", *arguments, *options])


def skyfield_windows(hours, elevation):
    """Windows by satellite and place, s after the start, of those that do not touch its ends."""
    timescale, found = load.timescale(builtin=True), {}
    et = parse_utc(EPOCH)
    begin, end = (timescale.tdb_jd(2451545.0, (et + s) / 86400.0) for s in (0.0, 3600.0 * hours))
    lines = [line for line in FLEET.splitlines() if line[:2] in ("1 ", "2 ")]
    for k, name in enumerate(("GREENSAT-1 (A)", "HAWK 2 [x/y]", "52912")):
        satellite = EarthSatellite(*lines[2 * k : 2 * k + 2], None, timescale)
        for row in csv.DictReader(PLACES.splitlines()):
            site = wgs84.latlon(float(row["lat"]), float(row["lon"]), float(row["height"]))
            times, events = satellite.find_events(site, begin, end, altitude_degrees=elevation)

            def above(s, satellite=satellite, site=site):
                return (satellite - site).at(timescale.tdb_jd(2451545.0, (et + s) / 86400.0)).altaz()[0].degrees - elevation

            rough = [(time.tdb - begin.tdb) * 86400.0 for time, event in zip(times, events, strict=True) if event != 1]
            # find_events stops within half a second
            found[name, row["name"]] = [brentq(above, s - 2.0, s + 2.0, xtol=1e-3) for s in rough]
    return found


def test_windows_are_those_of_skyfield(files):
    assert run(files, "--hours", "6", "--out", str(files / "w.csv")).exit_code == 0
    found = {}
    with open(files / "w.csv") as text:
        for row in csv.DictReader(text):
            edges = [float(row["start_s"]), float(row["end_s"])]
            found.setdefault((row["satellite"], row["place"]), []).extend(s for s in edges if 0.0 < s < 21600.0)
    expected = {pair: edges for pair, edges in skyfield_windows(6.0, 10.0).items() if edges}
    assert found.keys() == expected.keys()
    for pair, edges in expected.items():
        # polar motion and UT1 - UTC, 0.04 s then, are left out: 20 m on the ground, 0.01 s, and more where passes graze the limit
        np.testing.assert_allclose(found[pair], edges, rtol=0, atol=0.05, err_msg=str(pair))


def test_json_and_standard_output_hold_the_same(files):
    assert run(files, "--hours", "2", "--out", str(files / "w.json")).exit_code == 0
    rows = json.loads((files / "w.json").read_text())
    lines = list(csv.DictReader(run(files, "--hours", "2").stdout.splitlines()))
    assert [row["start_utc"] for row in rows] == [row["start_utc"] for row in lines]
    assert list(rows[0]) == ["satellite", "place", "start_utc", "end_utc", "start_s", "end_s"]


def test_wrong_files_and_times_end_the_command(files):
    (files / "one.opm").write_text(OPM)
    (files / "bad.csv").write_text("name,lat,lon\nx,99,0\n")
    cases = (
        (("--start", "2021-01-01T00:00:00Z"), "max_age_days"),
        (("--out", "w.txt"), ".csv"),
        (("--tle", str(files / "one.opm")), "ephemeris"),
        (("--targets", str(files / "bad.csv")), "line 2"),
        (("--backend", "fast"), "eager"),
    )
    for options, word in cases:
        result = run(files, *options)
        assert result.exit_code != 0, options
        assert word in result.output, options
