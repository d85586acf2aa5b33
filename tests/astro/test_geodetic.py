"""Places on WGS84, and elevations from its normal."""

import math

import pytest
import torch

from bsk_torch.astro.frames import sin_elevation
from bsk_torch.astro.geodetic import (
    LARGEST_DEFLECTION,
    axis_shift,
    fixed_to_geodetic,
    geodetic_to_fixed,
    local_vertical,
    vertical_of,
)
from bsk_torch.astro.sight import elevation_clearance
from bsk_torch.vec3 import Vec3


def places(height, n=200):
    latitude = torch.linspace(-0.5 * math.pi, 0.5 * math.pi, n, dtype=torch.float64)
    longitude = torch.linspace(-3.1, 3.1, n, dtype=torch.float64)
    return latitude, longitude, torch.full_like(latitude, height)


@pytest.mark.parametrize(
    ("degrees", "height", "expected"),
    [
        # Vallado, example 3-3: a position of 34.352496 degrees north, 46.4464 east, 5,085.22 km high
        ((34.352496, 46.4464), 5085.2187e3, (6524.834e3, 6862.875e3, 6448.296e3)),
        # erfa.gd2gc (pyerfa 2.0.1.5) for WGS84
        ((-33.8688, 151.2093), 58.0, (-4646093.477288, 2553229.535817, -3534404.710910)),
        ((90.0, 0.0), 0.0, (0.0, 0.0, 6356752.314245)),
    ],
)
def test_positions_of_places(degrees, height, expected):
    latitude, longitude = (torch.deg2rad(torch.tensor(x, dtype=torch.float64)) for x in degrees)
    r = geodetic_to_fixed(latitude, longitude, torch.tensor(height, dtype=torch.float64))
    assert r.tolist() == pytest.approx(expected, abs=60.0 if height > 1e6 else 1e-5)  # the book prints 1e-6 degrees


@pytest.mark.parametrize(("height", "most"), [(-400.0, 1e-14), (0.0, 1e-14), (9e3, 1e-12), (7e5, 1e-9), (3.6e7, 1e-8)])
def test_places_come_back(height, most):
    there = places(height)
    back = fixed_to_geodetic(geodetic_to_fixed(*there))
    assert (back[0] - there[0]).abs().max() < most
    assert ((back[1] - there[1])[1:-1]).abs().max() < 1e-14  # poles have no longitude
    assert (back[2] - there[2]).abs().max() < 1e-6


def test_the_shifted_place_lies_on_its_vertical():
    r = geodetic_to_fixed(*places(500.0))
    place = Vec3.of(r)
    up = local_vertical(r)
    shifted = vertical_of(place, "wgs84").stack()
    torch.testing.assert_close(shifted / shifted.norm(dim=-1, keepdim=True), up, rtol=0, atol=1e-14)
    assert vertical_of(place, "radius") is place
    deflection = torch.linalg.vector_norm(torch.linalg.cross(up, r / r.norm(dim=-1, keepdim=True)), dim=-1)
    assert 0.9 * LARGEST_DEFLECTION < deflection.max() < LARGEST_DEFLECTION


def test_clearance_is_zero_at_the_elevation_over_the_ellipsoid():
    """A satellite is put at an elevation above the horizontal plane, by the normal and a direction across it."""
    latitude, longitude, height = places(100.0)
    r = geodetic_to_fixed(latitude, longitude, height)
    up = local_vertical(r)
    north = torch.stack([-latitude.sin() * longitude.cos(), -latitude.sin() * longitude.sin(), latitude.cos()], -1)
    for degrees in (0.0, 10.0, 60.0):
        elevation = math.radians(degrees)
        satellite = Vec3.of(r + 1e6 * (math.sin(elevation) * up + math.cos(elevation) * north))
        place = Vec3.of(r)
        sine = torch.full_like(height, math.sin(elevation))
        torch.testing.assert_close(sin_elevation(satellite, place, vertical_of(place, "wgs84")), sine, rtol=0, atol=1e-14)
        assert elevation_clearance(satellite, place, sine, axis_shift(place)).abs().max() < 1e-14
        assert elevation_clearance(satellite, place, sine).abs().max() > 1e-5  # from the radius, it is another elevation
