import pytest
import torch

from bsk_torch.astro.earth_rotation import pole_matrix
from bsk_torch.astro.ephemeris import earth_angles, earth_orientation, parse_utc, sun_state
from bsk_torch.sim.component import Bus, neighbours
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_at, ephemeris_records, fixed
from bsk_torch.sim.orbit.grid import ARC_SEGMENT
from bsk_torch.vec3 import Vec3

EPOCHS = ("2000-01-01T00:00:00", "2020-03-01T12:34:56", "2021-07-05T00:00:00", "2035-10-10T10:00:00", "2059-12-30T00:00:00")

HOURS = 4
EVERY = 7.0
"""Seconds between the times at which the ephemeris is looked up."""


def looked_up(epoch: str) -> tuple[torch.Tensor, Bus]:
    """ET, and the ephemeris as a tick sees it, at times of all hours of a table."""
    start = torch.tensor([parse_utc(epoch)], dtype=torch.float64)
    time = torch.arange(0.0, (HOURS - 1) * ARC_SEGMENT + EVERY, EVERY, dtype=torch.float64)
    rows = torch.zeros(len(time), dtype=torch.long)
    records, tau = neighbours(EPHEMERIS_TRACK, ephemeris_records(start, HOURS), rows, time)
    return start + time, ephemeris_at(records.flatten(1).unbind(-1), tau)


@pytest.mark.parametrize("epoch", EPOCHS)
def test_sun_between_records(epoch):
    et, ephemeris = looked_up(epoch)
    r, v = sun_state(et)
    # the cubic through two hours; rounding of 1 au is 3e-5 m. Measured up to 2.2e-4 m and 1.6e-7 m/s
    torch.testing.assert_close(ephemeris.r_SN_N.stack(), r, rtol=0, atol=4e-4)
    torch.testing.assert_close(ephemeris.v_SN_N.stack(), v, rtol=0, atol=3e-7)


@pytest.mark.parametrize("epoch", EPOCHS)
def test_pole_between_records(epoch):
    """It drifts by 6e-12 rad an hour; what is left is rounding."""
    et, ephemeris = looked_up(epoch)
    pole = ephemeris.EN.stack()
    torch.testing.assert_close(pole, pole_matrix(et).stack(), rtol=0, atol=1e-15)
    torch.testing.assert_close(pole @ pole.mT, torch.eye(3, dtype=torch.float64).expand_as(pole), rtol=0, atol=2e-15)


@pytest.mark.parametrize("epoch", EPOCHS)
def test_meridian_between_records(epoch):
    """The angle since J2000, up to 1.4e5 rad, is rounded in multiples of 2.9e-11 rad; so is a position, by 0.2 mm."""
    et, ephemeris = looked_up(epoch)
    angle = earth_angles(et)[2]
    turn = ephemeris.sin_earth * torch.cos(angle) - ephemeris.cos_earth * torch.sin(angle)
    assert turn.abs().amax() < 6e-11
    r = torch.tensor([7e6, 1e6, -3e6], dtype=torch.float64)
    found = fixed(ephemeris, Vec3.of(r.expand(len(et), 3))).stack()
    torch.testing.assert_close(found, (earth_orientation(et) @ r), rtol=0, atol=6e-11 * 7e6)


def test_records_are_an_hour_apart_for_years():
    et = torch.tensor([parse_utc(epoch) for epoch in EPOCHS], dtype=torch.float64)
    records = ephemeris_records(et, 3)
    assert records.shape == (len(EPOCHS), 3, EPHEMERIS_TRACK.width)
    for k in range(3):
        time = et + k * 3600.0
        r_sun, v_sun, angle, pole = records[:, k].split([3, 3, 1, 9], -1)
        expected = *sun_state(time), earth_angles(time)[2].unsqueeze(-1), pole_matrix(time).stack().flatten(1)
        for found, value in zip((r_sun, v_sun, angle, pole), expected, strict=True):
            assert torch.equal(found, value)
    # Hours beyond 2^24 s are no float32 numbers.
    start = torch.tensor([parse_utc("2024-01-01T00:00:00")], dtype=torch.float64)
    hours = 90_002  # ten years
    found = ephemeris_records(start, hours)[:, -1:]
    torch.testing.assert_close(found, ephemeris_records(start, 1, torch.full_like(start, 90_001 * ARC_SEGMENT)), rtol=0, atol=0)


def test_records_are_met():
    """At a record the Sun and the Earth are what it says, bit for bit; the end of an hour is the start of the next."""
    records = ephemeris_records(torch.tensor([parse_utc(EPOCHS[1])], dtype=torch.float64), 3)[0]
    zero, hour = torch.zeros(1, dtype=torch.float64), torch.full((1,), ARC_SEGMENT, dtype=torch.float64)
    start, end = (
        ephemeris_at(records[1:3].flatten().unsqueeze(-1).unbind(0), zero),
        ephemeris_at(records[:2].flatten().unsqueeze(-1).unbind(0), hour),
    )
    assert torch.equal(start.r_SN_N.stack()[0], records[1, :3])
    assert torch.equal(start.v_SN_N.stack()[0], records[1, 3:6])
    assert torch.equal(start.EN.stack().flatten(), records[1, 7:])
    torch.testing.assert_close(end.r_SN_N.stack(), start.r_SN_N.stack(), rtol=0, atol=1e-4)  # a few roundings of 1 au
    torch.testing.assert_close(end.v_SN_N.stack(), start.v_SN_N.stack(), rtol=0, atol=1e-10)
    torch.testing.assert_close(end.cos_earth, start.cos_earth, rtol=0, atol=6e-11)
