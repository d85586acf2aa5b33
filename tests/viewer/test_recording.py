import dataclasses
import gzip
import json
import struct

import numpy as np
import pytest

from bsk_torch.viewer.recording import MAGIC, VERSION, decode, load
from tests.support.recordings import nadir_dcm, states, synthetic_recording


@pytest.fixture(scope="module")
def recording():
    return synthetic_recording()


def opened(content):
    """Header and payload of a file, read as VIEWER's page does."""
    raw = gzip.decompress(content)
    version, length = struct.unpack_from("<II", raw, len(MAGIC))
    start = len(MAGIC) + 8
    assert version == VERSION
    return json.loads(raw[start : start + length]), raw[start + length :]


def repacked(content, version=VERSION, **changes):
    """The file with another version or header."""
    header, payload = opened(content)
    text = json.dumps(header | changes).encode()
    text += b" " * (-(len(MAGIC) + 8 + len(text)) % 8)
    return gzip.compress(MAGIC + struct.pack("<II", version, len(text)) + text + payload)


def test_recording_is_read_as_it_was_written(recording):
    read = decode(recording.encode())
    assert dataclasses.replace(read, scenes=[], tracks=[]) == dataclasses.replace(recording, scenes=[], tracks=[])
    for part, other in zip((*read.scenes, *read.tracks), (*recording.scenes, *recording.tracks), strict=True):
        assert dataclasses.replace(part, arrays={}) == dataclasses.replace(other, arrays={})
        assert part.arrays.keys() == other.arrays.keys()
        for name in part.arrays:
            np.testing.assert_allclose(part.arrays[name], other.arrays[name], rtol=1e-6, atol=2e-5)


def test_same_recording_has_same_bytes(recording):
    assert recording.encode() == synthetic_recording().encode()
    assert decode(recording.encode()).encode() == recording.encode()


def test_arrays_lie_at_multiples_of_eight_bytes(recording):
    raw = gzip.decompress(recording.encode())
    header, payload = opened(recording.encode())
    assert (len(raw) - len(payload)) % 8 == 0
    assert len(payload) == header["payload_bytes"]
    assert {entry["offset"] % 8 for entry in header["arrays"].values()} == {0}


def test_precise_positions_keep_their_type(recording):
    header, _ = opened(recording.encode())
    assert header["arrays"]["t0/r_N"]["dtype"] == "f8"
    single = synthetic_recording()
    single.tracks[0].arrays["r_N"] = single.tracks[0].arrays["r_N"].astype("f4")
    assert opened(single.encode())[0]["arrays"]["t0/r_N"]["dtype"] == "f4"


def test_missing_attitudes_stay_missing():
    recording = synthetic_recording()
    recording.tracks[0].arrays["sigma"][5:, 1] = np.nan
    sigma = decode(recording.encode()).tracks[0].arrays["sigma"]
    assert np.isnan(sigma[5:, 1]).all()
    assert np.isfinite(sigma[:5]).all()


def test_attitudes_of_the_sample_face_the_earth(recording):
    sigma = decode(recording.encode()).tracks[0].arrays["sigma"][::100, 0].astype("f8")
    r_N, v_N = states(0, np.arange(0.0, 3001.0, 100.0))
    s2 = (sigma**2).sum(-1)[:, None, None]
    tilde = np.zeros((len(sigma), 3, 3))
    tilde[:, 0, 1], tilde[:, 0, 2], tilde[:, 1, 2] = -sigma[:, 2], sigma[:, 1], -sigma[:, 0]
    tilde -= np.swapaxes(tilde, 1, 2)
    BN = np.eye(3) + (8.0 * tilde @ tilde - 4.0 * (1.0 - s2) * tilde) / (1.0 + s2) ** 2
    assert np.abs(BN - nadir_dcm(r_N, v_N)).max() < 2e-4


def test_file_is_saved_and_loaded(recording, tmp_path):
    recording.save(tmp_path / "flight.bskview")
    assert load(tmp_path / "flight.bskview").title == recording.title
    with pytest.raises(ValueError, match=r"must end with '\.bskview'"):
        recording.save(tmp_path / "flight.json")


@pytest.mark.parametrize("keep", [0.01, 0.5, 0.999])
def test_cut_off_file_is_named_so(recording, keep, tmp_path):
    content = recording.encode()
    (tmp_path / "cut.bskview").write_bytes(content[: int(keep * len(content))])
    with pytest.raises(ValueError, match=r"cut\.bskview: the recording is cut off"):
        load(tmp_path / "cut.bskview")


def test_payload_that_ends_early_is_named_so(recording):
    header, _ = opened(recording.encode())
    with pytest.raises(ValueError, match="8 bytes are missing"):
        decode(repacked(recording.encode(), payload_bytes=header["payload_bytes"] + 8))


def test_other_version_names_both(recording):
    with pytest.raises(ValueError, match="version 7, and this bsk_torch reads version 1"):
        decode(repacked(recording.encode(), version=7))


@pytest.mark.parametrize(
    "content", [b"", b"<html></html>", gzip.compress(b"something else", mtime=0)], ids=["empty", "page", "other"]
)
def test_foreign_file_is_named_so(content):
    with pytest.raises(ValueError, match=r"cut off|not a recording of the viewer"):
        decode(content)


@pytest.mark.parametrize("changes", [{"tracks": []}, {"satellites": "none"}, {"arrays": {}}, {"scenes": [{"seed": 0}]}])
def test_damaged_header_is_named_so(recording, changes):
    with pytest.raises(ValueError, match="a damaged recording"):
        decode(repacked(recording.encode(), **changes))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("decision_action", np.full(20, 3), "decision_action must lie from -1 to 2"),
        ("event_target", np.full(6, 40), "event_target must lie from -1 to 39"),
        ("key_times", np.arange(51.0)[::-1], "key_times must be numbers that never decrease"),
        ("r_N", np.zeros((51, 3, 3)), r"r_N has the shape \[51, 3, 3\]"),
        ("decision_mask", np.zeros((20, 4)), "decision_mask has the shape"),
    ],
)
def test_contradictions_are_errors(name, value, message):
    recording = synthetic_recording()
    recording.tracks[0].arrays[name] = value
    with pytest.raises(ValueError, match=message):
        recording.encode()


def test_missing_and_unknown_arrays_are_errors():
    recording = synthetic_recording()
    recording.tracks[1].arrays["sigmas"] = recording.tracks[1].arrays.pop("sigma")
    with pytest.raises(ValueError, match=r"track 1: arrays \['sigma'\] are missing, and \['sigmas'\] are unknown"):
        recording.encode()
