"""Ephemeris and parameter messages."""

import numpy as np
import pytest
import torch

from bsk_torch.astro.earth_rotation import itrf_axes, teme_axes
from bsk_torch.astro.element_sets import Ephemeris
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, parse_utc
from bsk_torch.formats import ccsds
from bsk_torch.formats.ccsds import read_ccsds, write_oem
from tests.formats.samples import OPM, STATES, oem
from tests.support.refusals import check_refusals, refusal

BEGIN = parse_utc("2026-04-13T22:00:00Z")
FIRST = np.array([1580996.0, 84049.0, 6951379.0, 5787.107, -4558.542, -1306.022])


def test_states_are_in_m_along_axes_of_N():
    (found,) = read_ccsds(oem(STATES))
    assert (found.name, found.object_id, len(found.times)) == ("GREENSAT-1 (A)", "2003-046A", 2)
    assert found.times.tolist() == [parse_utc("2026-04-13T22:00:00Z"), parse_utc("2026-04-13T22:01:00Z")]
    np.testing.assert_allclose(found.states[0], FIRST, rtol=0, atol=1e-6)
    (single,) = read_ccsds(OPM)
    np.testing.assert_allclose(single.states[0], FIRST, rtol=0, atol=1e-6)


def test_time_scales_and_frames_are_converted():
    utc = read_ccsds(oem(STATES))[0].times[0]
    for scale, ahead in (("TAI", 37.0), ("TT", 69.184), ("TDB", 69.184), ("GPS", 18.0)):
        assert utc - read_ccsds(oem(STATES, scale=scale))[0].times[0] == pytest.approx(
            ahead, abs=2e-3 if scale == "TDB" else 1e-6
        )
    et = torch.tensor(utc, dtype=torch.float64)
    teme = read_ccsds(oem(STATES, "TEME"))[0].states[0]
    np.testing.assert_allclose(teme_axes(et).numpy() @ teme.reshape(2, 3).T, FIRST.reshape(2, 3).T, rtol=0, atol=1e-6)
    r, v = read_ccsds(oem(STATES, "ITRF2014"))[0].states[0].reshape(2, 3)
    PN = itrf_axes(et).numpy()
    np.testing.assert_allclose(PN @ r, FIRST[:3], rtol=0, atol=1e-6)
    spin = np.array([0.0, 0.0, EARTH_ROTATION_RATE])
    np.testing.assert_allclose(PN @ v - np.cross(spin, PN @ r), FIRST[3:], rtol=0, atol=1e-9)


def circle(times):
    """States on a circular low orbit, [K, 6]."""
    radius, rate = 7e6, 1.078e-3
    angle = rate * (times - BEGIN)
    r = radius * np.stack([np.cos(angle), np.sin(angle) * 0.6, np.sin(angle) * 0.8], -1)
    return np.concatenate([r, radius * rate * np.stack([-np.sin(angle), np.cos(angle) * 0.6, np.cos(angle) * 0.8], -1)], -1)


def test_an_ephemeris_is_written_read_and_interpolated():
    times = BEGIN + 60.0 * np.arange(12)
    original = Ephemeris("GREENSAT-1 (A)", "2003-046A", times, circle(times))
    (found,) = read_ccsds(write_oem([original]))
    np.testing.assert_allclose(found.times, original.times, rtol=0, atol=6e-4)  # milliseconds
    np.testing.assert_allclose(found.states, original.states, rtol=0, atol=1e-6)
    between = torch.from_numpy(original.times[:1]) + torch.linspace(0.0, 660.0, 45, dtype=torch.float64)
    r, v = original.state_at(between)
    expected = circle(between.numpy())
    np.testing.assert_allclose(r.numpy(), expected[:, :3], rtol=0, atol=1e-4)
    np.testing.assert_allclose(v.numpy(), expected[:, 3:], rtol=0, atol=1e-5)


