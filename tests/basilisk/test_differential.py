"""differential.py: what it draws, how it compares, and a few random problems flown on Basilisk."""

from __future__ import annotations

import copy
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "validation"))

from differential_compare import judge
from differential_draw import FAMILIES, draw_case
from differential_flight import Flight, Record


def flight(*values: float) -> Flight:
    """A flight whose attitude takes these values."""
    return Flight([Record({"time": np.array(float(k)), "Sat0 sigma_BN": np.full(3, value)}) for k, value in enumerate(values)])


def test_a_seed_gives_the_same_problem_and_all_families_are_drawn():
    assert repr(draw_case(5, 3)) == repr(draw_case(5, 3))
    assert {draw_case(seed, 2).family for seed in range(120)} == set(FAMILIES)


def test_the_first_difference_counts_until_a_twin_parts():
    case, there = draw_case(1, 2), flight(0.1, 0.2, 0.3)
    assert judge(case, copy.deepcopy(there), there, flight(0.1, 0.2, 0.3)).word == "same"
    wrong = judge(case, flight(0.1, 0.2001, 0.3), there, flight(0.1, 0.2, 0.3))
    assert (wrong.word, wrong.finding.step, wrong.finding.quantity) == ("different", 1, "Sat0 sigma_BN[0]")
    assert judge(case, flight(0.1, 0.2, 0.4), there, flight(0.1, 0.21, 0.3)).word == "chaos"


@pytest.mark.basilisk
@pytest.mark.parametrize("seed", [4, 9, 13, 16])
def test_random_problems_are_those_of_basilisk(seed):
    pytest.importorskip("bsk_rl")
    from differential import compare, libraries

    here, there = libraries("bsk_torch")
    verdict = compare(draw_case(seed, 30), here, there, "compiled")
    assert verdict.word == "same", verdict
