import dataclasses
import gzip
import json
import struct

import numpy as np
import pytest

from bsk_torch.recording.recording import BITS, MAGIC, SCENE_ARRAYS, TRACK_ARRAYS, VERSION, decode, load
from tests.support.recordings import nadir_dcm, states, synthetic_recording
from tests.support.refusals import check_refusals, refusal


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
            rounded = (SCENE_ARRAYS | TRACK_ARRAYS)[name].rounded
            np.testing.assert_allclose(part.arrays[name], other.arrays[name], rtol=2.0**-BITS if rounded else 1e-6, atol=2e-5)


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


def test_rejects_files_of_others(recording, tmp_path):
    def cut(keep):
        (tmp_path / "cut.bskview").write_bytes(content[: int(keep * len(content))])
        load(tmp_path / "cut.bskview")

    content, damaged = recording.encode(), "damaged recording"
    bytes_kept = opened(content)[0]["payload_bytes"]
    header = lambda **changes: decode(repacked(content, **changes))
    other = gzip.compress(b"something else", mtime=0)
    table = [
        *(refusal(lambda keep=keep: cut(keep), ValueError, "cut.bskview", "cut off") for keep in (0.01, 0.5, 0.999)),
        refusal(lambda: header(payload_bytes=bytes_kept + 8), ValueError, "cut off", "8 bytes"),
        refusal(lambda: header(version=7), ValueError, "version 7", "version 1"),
        *(refusal(lambda file=file: decode(file), ValueError, "viewer") for file in (b"", b"<html></html>", other)),
        refusal(lambda: header(tracks=[]), ValueError, damaged, "tracks=[]"),
        refusal(lambda: header(satellites="none"), ValueError, damaged),
        refusal(lambda: header(arrays={}), ValueError, damaged, "'targets_P'"),
        refusal(lambda: header(scenes=[{"seed": 0}]), ValueError, damaged, "scenes[0] lacks", "'et'"),
    ]
    check_refusals(table)


def test_rejects_arrays_that_do_not_fit():
    def changed(**arrays):
        recording = synthetic_recording()
        recording.tracks[0].arrays.update(arrays)
        recording.encode()

    def renamed():
        recording = synthetic_recording()
        recording.tracks[1].arrays["sigmas"] = recording.tracks[1].arrays.pop("sigma")
        recording.encode()

    table = [
        refusal(lambda: changed(decision_action=np.full(20, 3)), ValueError, "track 0", "decision_action", "-1 to 2"),
        refusal(lambda: changed(event_target=np.full(6, 40)), ValueError, "track 0", "event_target", "-1 to 39"),
        refusal(lambda: changed(key_times=np.arange(51.0)[::-1]), ValueError, "track 0", "key_times"),
        refusal(lambda: changed(r_N=np.zeros((51, 3, 3))), ValueError, "track 0", "r_N", [51, 3, 3]),
        refusal(lambda: changed(decision_mask=np.zeros((20, 4))), ValueError, "track 0", "decision_mask", [20, 4]),
        refusal(renamed, ValueError, "track 1", ["sigma"], ["sigmas"]),
    ]
    check_refusals(table)
