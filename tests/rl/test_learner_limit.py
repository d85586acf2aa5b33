"""The simulation of many collecting cores in ``benchmarks/learner_limit.py``."""

import importlib
from pathlib import Path

import pytest


@pytest.fixture
def simulated(monkeypatch):
    """The module of the simulation."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    return importlib.import_module("learner_limit")


def test_constant_costs_add_up_or_overlap(simulated):
    costs = simulated.Costs(3.0, 0.5, 0.25, {1: [8.0], 4: [2.0]})
    assert simulated.seconds_of_batch(costs, 0, False) == pytest.approx(3.0 + 8.0)  # collects itself
    assert simulated.seconds_of_batch(costs, 1, False) == pytest.approx(3.0 + 0.5 + 0.25 + 8.0)
    assert simulated.seconds_of_batch(costs, 4, False) == pytest.approx(3.0 + 0.5 + 0.25 + 2.0)
    assert simulated.seconds_of_batch(costs, 1, True) == pytest.approx(0.5 + 0.25 + 8.0)  # waits for the process
    assert simulated.seconds_of_batch(costs, 4, True) == pytest.approx(0.5 + 3.0)  # the learner is the limit


def test_the_learner_waits_for_the_slowest_process(simulated):
    drawn = [1.0, 2.0]
    costs = simulated.Costs(0.0, 0.0, 0.0, dict.fromkeys((1, 2, 8), drawn))
    expected = {count: 2.0 - 0.5**count for count in (1, 2, 8)}  # the slowest of so many fair coins
    for count, seconds in expected.items():
        assert simulated.seconds_of_batch(costs, count, False) == pytest.approx(seconds, abs=0.03)