def test_a_single_state_moves_by_up_to_a_second():
    (found,) = read_ccsds(OPM)
    r, _ = found.state_at(torch.tensor([found.times[0] + 0.5], dtype=torch.float64))
    np.testing.assert_allclose(r[0].numpy(), FIRST[:3] + 0.5 * FIRST[3:], rtol=0, atol=1.1)  # half of g t^2


def segments(second):
    return oem(STATES) + oem(second).partition("\n\n")[2]


def test_segments_of_one_satellite_are_joined():
    (found,) = read_ccsds(segments(STATES.replace("22:01:00", "22:03:00").replace("22:00:00.000", "22:01:00")))
    assert len(found.times) == 3


def test_wrong_messages_are_refused(monkeypatch):
    outside = torch.tensor([parse_utc("2026-04-14T12:00:00Z")], dtype=torch.float64)
    check_refusals(
        refusal(lambda: read_ccsds(oem(STATES, "MOD")), ValueError, "line 13", "REF_FRAME='MOD'", "TEME"),
        refusal(lambda: read_ccsds(oem(STATES, scale="UT1")), ValueError, "TIME_SYSTEM='UT1'", "UTC"),
        refusal(lambda: read_ccsds(oem(STATES).replace("= EARTH", "= MARS")), ValueError, "CENTER_NAME='MARS'", "EARTH"),
        refusal(lambda: read_ccsds(oem(STATES).replace("OBJECT_ID", "OBJECT_IP")), ValueError, "OBJECT_ID is missing"),
        refusal(lambda: read_ccsds(oem("2026-04-13T22:00:00 1 2 3\n")), ValueError, "line 15", "4 fields", "6 numbers"),
        refusal(lambda: read_ccsds(oem(STATES.replace("84.049", "8_4"))), ValueError, "line 15", "'8_4'", "number"),
        refusal(lambda: read_ccsds(oem(STATES.replace("T22:00:00.000", "T25:00:00"))), ValueError, "line 15", "25:00:00"),
        refusal(lambda: read_ccsds(oem(STATES.replace("2026-103T", "2026-102T"))), ValueError, "line 5", "state 2", "time"),
        refusal(lambda: read_ccsds(oem("2026-04-13T22:00:00 7e6 0 0 0 7.5e3 0\n")), ValueError, "line 15", "7e+06 km", "km/s"),
        refusal(lambda: read_ccsds(oem("2026-04-13T22:00:00 7e3 0 0 0 7.5e3 0\n")), ValueError, "line 15", "7500 km/s"),
        refusal(lambda: read_ccsds(oem("")), ValueError, "line 5", "no states"),
        refusal(lambda: read_ccsds(segments(STATES)), ValueError, "line 5", "overlap"),
        refusal(lambda: read_ccsds("CCSDS_OEM_VERS = 2.0\n"), ValueError, "no segment"),
        refusal(lambda: read_ccsds("hello\nworld\n"), ValueError, "line 1", "KEYWORD"),
        refusal(lambda: read_ccsds("CCSDS_AEM_VERS = 2.0\n"), ValueError, "CCSDS_OEM_VERS"),
        refusal(lambda: read_ccsds(OPM.replace("X_DOT", "X_DIT")), ValueError, "X_DOT is missing"),
        refusal(lambda: read_ccsds(OPM + "MAN_DURATION = 3 [s]\n"), ValueError, "line 17", "MAN_DURATION", "actions"),
        refusal(lambda: read_ccsds(OPM + "X = 3 [km]\n"), ValueError, "line 17", "X", "line 10"),
        refusal(lambda: read_ccsds(oem(STATES))[0].state_at(outside), ValueError, "GREENSAT-1 (A)", "2026-04-14T12", "22:01:00"),
    )
    monkeypatch.setattr(ccsds, "MOST_STATES", 1)
    check_refusals(refusal(lambda: read_ccsds(oem(STATES)), ValueError, "line 16", "more than 1", "split"))
