import math

import pytest
import torch

from bsk_torch.astro.frames import angle_between, fixed_to_lla, lla_to_fixed, rotate_z, sin_elevation
from bsk_torch.constants import R_EARTH
from bsk_torch.vec3 import Vec3

ROUNDING = 1e-14


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize(
    ("latitude", "longitude", "expected"),
    [(0, 0, (1, 0, 0)), (0, 90, (0, 1, 0)), (90, 0, (0, 0, 1)), (-90, 30, (0, 0, -1)), (0, -180, (-1, 0, 0))],
)
def test_cardinal_points(latitude, longitude, expected):
    r = lla_to_fixed(torch.deg2rad(tensor(latitude)), torch.deg2rad(tensor(longitude)), tensor(1000.0))
    assert r.shape == (1, 3)
    torch.testing.assert_close(r[0], tensor(*expected) * (R_EARTH + 1000.0), rtol=0, atol=1e-8)


def test_latitude_longitude_round_trip():
    latitude = (torch.rand(200, dtype=torch.float64) - 0.5) * 3.0
    longitude = (torch.rand(200, dtype=torch.float64) - 0.5) * 6.2
    altitude = torch.rand(200, dtype=torch.float64) * 1e6
    found = fixed_to_lla(lla_to_fixed(latitude, longitude, altitude))
    torch.testing.assert_close(found[0], latitude, rtol=0, atol=1e-13)  # asin near the poles
    torch.testing.assert_close(found[1], longitude, rtol=0, atol=ROUNDING)
    torch.testing.assert_close(found[2], altitude, rtol=0, atol=1e-8)


def test_radius_of_the_sphere():
    r = lla_to_fixed(tensor(0.3, 0.4), tensor(1.0, 2.0), tensor(0.0, 5.0), tensor(10.0, 20.0))
    torch.testing.assert_close(r.norm(dim=-1), tensor(10.0, 25.0), rtol=ROUNDING, atol=0)
    assert fixed_to_lla(tensor(0.0, 0.0, 7.0), 5.0)[2] == 2.0


@pytest.mark.parametrize("elevation", [-60.0, 0.0, 10.0, 45.0, 90.0])
def test_elevation(elevation):
    angle = math.radians(elevation)
    site = Vec3.of(tensor(0.0, R_EARTH, 0.0))
    r = site + Vec3.of(tensor(math.cos(angle), math.sin(angle), 0.0) * 1e6)
    assert sin_elevation(r, site).item() == pytest.approx(math.sin(angle), abs=1e-12)


def test_rotation_about_z_turns_the_axes():
    c, s = math.cos(0.4), math.sin(0.4)
    r = Vec3.of(torch.randn(5, 3, dtype=torch.float64))
    turned = rotate_z(r, tensor(c), tensor(s))
    matrix = torch.tensor([[c, s, 0], [-s, c, 0], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(turned.stack(), r.stack() @ matrix.mT, rtol=0, atol=ROUNDING)
    torch.testing.assert_close(rotate_z(turned, tensor(c), tensor(-s)).stack(), r.stack(), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-10, 0.7, math.pi / 2, math.pi - 1e-10, math.pi])
def test_angle_between(angle):
    a, b = tensor(3.0, 0.0, 0.0), tensor(math.cos(angle), math.sin(angle), 0.0)
    assert angle_between(a, 1e6 * b).item() == pytest.approx(angle, abs=1e-15)
