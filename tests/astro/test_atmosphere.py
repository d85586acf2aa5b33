import math

import pytest
import torch

from bsk_torch.astro.atmosphere import NEGLIGIBLE_DENSITY, exponential_density, top_radius
from bsk_torch.constants import R_EARTH
from bsk_torch.vec3 import Vec3

BASE, HEIGHT = 1.22, 8000.0  # bsk_rl's atmosphere


def density(radius: float) -> float:
    r = Vec3.of(torch.tensor([0.6, 0.0, -0.8], dtype=torch.float64) * radius)
    return exponential_density(r, R_EARTH, BASE, HEIGHT).item()


def test_density_falls_by_e_over_the_scale_height():
    assert density(R_EARTH) == pytest.approx(BASE, rel=1e-12)
    assert density(R_EARTH + HEIGHT) == pytest.approx(BASE / math.e, rel=1e-12)
    assert density(6871e3) == pytest.approx(2e-27, rel=0.2)


def test_parameters_by_row():
    r = Vec3.of(torch.tensor([[7e6, 0, 0], [0, 7e6, 0]], dtype=torch.float64))
    radius, base, height = (torch.tensor(x, dtype=torch.float64) for x in ([7e6, 6.9e6], [1.0, 2.0], [1e4, 1e5]))
    expected = torch.tensor([1.0, 2.0 / math.e], dtype=torch.float64)
    torch.testing.assert_close(exponential_density(r, radius, base, height), expected, rtol=1e-14, atol=0)


def test_top_is_where_density_becomes_negligible():
    assert density(top_radius(R_EARTH, BASE, HEIGHT)) == pytest.approx(NEGLIGIBLE_DENSITY, rel=1e-9)
    assert (top_radius(R_EARTH, 0.0, HEIGHT), top_radius(R_EARTH, NEGLIGIBLE_DENSITY, HEIGHT)) == (0.0, 0.0)
