import math

import pytest
import torch

from bsk_torch import rand, scene

from .conftest import MANY, key
from .test_changing import one_fire

FIVE_SIGMA = 5.0 / math.sqrt(MANY)  # sampling error of a mean of MANY draws, in standard deviations


def test_true_cover_is_that_of_bsk_rl():
    """min(U, 1) with U uniform in [0, 1.348): it is 1 with probability 0.348 / 1.348, and else uniform."""
    cover = scene.CloudyTargets(scene.UniformTargets(4)).draw(key(MANY // 4))["cloud_cover"].flatten()
    overcast = 0.348 / 1.348
    assert (cover == 1.0).double().mean() == pytest.approx(overcast, abs=FIVE_SIGMA * math.sqrt(overcast * (1 - overcast)))
    below = cover[cover < 1.0]
    assert below.mean() == pytest.approx(0.5, abs=5 / math.sqrt(12 * len(below)))
    assert (below**2).mean() == pytest.approx(1 / 3, abs=5 * math.sqrt((1 / 5 - 1 / 9) / len(below)))


def test_forecasts_are_normal_about_the_truth():
    """Where neither is cut, the error over sigma is standard normal."""
    drawn = scene.CloudyTargets(scene.UniformTargets(4)).draw(key(MANY // 4))
    cover, forecast, sigma = (drawn[f"cloud_{name}"].flatten() for name in ("cover", "forecast", "forecast_sigma"))
    assert 0.01 <= sigma.min() < sigma.max() < 0.05
    assert sigma.mean() == pytest.approx(0.03, abs=FIVE_SIGMA * 0.04 / math.sqrt(12))
    assert forecast.min() >= 0
    assert forecast.max() <= 1
    free = (cover > 0.3) & (cover < 0.7)
    error = ((forecast - cover) / sigma)[free]
    assert error.mean().abs() < 5 / math.sqrt(len(error))
    assert (error**2).mean() - 1 == pytest.approx(0, abs=5 * math.sqrt(2 / len(error)))
    assert torch.corrcoef(torch.stack([error, cover[free]]))[0, 1].abs() < 5 / math.sqrt(len(error))


def test_clouds_leave_targets_alone(begin):
    plain, cloudy = scene.UniformTargets((2, 6)), scene.CloudyTargets(scene.UniformTargets((2, 6)))
    for name, value in plain.draw(key()).items():
        assert torch.equal(cloudy.draw(key())[name], value)
    plain, cloudy = begin(plain), begin(cloudy)
    assert torch.equal(cloudy.available, plain.available)
    assert torch.equal(cloudy.priority, plain.priority)
    assert torch.equal(cloudy.r_LP_P, plain.r_LP_P)
    assert cloudy.cloud_cover.shape == cloudy.cloud_forecast.shape == cloudy.cloud_forecast_sigma.shape == (4, 5)


def test_cloudy_targets_are_not_available(begin, move):
    cover = rand.per_env([[0.1, 0.6, 2.0], [0.5, 0.51, -1.0]])
    scenario = begin(scene.CloudyTargets(scene.UniformTargets(3), cover, forecast_sigma=0.0, largest_forecast=0.5), 2)
    assert scenario.cloud_cover.tolist() == [[0.1, 0.6, 1.0], [0.5, 0.51, 0.0]]
    assert torch.equal(scenario.cloud_forecast, scenario.cloud_cover)
    assert scenario.available.tolist() == [[True, False, False], [True, False, True]]
    before = scenario.available
    move(scenario, 100.0)
    assert scenario.available is before


def test_clouds_have_the_targets_of_their_scenario(begin):
    scenario = begin(scene.CloudyTargets(scene.UniformTargets((1, 4)), 0.0, 0.0, largest_forecast=0.5), 50)
    assert torch.equal(scenario.available, scenario.drawn("target_exists").bool())
    assert not scenario.available.all()
    shared = scene.CloudyTargets(scene.UniformTargets(3))
    one, two = begin(shared, key(2)), begin(shared, key(2, seed=8))
    assert not torch.equal(one.priority, two.priority)
    assert not hasattr(shared.targets, "fleet")
    scenario = begin(scene.CloudyTargets(scene.Targets([[6.4e6, 0, 0]], names=["Quito"])))
    assert scenario.target_names == scenario.names(0) == ["Quito"]
    plain = scene.UniformTargets(2)
    assert scene.CloudyTargets(plain, lambda: 0.5).calls_user
    assert scene.CloudyTargets(scene.UniformTargets(2, lambda: 0.5)).calls_user
    assert not scene.CloudyTargets(plain).calls_user


def test_changing_targets_under_clouds(begin, move):
    fire = one_fire()
    assert not begin(scene.CloudyTargets(fire, cover=0.3, forecast_sigma=0.0, largest_forecast=0.2), 1).available.any()
    scenario = begin(scene.CloudyTargets(fire, cover=0.1, forecast_sigma=0.0, largest_forecast=0.2), 1)
    for time, priority, available in ((0.0, 0.0, False), (2000.0, 0.75, True), (3500.0, 0.0, False)):
        move(scenario, time)
        assert (scenario.priority.item(), scenario.available.item()) == (pytest.approx(priority), available)


class Everywhere(scene.UniformTargets):
    """Always the same tensor of what is available."""

    always = torch.ones(2, 30, dtype=torch.bool)

    @property
    def available(self):
        return self.always


@pytest.mark.parametrize("targets", [scene.UniformTargets((1, 31)), Everywhere(30)])
def test_new_targets_and_forecasts_show_after_a_reset(begin, targets):
    scenario = begin(scene.CloudyTargets(targets, largest_forecast=0.5), 2)
    before, rows = scenario.available, torch.tensor([0, 1])
    scenario.fleet.keep(rows, scenario.draw(key(2, episode=1)))
    scenario.reset(rows)
    exists = scenario.drawn("target_exists").bool()
    assert torch.equal(scenario.available, (scenario.cloud_forecast <= 0.5) & exists)
    assert not torch.equal(scenario.available, before)
