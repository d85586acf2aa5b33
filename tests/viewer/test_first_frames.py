"""The first and the second frame of every view, drawn by the modules of the page in Node."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bsk_torch.viewer import page
from tests.support.recordings import ANGLE0, RATE, states, synthetic_recording

DRAWS = Path(__file__).with_name("first_frames.mjs")
TIMES = (0.0, 1210.0)
RADIUS = 6378136.6  # of the page, m

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="needs node")


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """By view and time: what the first and the second frame show."""
    path = tmp_path_factory.mktemp("flight") / "flight.bskview"
    synthetic_recording(targets=20, tracks=2).save(path)
    command = ["node", DRAWS, Path(page.__file__).with_name("page"), path, ",".join(map(str, TIMES))]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True, timeout=300).stdout)


def test_a_second_frame_shows_what_the_first_has_shown(frames):
    assert len(frames) == 3 * len(TIMES)
    assert [name for name, (first, second) in frames.items() if first != second] == []


@pytest.mark.parametrize("time", TIMES)
def test_the_map_shows_satellites_where_they_are(frames, time):
    circles = frames[f"map {time:g}"][0]["circles"]
    assert len(circles) == 2
    for satellite, shown in enumerate(circles):
        x, y, z = states(satellite, np.array([time]))[0][0]
        longitude = np.degrees(np.arctan2(y, x) - ANGLE0 - RATE * time)
        assert shown == pytest.approx([(longitude + 180.0) % 360.0 - 180.0, np.degrees(np.arctan2(z, np.hypot(x, y)))], abs=0.01)


@pytest.mark.parametrize("time", TIMES)
def test_the_globe_turns_the_earth_and_shows_satellites_where_they_are(frames, time):
    first = frames[f"globe {time:g}"][0]
    cos, sin = np.cos(ANGLE0 + RATE * time), np.sin(ANGLE0 + RATE * time)
    assert first["earth"][:8] == pytest.approx([cos, sin, 0.0, 0.0, -sin, cos, 0.0, 0.0])  # by columns: from P to N
    for satellite, shown in enumerate(first["crafts"]):
        assert np.array(shown) * RADIUS == pytest.approx(states(satellite, np.array([time]))[0][0], abs=1e3)


@pytest.mark.parametrize("time", TIMES)
def test_the_hill_view_names_the_distance(frames, time):
    (r0,), (r1,) = (states(satellite, np.array([time]))[0] for satellite in (0, 1))
    texts = [text for text, *_ in frames[f"hill {time:g}"][0]["texts"]]
    assert f"Sat1 · {np.linalg.norm(r1 - r0) / 1e3:.0f} km" in texts
