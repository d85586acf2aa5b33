import math

import pytest
import torch

from bsk_torch import rand, scene
from bsk_torch.constants import R_EARTH

from .conftest import MANY, key, rows_of

FIVE_SIGMA = 5.0 / math.sqrt(MANY)  # sampling error of a mean of MANY draws, in standard deviations


class Deadlines(scene.ChangingTargets, scene.UniformTargets):
    """The example of the documentation, with deadlines a minute apart and priorities that grow."""

    def draw(self, key):
        deadline = 60.0 * (1.0 + torch.arange(self.most_targets)).double().unsqueeze(0)
        return super().draw(key) | {"target_deadline": deadline}

    def at(self, time):
        return self.drawn("target_priority") + time.unsqueeze(-1), time.unsqueeze(-1) < self.drawn("target_deadline")


def test_targets_change_with_time(begin, move):
    scenario = begin(Deadlines(3, 2.0), 2)
    assert scenario.available.all()
    assert scenario.priority.tolist() == [[2] * 3] * 2
    move(scenario, torch.tensor([59.0, 120.0]))
    assert scenario.available.tolist() == [[True, True, True], [False, False, True]]
    assert scenario.priority.tolist() == [[61] * 3, [122] * 3]


def test_a_step_is_paid_by_what_was_seen_before(begin, move):
    """While the simulation moves, priorities stay; they follow after the reward."""
    scenario = begin(Deadlines(2, 2.0), 1)
    scenario.fleet.sim_time += 100.0
    assert scenario.priority.tolist() == [[2, 2]]
    assert scenario.available.all()
    assert scenario.priority is scenario.priority
    move(scenario, 100.0)
    assert (scenario.priority.tolist(), scenario.available.tolist()) == ([[102, 102]], [[False, True]])


def test_reset_begins_anew_and_leaves_the_others(begin, move):
    scenario = begin(Deadlines(2, rand.Uniform()), 2)
    move(scenario, 80.0)
    before = scenario.priority
    fleet, rows = scenario.fleet, torch.tensor([1])
    fleet.keep(rows, scenario.draw(rows_of(key(2, episode=1), [1])))
    fleet.sim_time[1] = 0.0
    scenario.reset(rows)
    assert torch.equal(scenario.priority[0], before[0])
    assert scenario.priority[1].max() < 1.0
    assert scenario.available.tolist() == [[False, True], [True, True]]


def test_padding_never_appears(begin, move):
    scenario = begin(Deadlines((1, 5), 2.0), 50)
    exists = scenario.drawn("target_exists").bool()
    assert not exists.all()
    assert torch.equal(scenario.available, exists)
    move(scenario, 30.0)
    assert torch.equal(scenario.available, exists)
    assert torch.equal(scenario.priority, torch.where(exists, 32.0, 0.0).double())


def test_present_targets_can_be_read_before_the_first_reset(begin):
    scenario = begin(Deadlines(2, 2.0), 1)
    scenario._present = None
    assert scenario.priority.tolist() == [[2, 2]]


def one_fire(**options) -> scene.Wildfires:
    course = dict(ignition=1000.0, rate_of_spread=1.0, burning_time=2500.0)
    return scene.Wildfires(1, 3.0, **course | dict(length_to_breadth=1.0, full_area=4e6 * math.pi) | options)


@pytest.mark.parametrize(
    ("time", "priority", "available"),
    [  # a circle of radius 1 m/s (t - 1000 s); 2 km make the full area
        (0.0, 0.0, False),
        (999.0, 0.0, False),
        (1000.0, 0.0, True),
        (1500.0, 3.0 / 16.0, True),
        (2000.0, 3.0 / 4.0, True),
        (3000.0, 3.0, True),
        (3499.0, 3.0, True),
        (3500.0, 0.0, False),
        (9000.0, 0.0, False),
    ],
)
def test_a_round_fire(begin, move, time, priority, available):
    scenario = begin(one_fire(), 2)
    move(scenario, time)
    assert scenario.priority.flatten().tolist() == pytest.approx([priority] * 2, rel=1e-14)
    assert scenario.available.tolist() == [[available]] * 2


