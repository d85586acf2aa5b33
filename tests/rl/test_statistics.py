"""Means, fractions and their intervals."""

import pytest
import torch

from bsk_torch.rl.evaluation.statistics import confidence, mean, student_quantile, wilson


@pytest.mark.parametrize(("freedom", "expected"), [(9, 2.26216), (20, 2.08596), (255, 1.96931)])
def test_student_quantile_agrees_with_tables(freedom, expected):
    assert student_quantile(0.975, freedom) == pytest.approx(expected, abs=1e-3)


def test_intervals_of_worked_examples():
    # 1 ... 10: mean 5.5, standard deviation 3.02765, t(0.975, 9) = 2.26216
    estimate = confidence(torch.arange(1.0, 11.0))
    assert (estimate.mean, estimate.half_width) == (5.5, pytest.approx(2.26216 * 3.02765 / 10**0.5, abs=1e-3))
    assert confidence(torch.ones(1)).half_width == float("inf")
    low, high = wilson(3, 40)
    assert wilson(37, 40) == pytest.approx((1.0 - high, 1.0 - low), abs=1e-12)
    assert mean(torch.tensor([True, False, False, False])) == 0.25


@pytest.mark.parametrize(("successes", "trials", "bounds"), [(81, 263, (0.2553, 0.3662)), (0, 20, (0.0, 0.1611))])
def test_wilson_interval_of_worked_examples(successes, trials, bounds):
    # R. G. Newcombe, Statistics in Medicine 17 (1998), table I: to four digits
    assert wilson(successes, trials) == pytest.approx(bounds, abs=5e-5)
