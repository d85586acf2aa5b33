"""When images are expected to end, and where objects and satellites are then."""

import math

import pytest
import torch

from bsk_torch.constants import MU_EARTH
from bsk_torch.tasks.objects.candidates import Moment
from bsk_torch.tasks.objects.outlook import PER_ROOT, START, coast, elevation, image_end
from bsk_torch.vec3 import Vec3

R = 7e6
RATE = math.sqrt(MU_EARTH / R**3)


def row(*x):
    return torch.tensor([x], dtype=torch.float64)


def test_on_a_circle_the_radius_and_the_rate_remain():
    seconds = torch.tensor([0.0, 100.0, 1000.0], dtype=torch.float64)
    found = coast(Vec3.of(row(R, 0.0, 0.0)), Vec3.of(row(0.0, RATE * R, 0.0)), seconds).stack()
    expected = torch.stack([R * (RATE * seconds).cos(), R * (RATE * seconds).sin(), 0.0 * seconds], -1)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-6)


def test_an_ellipse_is_followed_for_some_minutes():
    """From the perigee of an orbit of eccentricity 0.02: r = p / (1 + e cos nu) at the time of Kepler's equation."""
    e, a = 0.02, R / 0.98
    speed = math.sqrt(MU_EARTH * (1.0 + e) / R)
    anomaly = 0.2
    seconds = (anomaly - e * math.sin(anomaly)) * math.sqrt(a**3 / MU_EARTH)
    true = [a * (math.cos(anomaly) - e), a * math.sqrt(1.0 - e * e) * math.sin(anomaly), 0.0]
    found = coast(Vec3.of(row(R, 0.0, 0.0)), Vec3.of(row(0.0, speed, 0.0)), torch.tensor([seconds], dtype=torch.float64)).stack()
    assert seconds == pytest.approx(188.0, abs=5.0)
    assert (found - row(*true)).norm() < 200.0  # of 1.4e6 m: both are at the same point at first, with the same velocity


def test_the_time_of_an_image_is_that_of_the_turn_to_its_end():
    """An object far away straight up moves little, as seen from a satellite whose instrument points along its velocity."""
    at = Moment(row(R, 0.0, 0.0), row(0.0, RATE * R, 0.0), row(0.0, 1.0, 0.0), row(1.5e11, 0.0, 0.0))
    far = Vec3.of(row(1e9, 0.0, 0.0)[None])
    end = image_end(far, Vec3.zeros_like(far.x), at)
    assert end.duration.item() == pytest.approx(START + PER_ROOT * math.sqrt(90.0), abs=0.1)
    passed = math.degrees(RATE) * end.duration.item()
    assert elevation(end.r_TN_N, end.r_BN_N).item() == pytest.approx(90.0 - passed, abs=0.2)
