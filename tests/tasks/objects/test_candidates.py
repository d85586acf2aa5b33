"""The order of candidates, and what imagers see of them."""

import math

import pytest
import torch

from bsk_torch.tasks.objects.candidates import BEHIND, HIGHEST, LOWEST, Moment, in_order, views

R = 7e6


def at_elevation(degrees, distance):
    """A point at an elevation above the horizontal of a satellite on the x axis."""
    angle = math.radians(degrees)
    return [R + distance * math.sin(angle), distance * math.cos(angle), 0.0]


def order(points, eligible=None):
    r_TN_N = torch.tensor([points], dtype=torch.float64).movedim(-1, 0)
    known = torch.ones(1, len(points), dtype=torch.bool) if eligible is None else torch.tensor([eligible])
    found = in_order(r_TN_N, torch.tensor([[R, 0.0, 0.0]], dtype=torch.float64), known)
    return [k if exists else None for k, exists in zip(found.place[0].tolist(), found.exists[0].tolist(), strict=True)]


def test_low_ones_come_first_then_near_ones():
    points = [at_elevation(*x) for x in ((30.0, 2e6), (-60.0, 9e5), (-20.0, 5e6), (-22.0, 4e5), (89.0, 1e5))]
    assert order(points) == [2, 0, 4, 3, 1]


def test_equal_ones_keep_the_order_of_the_catalog():
    assert order([at_elevation(10.0, 1e6)] * 3 + [at_elevation(-50.0, 1e6)] * 2) == [0, 1, 2, 3, 4]


def test_others_than_eligible_ones_do_not_exist():
    points = [at_elevation(10.0 + k, 1e6) for k in range(3)]
    assert order(points, [False, True, False]) == [1, None, None]


def test_ranks_of_both_kinds_do_not_meet():
    assert LOWEST < HIGHEST < BEHIND


def test_a_target_straight_ahead():
    """On a circular orbit along y, 100 km ahead and 1 km/s faster; the axis of the instrument points up."""

    def row(*x):
        return torch.tensor([x], dtype=torch.float64)

    at = Moment(row(R, 0.0, 0.0), row(0.0, 7500.0, 0.0), row(1.0, 0.0, 0.0), row(1.5e11, 0.0, 0.0))
    seen = views(row(R, 1e5, 0.0)[None], row(0.0, 8500.0, 0.0)[None], row(R, 1e5, 0.0)[None], at)
    assert seen.target_elevation_angle.item() == pytest.approx(0.0, abs=1e-12)
    assert seen.rel_pos_vector_r_BR_H[0, 0].tolist() == pytest.approx([0.0, 1e5, 0.0])
    assert seen.rel_vel_vector_v_BR_H[0, 0].tolist() == pytest.approx([0.0, 1000.0, 0.0])
    assert seen.angle_to_target.item() == pytest.approx(90.0)
    assert seen.target_distance.item() == pytest.approx(1e5)
    assert seen.target_illumination_factor.item() == 1.0
