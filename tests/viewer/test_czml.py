"""CZML: structure, and positions and attitudes as Cesium interpolates them."""

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


def test_errors():
    recording = synthetic_recording()
    with pytest.raises(IndexError, match="track=9"):
        czml(recording, 9)
    recording.scenes[0].PN0.clear()
    with pytest.raises(ValueError, match="has no Earth"):
        czml(recording)
