"""Tests of `bsk_torch.astro.ephemeris`."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from bsk_torch.astro import ephemeris

torch.set_num_threads(1)

SAMPLES = Path(__file__).with_name("sun_de440_samples.csv")


def epochs(count: int = 64, seed: int = 3) -> torch.Tensor:
    """Random ET inside the table, away from its ends."""
    first, last = ephemeris.coverage()
    generator = torch.Generator().manual_seed(seed)
    return first + 1e5 + (last - first - 2e5) * torch.rand(count, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize(
    ("text", "et", "tolerance"),
    [
        # J2000 is 12:00 TDB; TDB - TT is -7.3e-5 s there.
        ("2000-01-01T11:58:55.816", 0.0, 1e-4),
        # Values that SPICE's str2et gives (the second is the example in its documentation).
        ("2000 JAN 01 12:00:00 (UTC)", 64.18392728466942, 1e-9),
        ("1997 MAR 20 20:53:29 (UTC)", -87836728.81438904, 1e-7),
        # Whole days since J2000 + leap seconds + 32.184 s; the periodic term is below 1.7 ms.
        ("2017 JAN 01 00:00:00 (UTC)", 6209.5 * 86400 + 37 + 32.184, 1.7e-3),
        ("2016 DEC 31 23:59:59 (UTC)", 6209.5 * 86400 - 1 + 36 + 32.184, 1.7e-3),
        ("1990 JUN 15 12:00:00 (UTC)", -3487 * 86400 + 25 + 32.184, 1.7e-3),
        ("2059 DEC 31 12:00:00 (UTC)", 21914 * 86400 + 37 + 32.184, 1.7e-3),
    ],
)
def test_known_epochs(text: str, et: float, tolerance: float) -> None:
    """The conversion agrees with day counts and leap seconds done by hand."""
    assert ephemeris.parse_utc(text) == pytest.approx(et, abs=tolerance)


def test_periodic_term() -> None:
    """TDB - TT swings by 1.657 ms over the year and vanishes near perihelion."""
    terms = [ephemeris.parse_utc(f"2010-{month:02d}-04T00:00:00") for month in (1, 4, 7, 10)]
    days = [3655.5, 3745.5, 3836.5, 3928.5]
    swing = [et - (day * 86400 + 34 + 32.184) for et, day in zip(terms, days, strict=True)]
    assert swing == pytest.approx([0.0, 1.657e-3, 0.0, -1.657e-3], abs=5e-5)


@pytest.mark.parametrize(
    "text",
    [
        "2021 FEB 05 09:12:05.830 (UTC)",
        "2021 feb 05 09:12:05.830 (UTC)",
        "2021 Feb 5 9:12:05.83",
        " 2021 FEB 05 09:12:05.830 UTC ",
        "2021-02-05T09:12:05.830",
        "2021-02-05T09:12:05.830Z",
    ],
)
def test_accepted_forms(text: str) -> None:
    """Every accepted spelling of an epoch gives the same ET."""
    assert ephemeris.parse_utc(text) == ephemeris.parse_utc("2021 FEB 05 09:12:05.830 (UTC)")


def test_missing_fraction() -> None:
    """Whole seconds need no decimal point."""
    assert ephemeris.parse_utc("2021 FEB 05 09:12:05 (UTC)") == ephemeris.parse_utc("2021-02-05T09:12:05.000")


@pytest.mark.parametrize("entry", ephemeris.LEAP_SECONDS[1:])
def test_leap_seconds(entry: tuple[tuple[int, int], int]) -> None:
    """Every inserted second counts once: it is 1 s after 23:59:59 and 1 s before midnight."""
    (year, month), _ = entry
    last_day = f"{year - 1} DEC 31" if month == 1 else f"{year} JUN 30"
    times = (f"{last_day} 23:59:59", f"{last_day} 23:59:60", f"{year}-{month:02d}-01T00:00:00")
    before, leap, after = (ephemeris.parse_utc(text) for text in times)
    assert (leap - before, after - leap) == pytest.approx((1.0, 1.0), abs=1e-6)


def test_coverage() -> None:
    """The table reaches from December 1989 to February 2060."""
    first, last = ephemeris.coverage()
    assert first <= ephemeris.parse_utc("1989 DEC 01 00:00:00")
    assert last >= ephemeris.parse_utc("2060 FEB 01 00:00:00")
    # No extrapolation: outside the table the position is NaN, at its ends it is not.
    et = torch.tensor([first - 1, first, last, last + 1, math.nan], dtype=torch.float64)
    finite = ephemeris.sun_position(et).isfinite().all(-1)
    assert finite.tolist() == [False, True, True, False, False]


def test_sun_against_de440() -> None:
    """The table reproduces DE440 at random epochs."""
    samples = torch.from_numpy(np.loadtxt(SAMPLES, delimiter=",", skiprows=2))
    position, velocity = ephemeris.sun_state(samples[:, 0])
    assert (position - samples[:, 1:4]).norm(dim=-1).max() < 0.6
    assert (velocity - samples[:, 4:7]).norm(dim=-1).max() < 1e-4


def test_sun_is_continuous_and_its_velocity_is_the_derivative() -> None:
    """The velocity is the position's time derivative."""
    et, step = epochs(), 100.0
    _, velocity = ephemeris.sun_state(et)
    difference = (ephemeris.sun_position(et + step) - ephemeris.sun_position(et - step)) / (2 * step)
    assert (difference - velocity).abs().max() < 1e-4
    # Neighbouring segments meet within the table's error.
    first, last = ephemeris.coverage()
    joints = torch.arange(first, last, 16 * 86400.0, dtype=torch.float64)[1:]
    early, velocity = ephemeris.sun_state(joints - 0.5)
    jump = ephemeris.sun_position(joints + 0.5) - early - velocity
    assert jump.norm(dim=-1).max() < 1.2


