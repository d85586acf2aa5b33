"""Aggregates over tasks and their bootstrap."""

import pytest
import torch

from bsk_torch.lab.suites.aggregates import (
    AGGREGATES,
    bootstrap,
    improvement,
    interquartile_mean,
    interval,
    optimality_gap,
    profile,
    run_scores,
)

# random numbers, five runs in four tasks each; the expected values below are those of rliable 1.2.0
ONE = torch.tensor(
    [
        [1.31, 0.66, 0.81, 0.92],
        [0.56, 0.8, 0.8, 0.27],
        [1.11, 0.98, 0.61, 0.75],
        [0.95, 0.72, 0.73, 0.36],
        [0.97, 0.84, 0.88, 0.34],
    ],
    dtype=torch.float64,
)
OTHER = torch.tensor(
    [
        [1.2, 0.75, 0.58, 1.31],
        [0.69, 0.26, 0.58, 0.01],
        [1.01, 0.58, 0.48, 1.02],
        [0.2, 0.86, 0.08, 0.5],
        [0.34, 1.14, 1.23, 0.6],
    ],
    dtype=torch.float64,
)


def runs(scores, episodes=1):
    """Return the runs of a method, each of whose episodes has the score of the run."""
    return {f"task {k}": column[:, None].expand(-1, episodes) for k, column in enumerate(scores.unbind(-1))}


def test_aggregates_are_those_of_rliable():
    assert float(interquartile_mean(ONE)) == pytest.approx(0.791, abs=1e-12)
    assert float(optimality_gap(ONE)) == pytest.approx(0.2525, abs=1e-12)
    assert float(AGGREGATES["mean"](ONE)) == pytest.approx(0.7685, abs=1e-12)
    assert float(improvement(ONE, OTHER)) == pytest.approx(0.6, abs=1e-12)
    assert profile(ONE, torch.tensor([0.25, 0.5, 0.75, 1.0])).tolist() == pytest.approx([1.0, 0.85, 0.55, 0.1], abs=1e-12)


def test_interval_is_that_of_rliable():
    # rliable, 20,000 replicates: [0.698, 0.866]; the standard error of a percentile of 4,000 replicates is about 0.003
    drawn = bootstrap({"one": runs(ONE)}, replicates=4000)["one"]
    found = interval(interquartile_mean(ONE), interquartile_mean(drawn))
    assert found == pytest.approx((0.791, 0.698, 0.866), abs=0.012)


def test_equal_scores_are_half_an_improvement():
    assert float(improvement(ONE, ONE)) == 0.5


def test_one_run_has_the_uncertainty_of_its_episodes():
    draws = torch.randn(1, 400, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    drawn = bootstrap({"one": {"task": draws}}, replicates=4000)["one"]
    found = interval(draws.mean(), drawn.mean((-2, -1)))
    # the standard error of the mean is 1/20, and 1.96 of it on either side is the interval; that of its ends is about 0.003
    spread = 1.96 * float(draws.std()) / 20.0
    assert (found.value - found.low, found.high - found.value) == pytest.approx((spread, spread), abs=0.012)


def test_methods_play_the_same_resampled_episodes():
    draws = torch.randn(1, 50, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    drawn = bootstrap({"low": {"task": draws}, "high": {"task": draws + 0.01}}, replicates=100)
    assert torch.allclose(drawn["high"] - drawn["low"], torch.tensor(0.01, dtype=torch.float64), atol=1e-12)


def test_replicates_do_not_depend_on_other_methods():
    alone = bootstrap({"one": runs(ONE, 3)}, replicates=10)["one"]
    assert torch.equal(alone, bootstrap({"other": runs(OTHER, 3), "one": runs(ONE, 3)}, replicates=10)["one"])
    assert alone.shape == (10, 5, 4)


def test_scores_of_runs_are_means_over_episodes():
    assert run_scores({"x": torch.tensor([[1.0, 3.0]]), "y": torch.tensor([[5.0]])}).tolist() == [[2.0, 5.0]]
