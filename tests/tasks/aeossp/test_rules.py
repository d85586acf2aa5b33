"""The rules against reports of the benchmark's verifier, with brahe 1.8.0."""

import dataclasses

import numpy as np
import pytest

from bsk_torch.tasks.aeossp import Observations, check
from bsk_torch.tasks.aeossp.files import iso

ANGLE = 1e-5
"""Degrees: brahe moves the orbit by up to 0.5 mm, and rounds the frames otherwise."""

CHARGE = 0.002
"""Part by which energies of panels differ: the verifier's Sun is 0.08 deg off, which moves ends of the shadow by 10 s."""


@pytest.fixture(scope="module")
def result(case, observations, positions):
    return check(case, observations, positions)


def moved(observations, number, seconds):
    """A plan with one observation some seconds later."""
    start, end = observations.start_s.copy(), observations.end_s.copy()
    start[number] += seconds
    end[number] += seconds
    return dataclasses.replace(observations, start_s=start, end_s=end)


def test_metrics_are_those_of_the_verifier(result, report):
    assert result.valid is report["valid"] is True
    for name in ("WCR", "CR", "TAT"):
        assert getattr(result, name) == pytest.approx(report["metrics"][name], rel=1e-12)
    assert pytest.approx(report["metrics"]["PC"], abs=1e-4) == result.PC


def test_completed_tasks_are_those_of_the_verifier(result, report, case, observations):
    assert len(case.requests) == len(report["per_task"])
    for k, name in enumerate(case.requests.names):
        theirs, ours = report["per_task"][name], int(result.completed[k])
        assert theirs["completed"] == (ours >= 0)
        if ours >= 0:
            assert theirs["completed_by_action_index"] == ours
            assert theirs["completion_time"] == iso(case, int(observations.end_s[ours]))


def test_slews_are_those_of_the_verifier(result, report, observations):
    windows = {window["action_index"]: window for window in report["maneuver_windows"]}
    assert sorted(windows) == list(range(len(observations)))
    for k, window in windows.items():
        assert result.slews.degrees[k] == pytest.approx(window["slew_angle_deg"], abs=ANGLE)
        assert result.slews.required[k] == pytest.approx(window["required_gap_s"], abs=20 * ANGLE)
        before = window["from_action_index"]
        assert result.slews.previous[k] == (-1 if before is None else before)


def test_batteries_are_those_of_the_verifier(result, report, case):
    names = {
        "used_wh": ("gross_consumption_wh", 0.0, 1e-4),
        "imaging_s": ("total_imaging_time_s", 0.0, 1e-9),
        "slewing_s": ("total_slew_time_s", 0.0, 1e-3),
        "charged_wh": ("total_charge_wh", CHARGE, 0.0),
        "least_wh": ("minimum_battery_wh", CHARGE, 0.0),
        "final_wh": ("final_battery_wh", CHARGE, 0.0),
    }
    assert len(case.satellites) == len(report["per_satellite_resource_summary"])
    for k, satellite in enumerate(case.satellites):
        theirs = report["per_satellite_resource_summary"][satellite.name]
        for ours, (name, relative, absolute) in names.items():
            assert getattr(result.power, ours)[k] == pytest.approx(theirs[name], rel=relative, abs=absolute), ours


def test_verdicts_on_moved_observations_are_those_of_the_verifier(case, observations, positions, report):
    verdicts = [check(case, moved(observations, number, seconds), positions).valid for number, seconds, _ in report["moved"]]
    assert verdicts == [valid for *_, valid in report["moved"]]
    assert {True, False} == set(verdicts)


def test_batteries_are_full_at_most_and_never_below_zero(case, observations, positions):
    weak = [dataclasses.replace(satellite, initial_wh=10.0) for satellite in case.satellites]
    empty = check(dataclasses.replace(case, satellites=tuple(weak)), observations, positions)
    assert not empty.valid
    assert empty.WCR == empty.CR == empty.PC == 0.0
    assert empty.TAT is None
    assert any(number == -1 and "'sat_003'" in text for number, text in empty.violations)
    small = [dataclasses.replace(satellite, capacity_wh=900.0, initial_wh=900.0) for satellite in case.satellites]
    power = check(dataclasses.replace(case, satellites=tuple(small)), observations, positions).power
    assert (power.final_wh <= 900.0).all()
    assert (power.final_wh < 900.0 + power.charged_wh - power.used_wh - 1.0).any()  # what came while it was full is lost
    assert ((power.full_s >= 0.0) & (power.full_s <= power.least_s)).all()


def test_each_rule_has_its_violation(case, observations, positions):
    requests = case.requests
    wrong = {
        "leaves the cone": moved(observations, 0, 0),
        "ends at": dataclasses.replace(observations, end_s=np.where(np.arange(len(observations)) == 3, 0, observations.end_s)),
        "lasts": dataclasses.replace(observations, end_s=observations.end_s + 5 * (np.arange(len(observations)) == 3)),
        "window": moved(observations, 3, int(requests.due_s[observations.task[3]] - observations.start_s[3])),
        "sensor": dataclasses.replace(
            observations, satellite=np.where(np.arange(len(observations)) == 3, 2, observations.satellite)
        ),
        "overlaps": Observations(*(np.concatenate([column, column[:1]]) for column in dataclasses.astuple(observations))),
    }
    narrow = dataclasses.replace(case, satellites=tuple(dataclasses.replace(s, off_nadir=1.0) for s in case.satellites))
    slow = dataclasses.replace(case, satellites=tuple(dataclasses.replace(s, slew_rate=0.05) for s in case.satellites))
    for text, plan in wrong.items():
        result = check(narrow if text == "leaves the cone" else case, plan, positions)
        assert any(text in reason for _, reason in result.violations), text
    assert any("slew and settling" in reason for _, reason in check(slow, observations, positions).violations)


def test_plans_without_observations_are_valid(case, positions):
    nothing = np.empty(0, dtype=np.int64)
    result = check(case, Observations(nothing, nothing, nothing, nothing), positions)
    idle = sum(satellite.idle_w for satellite in case.satellites) * case.horizon_s / 3600.0
    assert result.valid
    assert result.TAT is None
    assert pytest.approx(idle) == result.PC