def test_sun_shapes() -> None:
    """Every batch shape works and gives what single epochs give."""
    et = epochs(6)
    position, velocity = ephemeris.sun_state(et.reshape(2, 3))
    assert position.shape == velocity.shape == (2, 3, 3)
    assert torch.equal(position.reshape(6, 3)[4], ephemeris.sun_position(et[4]))
    assert ephemeris.sun_position(et[:0]).shape == (0, 3)


def test_earth_angles_at_j2000() -> None:
    """At J2000 the angles are the constant terms of pck00010."""
    angles = ephemeris.earth_angles(torch.zeros((), dtype=torch.float64))
    assert [math.degrees(float(angle)) for angle in angles] == pytest.approx([0.0, 90.0, 190.147], abs=1e-12)


def test_earth_angles_rates() -> None:
    """The angles move at the published constants, and W stays within one turn."""
    et, step = epochs(), 3600.0
    now, later = ephemeris.earth_angles(et), ephemeris.earth_angles(et + step)
    turns = [torch.remainder(b - a + 1, 2 * math.pi) - 1 for a, b in zip(now, later, strict=True)]
    rates = [float(turn.mean()) / step for turn in turns]
    assert rates[0] == pytest.approx(ephemeris.POLE_RIGHT_ASCENSION_RATE, abs=1e-18)
    assert rates[1] == pytest.approx(ephemeris.POLE_DECLINATION_RATE, abs=1e-18)
    assert rates[2] == pytest.approx(ephemeris.EARTH_ROTATION_RATE, abs=1e-14)
    assert ((now[2] >= 0) & (now[2] < 2 * math.pi)).all()


def test_orientation_is_a_rotation() -> None:
    """C is orthonormal and right-handed."""
    c = ephemeris.earth_orientation(epochs())
    assert (c @ c.mT - torch.eye(3, dtype=torch.float64)).abs().max() < 1e-15
    assert (torch.linalg.det(c) - 1).abs().max() < 1e-14


def test_orientation_pole_and_meridian() -> None:
    """The third row of C is the pole; W is the angle from the node on the J2000 equator to the prime meridian."""
    et = epochs()
    alpha, delta, meridian = ephemeris.earth_angles(et)
    c = ephemeris.earth_orientation(et)
    pole = torch.stack([delta.cos() * alpha.cos(), delta.cos() * alpha.sin(), delta.sin()], -1)
    node = torch.stack([-alpha.sin(), alpha.cos(), torch.zeros_like(alpha)], -1)
    assert (c[:, 2] - pole).abs().max() < 1e-15
    assert ((c[:, 0] * node).sum(-1) - meridian.cos()).abs().max() < 1e-15
    assert ((c[:, 1] * node).sum(-1) + meridian.sin()).abs().max() < 1e-15


def test_orientation_rate_is_derivative() -> None:
    """The rate agrees with finite differences of C."""
    et, step = epochs(), 20.0
    rate = ephemeris.earth_orientation_rate(et)
    difference = (ephemeris.earth_orientation(et + step) - ephemeris.earth_orientation(et - step)) / (2 * step)
    # The difference quotient errs by step^2 rate^3 / 6 = 2.6e-11 and by W's rounding over the step.
    assert (difference - rate).abs().max() < 3e-11
    # Along the third row only the pole's drift is left, which finite differences over a year resolve.
    et, step = epochs(), 1.6e7
    rate = ephemeris.earth_orientation_rate(et)[:, 2]
    difference = (ephemeris.earth_orientation(et + step) - ephemeris.earth_orientation(et - step))[:, 2] / (2 * step)
    assert rate.abs().max() > 1e-13
    assert (difference - rate).abs().max() < 1e-19


def test_angular_velocity() -> None:
    """Cdot C^T is skew; about the pole it is the rate of W plus the node's part along the pole."""
    et = epochs()
    spin = ephemeris.earth_orientation_rate(et) @ ephemeris.earth_orientation(et).mT
    assert (spin + spin.mT).abs().max() < 1e-18
    _, delta, _ = ephemeris.earth_angles(et)
    expected = ephemeris.EARTH_ROTATION_RATE + ephemeris.POLE_RIGHT_ASCENSION_RATE * delta.sin()
    assert (spin[:, 0, 1] - expected).abs().max() < 1e-18
