import math

import pytest
import torch

from bsk_torch import rand, scene
from bsk_torch.constants import R_EARTH
from tests.support.refusals import check_refusals, refusal

from .conftest import MANY, key, rows_of

FIVE_SIGMA = 5.0 / math.sqrt(MANY)  # sampling error of a mean of MANY draws, in standard deviations


def test_positions_are_uniform_by_area():
    """Moments of a uniform direction: mean 0, second moments 1/3 on the diagonal and 0 off it, fourth 1/5; odd ones vanish."""
    r = scene.UniformTargets(4).draw(key(MANY // 4))["target_r_LP_P"].reshape(-1, 3) / R_EARTH
    assert r.norm(dim=-1) == pytest.approx(torch.ones(MANY).tolist(), abs=1e-15)
    assert r.mean(0).abs().max() < FIVE_SIGMA * math.sqrt(1 / 3)
    second = (r.mT @ r) / MANY
    assert (second - torch.eye(3) / 3).abs().max() < FIVE_SIGMA * math.sqrt(1 / 5 - 1 / 9)
    assert ((r**4).mean(0) - 1 / 5).abs().max() < FIVE_SIGMA * math.sqrt(1 / 9 - 1 / 25)
    # Chi-square over 200 cells of equal area: 199 degrees of freedom, so five standard deviations above 199 is 299.
    r = scene.UniformTargets(4).draw(key(MANY // 4))["target_r_LP_P"].reshape(-1, 3) / R_EARTH
    band = ((r[:, 2] + 1.0) * 5.0).long().clamp(max=9)
    sector = ((torch.atan2(r[:, 1], r[:, 0]) / math.pi + 1.0) * 10.0).long().clamp(max=19)
    counts = torch.bincount(band * 20 + sector, minlength=200)
    expected = MANY / 200
    assert float(((counts - expected) ** 2 / expected).sum()) < 199 + 5 * math.sqrt(2 * 199)


def test_priorities_are_uniform_by_default():
    priority = scene.UniformTargets(4).draw(key(MANY // 4))["target_priority"].flatten()
    assert 0 <= priority.min() < 1e-3
    assert 1 - 1e-3 < priority.max() < 1
    assert priority.mean() == pytest.approx(0.5, abs=FIVE_SIGMA / math.sqrt(12))
    assert torch.corrcoef(priority.view(-1, 4).mT).fill_diagonal_(0).abs().max() < 5 / math.sqrt(MANY / 4)


@pytest.mark.parametrize(
    "scenario",
    [
        scene.UniformTargets((2, 9)),
        scene.UniformTargets((2, 9), rand.Choice([1, 5, 10])),
        scene.CloudyTargets(scene.UniformTargets(8)),
        scene.Wildfires((2, 9)),
    ],
    ids=["uniform", "choice", "cloudy", "wildfires"],
)
def test_an_environment_draws_the_same_in_any_batch(scenario):
    """Environment 7 alone, in a batch of 8, and in a shuffled batch."""
    whole, alone = scenario.draw(key(8)), scenario.draw(rows_of(key(8), [7]))
    shuffled = scenario.draw(rows_of(key(8), [3, 7, 0]))
    by_environment = {name: value for name, value in whole.items() if len(value) == 8}
    assert by_environment
    for name, value in by_environment.items():
        assert torch.equal(value[7:], alone[name]), name
        assert torch.equal(value[[3, 7, 0]], shuffled[name]), name


def test_episodes_seeds_and_environments_differ():
    scenario = scene.UniformTargets(5)
    base, other, seeded = (scenario.draw(k) for k in (key(4), key(4, episode=1), key(4, seed=8)))
    for name in ("target_r_LP_P", "target_priority"):
        assert (base[name] != other[name]).all()
        assert (base[name] != seeded[name]).all()
        assert (base[name][1:] != base[name][:-1]).all()


def test_numbers_of_targets_leave_out_the_upper_bound(begin):
    """(3, 6) means 3, 4 or 5 targets, equally often."""
    scenario = begin(scene.UniformTargets((3, 6)), MANY)
    assert scenario.most_targets == 5
    count = scenario.available.sum(-1)
    for number in (3, 4, 5):
        assert (count == number).double().mean() == pytest.approx(1 / 3, abs=FIVE_SIGMA * math.sqrt(2 / 9))
    assert torch.equal(scenario.available, torch.arange(5) < count.unsqueeze(-1))
    assert (scenario.priority[~scenario.available] == 0).all()
    assert (scenario.priority[scenario.available] > 0).double().mean() > 0.999
    assert scenario.r_LP_P.isfinite().all()


def test_a_fixed_number_exists_everywhere_at_the_radius_and_costs_nothing_per_step(begin, move):
    scenario = begin(scene.UniformTargets(3))
    assert scenario.draw(key(9))["target_exists"].shape == (1, 3)
    assert scenario.available.all()
    assert scenario.available.shape == (4, 3)
    assert scenario.target_names == scenario.names(2) == ["tgt-0", "tgt-1", "tgt-2"]
    scenario = begin(scene.UniformTargets(3))
    before = scenario.r_LP_P, scenario.priority, scenario.available
    move(scenario, 60.0)
    assert all(a is b for a, b in zip(before, (scenario.r_LP_P, scenario.priority, scenario.available), strict=True))
    r = scene.UniformTargets(3, radius=6.4e6).draw(key())["target_r_LP_P"]
    assert torch.allclose(r.norm(dim=-1), torch.tensor(6.4e6, dtype=torch.float64), rtol=1e-15)


def test_a_reset_of_some_rows_shows(begin):
    scenario = begin(scene.UniformTargets((1, 40)), 3)
    before, rows = scenario.available, torch.tensor([1])
    scenario.fleet.keep(rows, scenario.draw(rows_of(key(3, episode=1), [1])))
    scenario.reset(rows)
    assert torch.equal(scenario.available[[0, 2]], before[[0, 2]])
    assert not torch.equal(scenario.available[1], before[1])


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (2.5, [[2.5] * 3]),
        ([1, 2, 3], [[1, 2, 3]]),
        (rand.per_env([[1, 2, 3], [4, 5, 6]]), [[1, 2, 3], [4, 5, 6]]),
        (rand.per_env([7.0, 8.0]), [[7] * 3, [8] * 3]),
        (rand.per_env([torch.arange(3), torch.ones(3)]), [[0, 1, 2], [1, 1, 1]]),
    ],
)
def test_given_priorities(given, expected):
    assert scene.UniformTargets(3, given).draw(key(2))["target_priority"].tolist() == expected


@pytest.mark.parametrize("distribution", [rand.Uniform(2, 3), rand.Normal(5, 2), rand.Choice([1, 4, 9]), rand.Uniform(2, 3, 3)])
def test_distributions_draw_a_number_for_each_target(distribution):
    priority = scene.UniformTargets(3, distribution).draw(key(5))["target_priority"]
    sized = type(distribution)(*[v for k, v in vars(distribution).items() if k != "size"], size=3)
    assert torch.equal(priority, sized.draw(key(5).named("target_priority")))
    assert priority.shape == (5, 3)
    assert len(set(priority.flatten().tolist())) > 2


def test_priorities_may_be_drawn_by_classes_and_callables():
    class Ramp(rand.Distribution):
        def draw(self, key):
            return torch.arange(3.0) + key.env_id.unsqueeze(-1)

    assert scene.UniformTargets(3, Ramp()).draw(key(2))["target_priority"].tolist() == [[0, 1, 2], [1, 2, 3]]
    calls = iter(range(100))
    scenario = scene.UniformTargets(3, lambda: next(calls))
    assert scenario.calls_user
    assert not scene.UniformTargets(3).calls_user
    assert scenario.draw(key(2))["target_priority"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert scene.Scenario().draw(key()) == {}
    assert not scene.Scenario().calls_user


def test_own_layouts_are_checked(begin):
    class Half(scene.TargetScenario):
        most_targets = 2

        def draw(self, key):
            return {"target_r_LP_P": torch.full((1, 2, 3), 4e6).double(), "target_priority": torch.ones(1, 3)} | self.more

        more = {}  # noqa: RUF012

    check_refusals(refusal(lambda: begin(Half()), ValueError, "Half.draw(key)", "'target_priority'", "[1, 3]", "[1, 2]"))
    Half.more = {"target_priority": torch.ones(1, 2).double()}
    check_refusals(refusal(lambda: begin(Half()), ValueError, "Half.draw(key)", "'target_exists'", "[1, 2]"))
    Half.more |= {"target_exists": torch.ones(1, 2).double()}
    assert begin(Half()).priority.tolist() == [[1, 1]] * 4
    Half.more |= {"target_r_LP_P": torch.full((1, 2, 3), 4e3).double()}
    check_refusals(refusal(lambda: begin(Half()), ValueError, "r_LP_P", "0", "[4000.0, 4000.0, 4000.0]", "6928.2"))
