"""Flights as OEM, and their schedules."""

import csv
import io
import json

import numpy as np

from bsk_torch.formats.ccsds import read_ccsds
from bsk_torch.recording.recording import decode
from bsk_torch.viewer.oem import oem
from bsk_torch.viewer.schedule import schedule
from tests.support.recordings import synthetic_recording


def test_an_oem_holds_the_keyframes_of_a_track():
    recording = synthetic_recording()
    flight = recording.tracks[0]
    found = {each.name: each for each in read_ccsds(oem(recording))}
    r = flight.arrays["r_N"].astype("f8")
    present = [k for k in range(len(recording.satellites)) if np.isfinite(r[:, k]).any()]
    assert list(found) == [recording.satellites[k].name for k in present]
    for k in present:
        each = found[recording.satellites[k].name]
        there = np.isfinite(r[:, k]).all(-1)
        et = recording.scenes[flight.scene].et + flight.arrays["key_times"][there]
        np.testing.assert_allclose(each.times, et, rtol=0, atol=6e-4)  # milliseconds
        np.testing.assert_allclose(each.states[:, :3], r[there, k], rtol=0, atol=1e-6)


def test_a_schedule_holds_tasks_events_passes_and_eclipses_in_order():
    recording = decode(synthetic_recording().encode())
    arrays = recording.tracks[0].arrays
    rows = json.loads(schedule(recording, "json"))
    assert [row["start_s"] for row in rows] == sorted(row["start_s"] for row in rows)
    counts = {kind: sum(row["kind"] == kind for row in rows) for kind in ("task", "event", "pass", "eclipse")}
    sizes = {"task": "decision_time", "event": "event_time", "pass": "passes", "eclipse": "eclipses"}
    assert counts == {kind: len(arrays[name]) for kind, name in sizes.items()}
    table = list(csv.DictReader(io.StringIO(schedule(recording, "csv"))))
    assert [row["start_utc"] for row in table] == [row["start_utc"] for row in rows]