@pytest.mark.parametrize("ratio", [1.0, 1.5, 4.0])
def test_burnt_area_is_van_wagners(begin, ratio):
    """pi / 2 (v + w) u t^2 with rates v at the head, u at the flanks and w at the back, w / v as Alexander gives it."""
    scenario = begin(one_fire(rate_of_spread=0.7, length_to_breadth=ratio), 1)
    root = math.sqrt(1.0 - 1.0 / ratio**2)
    v, w = 0.7, 0.7 * (1.0 - root) / (1.0 + root)
    u = (v + w) / (2.0 * ratio)
    area = scenario.burnt_area(torch.tensor([2200.0]).double())
    assert area.item() == pytest.approx(math.pi / 2.0 * (v + w) * u * 1200.0**2, rel=1e-13)


def test_fires_burn_from_their_ignition_until_they_have_burnt_out(begin):
    scenario = begin(one_fire(), 1)
    assert scenario.burnt_area(torch.tensor([1e5]).double()).item() == pytest.approx(math.pi * 2500.0**2)
    scenario = begin(one_fire(ignition=-1000.0), 1)
    assert scenario.available.all()
    assert scenario.priority.item() == pytest.approx(3.0 / 4.0)
    assert one_fire(ignition=lambda: 5.0).calls_user
    assert not one_fire().calls_user


def test_each_fire_has_its_own_course(begin, move):
    scenario = begin(scene.Wildfires((2, 20)), 500)
    exists = scenario.drawn("target_exists").bool()
    for name, low, high in (("ignition", 0, 17100), ("rate_of_spread", 0.2, 1), ("burning_time", 5400, 21600)):
        drawn = scenario.drawn(f"fire_{name}")
        assert low <= drawn.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < drawn.max() < high
        assert len(drawn.unique()) == drawn.numel()
    move(scenario, 8000.0)
    age = 8000.0 - scenario.drawn("fire_ignition")
    assert torch.equal(scenario.available, exists & (age >= 0) & (age < scenario.drawn("fire_burning_time")))
    assert (scenario.priority[scenario.available] > 0).all()
    assert (scenario.priority <= 1).all()
    assert (scenario.priority[~scenario.available] == 0).all()


def test_regions_get_fires_by_their_area():
    """A northern and a southern zone; the latter crosses 180 degrees and has a third of the sine span of the first, times two."""
    north, south = (30.0, 90.0, -10.0, 20.0), (-90.0, -math.degrees(math.asin(2 / 3)), 150.0, -150.0)
    r = scene.Wildfires(4, regions=[north, south]).draw(key(MANY // 4))["target_r_LP_P"].reshape(-1, 3) / R_EARTH
    longitude = torch.rad2deg(torch.atan2(r[:, 1], r[:, 0]))
    above, below = r[:, 2] > 0, r[:, 2] < 0
    assert r[above, 2].min() > 0.5
    assert r[below, 2].max() < -2 / 3
    assert ((longitude[above] > -10) & (longitude[above] < 20)).all()
    assert (longitude[below].abs() > 150).all()
    assert (longitude[below] > 0).double().mean() == pytest.approx(0.5, abs=FIVE_SIGMA)
    share = (0.5 * 30) / (0.5 * 30 + 1 / 3 * 60)
    assert above.double().mean() == pytest.approx(share, abs=FIVE_SIGMA * math.sqrt(share * (1 - share)))
    assert r[above, 2].mean() == pytest.approx(0.75, abs=5 * 0.5 / math.sqrt(12 * int(above.sum())))


def test_fires_to_come_are_drawn_again_given_that_they_have_not_come(begin):
    scenario = begin(scene.Wildfires(2000, 1.0), 1)
    now, before = 9000.0, {name: scenario.drawn(f"fire_{name}").clone() for name in ("ignition", "burning_time")}
    new = scenario.redraw(torch.tensor([0]), key(1, seed=3), torch.tensor([now], dtype=torch.float64))
    come = before["ignition"] <= now
    for name, old in before.items():
        assert torch.equal(new[f"fire_{name}"][come], old[come])
        assert not bool((new[f"fire_{name}"][~come] == old[~come]).any())
    ignition = new["fire_ignition"][~come]  # uniform from now to the end
    assert float(ignition.min()) > now
    spread = (17100.0 - now) / math.sqrt(12.0 * len(ignition))
    assert float(ignition.mean()) == pytest.approx((17100.0 + now) / 2.0, abs=5.0 * spread)
