"""Targets whose true places lie near the believed ones."""

import math

import pytest
import torch

from bsk_torch import rand, scene
from bsk_torch.constants import R_EARTH
from bsk_torch.scene.overlaid import displaced

from .conftest import MANY, key, rows_of


def test_errors_are_normal_in_two_directions():
    """The squared distance over sigma^2 has the mean 2 and the variance 4 of two normals; 3 km of arc are 3 km of chord."""
    drawn = scene.UncertainTargets(scene.UniformTargets(4), sigma=3000.0).draw(key(MANY // 4))
    believed, true = drawn["target_r_LP_P"], drawn["true_r_LP_P"]
    assert drawn["location_sigma"].unique().tolist() == [3000.0]
    torch.testing.assert_close(true.norm(dim=-1), believed.norm(dim=-1), rtol=1e-14, atol=0.0)
    squares = ((true - believed).norm(dim=-1) / 3000.0).square()
    assert squares.mean() == pytest.approx(2.0, abs=5.0 * 2.0 / math.sqrt(MANY))
    assert (squares > 4.0).double().mean() == pytest.approx(math.exp(-2.0), abs=5.0 * 0.35 / math.sqrt(MANY))


def test_a_displacement_is_an_arc_in_two_perpendicular_directions():
    """At poles and along axes, too, where one coordinate axis gives no direction."""
    places = R_EARTH * torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.8]], dtype=torch.float64)
    one, other = torch.tensor([1e5, 0.0]).double(), torch.tensor([0.0, 1e5]).double()
    for error in (one, other, torch.tensor([6e4, -8e4]).double()):
        moved = displaced(places, error.expand(4, 2))
        torch.testing.assert_close(moved.norm(dim=-1), torch.full((4,), R_EARTH, dtype=torch.float64), rtol=1e-15, atol=0.0)
        angle = torch.atan2(torch.linalg.cross(moved, places).norm(dim=-1), (moved * places).sum(-1))
        torch.testing.assert_close(angle, torch.full((4,), 1e5 / R_EARTH, dtype=torch.float64), rtol=1e-12, atol=0.0)
    first, second = (displaced(places, error.expand(4, 2)) - places for error in (one, other))
    # the radial parts of both chords are the same, -1e5^2 / 2 R
    assert float((first * second).sum(-1).abs().max()) == pytest.approx((1e10 / (2.0 * R_EARTH)) ** 2, rel=1e-3)
    assert torch.equal(displaced(places, torch.zeros(4, 2).double()), places)


def test_errors_leave_targets_alone_and_belong_to_their_episode(begin):
    plain = scene.UniformTargets((2, 6))
    uncertain = scene.UncertainTargets(plain, sigma=rand.Uniform(1e3, 2e3))
    whole = key()
    for name, value in plain.draw(whole).items():
        assert torch.equal(uncertain.draw(whole)[name], value)
    alone = uncertain.draw(rows_of(whole, [2]))
    assert torch.equal(alone["true_r_LP_P"], uncertain.draw(whole)["true_r_LP_P"][2:3])
    linked = begin(uncertain)
    assert (linked.location_sigma.shape, linked.true_r_LP_P.shape) == ((4, 5), (4, 5, 3))
    assert 1e3 <= float(linked.location_sigma.min()) < float(linked.location_sigma.max()) < 2e3
    assert torch.equal(linked.available, begin(plain).available)


def test_clouds_and_errors_add_up_and_callables_are_known(begin):
    both = begin(scene.UncertainTargets(scene.CloudyTargets(scene.UniformTargets(3), largest_forecast=0.5), sigma=0.0))
    assert torch.equal(both.true_r_LP_P, both.r_LP_P)
    assert torch.equal(both.available, both.drawn("cloud_forecast") <= 0.5)
    assert scene.UncertainTargets(scene.UniformTargets(2), lambda: 10.0).calls_user
    assert not scene.UncertainTargets(scene.UniformTargets(2)).calls_user
