"""Fractions of inspected points, region by region."""

import pytest
import torch

from bsk_torch.astro.relative import fibonacci_sphere
from bsk_torch.tasks.inspection.obs import AXES, known_regions

POINTS = torch.as_tensor(fibonacci_sphere(37))


def one_by_one(inspected, points, centers):
    """The same by a loop over points: the first of the nearest centres."""
    known, count = torch.zeros(len(centers), dtype=torch.float64), torch.zeros(len(centers), dtype=torch.float64)
    for flag, point in zip(inspected, points, strict=True):
        region = min(range(len(centers)), key=lambda k: float(((point - centers[k]) ** 2).sum().round(decimals=12)))
        known[region] += flag
        count[region] += 1
    return known / count.clamp(min=1.0)


BACKENDS = pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.compiled)], ids=["eager", "compiled"])


@BACKENDS
@pytest.mark.parametrize("regions", [1, 6, 32])
@pytest.mark.parametrize("own", [False, True], ids=["shared points", "points of each"])
def test_each_point_belongs_to_the_nearest_centre(regions, own, compiled):
    generator = torch.Generator().manual_seed(0)
    turns = torch.linalg.qr(torch.randn(5, 3, 3, dtype=torch.float64, generator=generator))[0]
    centers = torch.as_tensor(fibonacci_sphere(regions)) @ turns
    inspected = (torch.rand(5, 37, generator=generator) < 0.4).double()
    points = POINTS @ turns.mT if own else POINTS
    found = known_regions(inspected, points, centers, compiled)
    for k in range(5):
        assert torch.equal(found[k], one_by_one(inspected[k], points[k] if own else points, centers[k]))
        alone = known_regions(inspected[k : k + 1], points[k : k + 1] if own else points, centers[k : k + 1], compiled)
        assert torch.equal(alone[0], found[k])


@BACKENDS
def test_centres_of_any_length_take_the_points_that_are_nearest_to_them_first(compiled):
    inspected = torch.ones(2, 37, dtype=torch.float64)
    centers = torch.tensor(AXES, dtype=torch.float64)
    assert torch.equal(known_regions(inspected, POINTS, centers, compiled), torch.ones(2, 6, dtype=torch.float64))
    # the nearest of (10, 0, 0) and (0.5, 0, 0) to points of the unit sphere is the second
    far = torch.tensor([[10.0, 0.0, 0.0], [0.5, 0.0, 0.0]], dtype=torch.float64)
    assert known_regions(inspected, POINTS, far, compiled).tolist() == [[0.0, 1.0]] * 2
    point = torch.tensor([[1.0, 1.0, 0.0]], dtype=torch.float64)
    found = known_regions(torch.ones(1, 1, dtype=torch.float64), point, torch.tensor(AXES, dtype=torch.float64), compiled)
    assert found.tolist() == [[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]]
