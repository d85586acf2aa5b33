"""What ``scripts/validation/drift.py`` makes of flights; tests/test_scripts.py flies some."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pytest

from bsk_torch.lab.basilisk.flight import Problem, Start

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "validation"))

from drift import TWIN, Episode, angles, compared, differences, given, told


def mrp(angle: float, axis: tuple[float, float, float]) -> np.ndarray:
    """MRP [1, 3] of a rotation."""
    return np.tan(angle / 4.0) * np.array([axis])


@pytest.mark.parametrize("small", [1e-12, 1e-3, 2.0])
def test_the_angle_between_attitudes_is_that_of_the_turn(small):
    axis = (0.6, 0.0, 0.8)
    assert angles(mrp(1.0, axis), mrp(1.0 + small, axis)) == pytest.approx(small, rel=2e-4)


def test_an_attitude_and_its_shadow_are_the_same():
    sigma = mrp(2.5, (0.0, 0.6, 0.8))
    assert angles(sigma, -sigma / (sigma * sigma).sum()) == pytest.approx(0.0, abs=1e-15)


def track(position: float, steps: int = 3) -> dict[str, np.ndarray]:
    """A satellite that stays at a position for some decisions."""
    return {"position, m": np.full((steps + 1, 3), position), "reward": np.ones(steps)}


def test_a_release_is_compared_with_its_twin_the_one_before_the_last_one_and_bsk_torch():
    found = {
        "1.0": [track(1.0), track(1.25)],
        "1.1": "ValueError: it has no wheels",
        "1.2": [track(5.0), track(5.5)],
        "1.3": [track(7.0), track(7.0)],
        "1.4": [track(7.0), track(7.0)],
        "1.5": [track(7.5), track(7.25)],
    }
    first, failed, second, third, same, last = compared(found, [track(2.0)], "NadirScan-v1")
    assert failed == {"preset": "NadirScan-v1", "release": "1.1", "error": "ValueError: it has no wheels"}
    assert "previous" not in first
    assert [second[name]["position, m"] for name in ("twin", "previous", "latest", "here")] == [0.5, 4.0, 2.5, 3.0]
    assert [row["changed"] for row in (first, second, third, same, last)] == [[], [], ["position, m"], [], []]
    assert last["latest"] == {"position, m": 0.0, "reward": 0.0}
    assert first["decisions"] == [3]
    assert told(failed) == "NadirScan-v1 on 1.1: ValueError: it has no wheels"
    lines = ["the first to fly", "up to rounding", "changed position, m by 2.0e+00", "bit for bit as before", "up to rounding"]
    for row, line in zip((first, second, third, same, last), lines, strict=True):
        assert line in told(row)
    assert "position, m 3.0e+00 (5.0e-01)" in told(second)


def test_flights_of_different_length_are_compared_as_far_as_both_go():
    assert differences([track(1.0, 3)], [track(1.0, 5)]) == {"position, m": 0.0, "reward": 0.0}


def test_a_twin_differs_in_its_initial_conditions_only():
    sat_args = {"sigma_init": [0.1, 0.2, 0.3], "rN": [7e6, 0.0, 0.0], "storedCharge_Init": 2.0, "u_max": 0.2}
    problem = Problem("NadirScan-v1", {}, {}, False, (), (), ())
    twin = Episode(problem, Start(0, sat_args, {}, 100.0), np.zeros(1, dtype=np.int64)).twin()
    for name in ("sigma_init", "rN", "storedCharge_Init"):
        relative = (np.array(twin.start.sat_args[name]) - sat_args[name]) / np.maximum(np.abs(sat_args[name]), 1e-300)
        assert relative.max() == pytest.approx(TWIN, rel=0.05), name
    assert twin.start.sat_args["u_max"] == sat_args["u_max"]
    assert sat_args["rN"] == [7e6, 0.0, 0.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [("panelEficiency=0.2", r"did you mean 'panelEfficiency'"), ("panelEfficiency=high", "must be NAME=NUMBER"), ("", "valid")],
)
def test_arguments_that_bsk_rl_lacks_are_errors(text, message):
    with pytest.raises(argparse.ArgumentTypeError, match=message):
        given(text)


def test_arguments_are_given_by_name():
    assert given("panelEfficiency=0.25") == ("panelEfficiency", 0.25)
