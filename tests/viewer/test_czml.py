"""CZML: structure, and positions and attitudes as Cesium interpolates them."""

import dataclasses
import json

import numpy as np
import pytest

from bsk_torch.viewer.czml import czml
from tests.support.recordings import SCRIPT, nadir_dcm, states, synthetic_recording


@pytest.fixture(scope="module")
def packets():
    return {packet["id"]: packet for packet in json.loads(czml(synthetic_recording(name=SCRIPT), 1))}


def test_document_comes_first_with_clock():
    first = json.loads(czml(synthetic_recording()))[0]
    assert first["id"] == "document"
    assert first["version"] == "1.0"
    assert first["clock"]["interval"] == "2020-11-30T09:18:50.816Z/2020-11-30T10:08:50.816Z"


def test_every_thing_has_a_packet(packets):
    assert {"satellite/0", "satellite/1", "station/0", "target/39", "link/0/1"} <= packets.keys()
    assert packets["satellite/0"]["name"] == SCRIPT + "0"
    assert "<" not in packets["satellite/0"]["description"]
    assert "lost at 3000 s (battery)" in packets["satellite/0"]["description"]


def test_positions_are_inertial(packets):
    position = packets["satellite/1"]["position"]
    rows = np.array(position["cartesian"]).reshape(-1, 4)
    assert position["referenceFrame"] == "INERTIAL"
    assert np.allclose(rows[:, 1:], states(1, rows[:, 0])[0], atol=1.0)


def test_orientations_turn_body_axes_to_the_earth(packets):
    rows = np.array(packets["satellite/0"]["orientation"]["unitQuaternion"]).reshape(-1, 5)
    time, (x, y, z, w) = rows[:, 0], rows[:, 1:].T
    assert np.allclose((rows[:, 1:] ** 2).sum(1), 1.0, atol=1e-5)
    third = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)], -1)  # of the body, in P
    BN = nadir_dcm(*states(0, time))
    angle = 0.5 + 7.2921159e-5 * time
    expected = np.stack(
        [
            np.cos(angle) * BN[:, 2, 0] + np.sin(angle) * BN[:, 2, 1],
            -np.sin(angle) * BN[:, 2, 0] + np.cos(angle) * BN[:, 2, 1],
            BN[:, 2, 2],
        ],
        -1,
    )
    assert np.abs(third - expected).max() < 1e-3


def test_other_futures_begin_where_they_part():
    recording = synthetic_recording(tracks=3)
    object.__setattr__(recording.tracks[2], "parent", 1)  # a branch of a branch, later
    object.__setattr__(recording.tracks[2], "branch", dataclasses.replace(recording.tracks[2].branch, time=900.0))
    found = {track: {packet["id"]: packet for packet in json.loads(czml(recording, track))} for track in range(3)}
    begins = {
        (track, other): found[track][f"track/{other}/satellite/0"]["availability"].partition("/")[0]
        for track in range(3)
        for other in range(3)
        if track != other
    }
    at_600, at_900 = "2020-11-30T09:28:50.816Z", "2020-11-30T09:33:50.816Z"
    assert begins == {(0, 1): at_600, (1, 0): at_600, (0, 2): at_600, (2, 0): at_600, (1, 2): at_900, (2, 1): at_900}
    future = found[0]["track/1/satellite/1"]
    assert (future["parent"], found[0]["track/1"]["name"]) == ("track/1", "branch 0")
    rows = np.array(future["position"]["cartesian"]).reshape(-1, 4)
    assert rows[0, 0] == 300.0
    assert future["path"]["material"] != found[0]["satellite/1"]["path"]["material"]
    scene = dataclasses.replace(recording.scenes[0])
    recording.scenes.append(scene)
    object.__setattr__(recording.tracks[2], "scene", 1)
    assert "track/2" not in czml(recording)


@pytest.mark.parametrize("targets", [0, 40])
def test_it_follows_the_schema(targets):
    czml3 = pytest.importorskip("czml3", reason="needs pip install --no-deps czml3==4.0.0")
    recording = synthetic_recording(targets=targets, name=SCRIPT)
    packets = json.loads(czml(recording))
    document = czml3.Document(packets=packets)  # forbids what it does not know
    written = json.loads(document.dumps())
    assert [packet["id"] for packet in written] == [packet["id"] for packet in packets]
    assert written[3]["position"]["cartesian"] == packets[3]["position"]["cartesian"]
    packets[-1]["polyLine"] = {}
    with pytest.raises(ValueError, match="polyLine"):
        czml3.Document(packets=packets)
