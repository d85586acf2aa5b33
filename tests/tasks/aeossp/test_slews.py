"""Times of slews in closed form, and displacements of a double integrator against a linear program."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import linprog

from bsk_torch.tasks.aeossp.rules import lines
from bsk_torch.tasks.aeossp.slews import Line, _farthest, flyable, required_gap, verifier


def test_required_gaps_are_those_of_trapezoids(case):
    craft = dataclasses.replace(case.satellites[0], slew_rate=1.0, slew_acceleration=0.25, settling_s=3.0)
    degrees = np.array([0.0, 1.0, 4.0, 14.0])
    np.testing.assert_allclose(required_gap(craft, degrees), 3.0 + np.array([0.0, 4.0, 8.0, 18.0]))


@pytest.mark.parametrize(("begin", "end", "gap"), [(0.0, 0.0, 8.0), (0.5, -0.3, 20.0), (-0.9, 0.8, 9.0), (0.6, 0.7, 3.0)])
def test_farthest_displacement_is_that_of_a_linear_program(begin, end, gap):
    rate, acceleration, n = 1.0, 0.25, 400
    step = gap / n
    # rates at the ends of steps, as sums of accelerations, which are the variables
    total = np.tril(np.ones((n, n))) * step
    middle = begin * gap, (np.vstack([np.zeros(n), total[:-1]]) + 0.5 * step * np.eye(n)).sum(0) * step
    solution = linprog(
        -middle[1],
        A_ub=np.vstack([total, -total]),
        b_ub=np.concatenate([np.full(n, rate - begin), np.full(n, rate + begin)]),
        A_eq=total[-1:],
        b_eq=[end - begin],
        bounds=(-acceleration, acceleration),
    )
    best = middle[0] - solution.fun
    # a step of the program is gap / 400, in which it cannot switch
    assert _farthest(rate, acceleration, np.array(gap), np.array(begin), np.array(end)) == pytest.approx(best, abs=2e-3)


def test_bodies_fly_what_is_at_rest_exactly_as_the_verifier_lets_them(case):
    craft = case.satellites[1]
    angles = np.radians(np.array([0.5, 3.0, 20.0, 40.0]))
    still = Line(np.tile([1.0, 0.0, 0.0], (4, 1)), np.zeros((4, 3)))
    turned = Line(np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], -1), np.zeros((4, 3)))
    exact = required_gap(craft, np.degrees(angles))
    for model in (verifier, flyable):
        assert model(craft, exact + 1e-6, still, turned).all()
        assert not model(craft, exact - 1e-3, still, turned).any()


def test_bodies_need_longer_where_rates_at_the_ends_oppose_a_slew(case):
    craft = case.satellites[1]
    a, b = np.array([[1.0, 0.0, 0.0]]), np.array([[np.cos(0.2), np.sin(0.2), 0.0]])
    gap = required_gap(craft, np.degrees(np.array([0.2])))

    def fits(first, second, across, extra):
        before = Line(a, np.array([[0.0, np.radians(first), np.radians(across)]]))
        after = Line(b, np.radians(second) * np.array([[-np.sin(0.2), np.cos(0.2), 0.0]]))
        return flyable(craft, gap + extra, before, after)[0]

    assert fits(0.4, 0.4, 0.0, 0.01)
    assert not fits(-0.4, -0.4, 0.0, 0.01)
    assert fits(-0.4, -0.4, 0.0, 8.0)
    assert not fits(0.0, 0.0, 0.9, 0.01)
    assert not fits(1.1, 0.0, 0.0, 100.0)  # faster than the satellite may turn


def test_part_of_a_plan_of_the_benchmark_cannot_be_flown(case, observations, positions):
    order = np.lexsort((observations.start_s, observations.satellite))
    plan = observations.take(order)
    follows = np.flatnonzero(plan.satellite[1:] == plan.satellite[:-1]) + 1
    before, after = plan.take(follows - 1), plan.take(follows)
    gap = (after.start_s - before.end_s).astype(float)
    lost = 0
    for number, craft in enumerate(case.satellites):
        mine = after.satellite == number
        ends = lines(positions, before.take(mine), before.end_s[mine], case.step_s)
        starts = lines(positions, after.take(mine), after.start_s[mine], case.step_s)
        assert verifier(craft, gap[mine], ends, starts).all()
        lost += int((~flyable(craft, gap[mine], ends, starts)).sum())
    assert 0.05 < lost / len(follows) < 0.4
