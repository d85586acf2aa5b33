"""The Earth's rotation against ERFA and Skyfield, in meters on the ground.

The table of the nutation is that of scripts/tools/make_nutation.py.
"""

import erfa
import numpy as np
import pytest
import torch
from skyfield.api import load
from skyfield.sgp4lib import TEME

from bsk_torch.astro.earth_rotation import EARTHS, itrf_axes, rotation_angle, sidereal_time_1982, teme_axes
from bsk_torch.astro.ephemeris import parse_utc, utc_seconds
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.environment.ephemeris import ephemeris_at, ephemeris_records, fixed
from bsk_torch.vec3 import Vec3

DATES = [(year, 1 + 5 * year % 12, 1 + year % 28, year % 24, 7 * year % 60, 30.25) for year in range(1990, 2060, 3)]
ET = torch.tensor(
    [parse_utc("{:04d}-{:02d}-{:02d}T{:02d}:{:02d}:{:06.3f}Z".format(*date)) for date in DATES], dtype=torch.float64
)


def julian():
    """Julian dates of UTC in two parts; UT1 is taken as UTC."""
    return np.array(
        [[2400000.5, erfa.cal2jd(*date[:3])[1] + (date[3] * 60 + date[4] + date[5] / 60) / 1440.0] for date in DATES]
    ).T


def turn(found, expected):
    """Meters on the ground by which axes differ, [n]."""
    difference = found @ np.swapaxes(expected, -1, -2)
    parts = [difference[:, i, j] - difference[:, j, i] for i, j in ((0, 1), (1, 2), (2, 0))]
    return 0.5 * R_EARTH * np.linalg.norm(parts, axis=0)


def test_axes_of_the_earth_are_those_of_erfa():
    ut = julian()
    expected = erfa.c2t06a(2451545.0, ET.numpy() / 86400.0, *ut, 0.0, 0.0)
    # 1.5 mas of nutation left out, 0.05 m
    assert turn(itrf_axes(ET).numpy(), expected).max() < 0.06
    angles = ((rotation_angle(ET), erfa.era00(*ut)), (sidereal_time_1982(ET), erfa.gmst82(*ut)))
    for found, angle in angles:
        assert (
            np.abs(np.remainder(found.numpy() - angle + np.pi, 2 * np.pi) - np.pi).max() < 5e-11
        )  # 0.3 mm, rounding of the epoch


def test_teme_is_that_of_skyfield():
    timescale = load.timescale(builtin=True)
    times = timescale.tdb_jd(2451545.0, ET.numpy() / 86400.0)
    expected = np.moveaxis(TEME.rotation_at(times), -1, 0)
    assert turn(teme_axes(ET).numpy(), expected).max() < 0.1  # 3 mas of nutation and complementary terms of the equinox


def test_seconds_of_utc_invert_epochs_across_leap_seconds():
    words = ("2016-12-31T23:59:59.5Z", "2017-01-01T00:00:00.5Z", "2005-12-31T23:59:58Z", "1990-05-05T12:00:00Z")
    et = torch.tensor([parse_utc(word) for word in words], dtype=torch.float64)
    days = [(np.datetime64(word[:-1]) - np.datetime64("2000-01-01T12:00:00")) / np.timedelta64(1, "ms") / 1e3 for word in words]
    np.testing.assert_allclose(utc_seconds(et).numpy(), days, rtol=0, atol=3e-7)  # ET is rounded to 1e-7 s


@pytest.mark.parametrize("name", EARTHS)
def test_the_simulation_turns_the_earth_as_its_model_does(name):
    earth, n = EARTHS[name], len(ET)
    records = ephemeris_records(ET, 2, earth=earth)
    tau = torch.full((n,), 3599.0, dtype=torch.float64)
    sky = ephemeris_at(records.flatten(1).unbind(-1), tau)
    r = torch.tensor([4e6, -3e6, 4.5e6], dtype=torch.float64).expand(n, 3)
    expected = (earth.orientation(ET + 3599.0) @ r.unsqueeze(-1)).squeeze(-1)
    found = fixed(sky, Vec3.of(r)).stack()
    assert (found - expected).norm(dim=-1).max() < 0.15  # rates within an hour are those of IAU_EARTH


def test_iau_earth_is_kilometers_from_itrf():
    et = torch.tensor([parse_utc("2026-04-14T00:00:00Z")], dtype=torch.float64)
    off = turn(EARTHS["IAU_EARTH"].orientation(et).numpy(), itrf_axes(et).numpy())
    assert 9.3e3 < off[0] < 9.8e3
