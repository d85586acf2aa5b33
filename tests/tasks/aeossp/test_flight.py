"""Flights of plans of aeossp_standard: what is delivered and why not, orbits, batteries, and margins of plans."""

import dataclasses
import json
import math
from functools import cache

import numpy as np
import pytest

from bsk_torch.astro.earth_rotation import sidereal_time_1982
from bsk_torch.tasks.aeossp import write_solution
from bsk_torch.tasks.aeossp.flight import REASONS, Flight, _simulator, fly
from bsk_torch.tasks.aeossp.geometry import ephemeris_time, on_ellipsoid, orbit, tracks, turned
from bsk_torch.tasks.aeossp.margins import completed_weight, delivered, fitting_factor, thinned
from bsk_torch.tasks.aeossp.rules import check
from tests.support.refusals import check_refusals, refusal
from tests.tasks.aeossp.flown_case import small, write_case

pytestmark = pytest.mark.compiled

EXPECTED = [None, None, "pointing", None, None, None, "off_nadir", None, None, "battery"]


@cache
def flight() -> Flight:
    return fly(*small())


def test_observations_are_delivered_or_missed_for_a_reason():
    found = flight()
    assert [REASONS[k] if k >= 0 else None for k in found.missed] == EXPECTED
    good = found.delivered
    assert found.angle[good].max() < 1e-3
    assert found.rate[good].max() < 1e-3
    limits = np.radians([0.9 if number == 1 else 1.8 for number in small()[1].satellite])
    assert (found.fastest <= 1.1 * limits).all()
    assert found.angle[2] > 0.1


def test_satellites_are_where_the_verifier_has_them():
    case, _ = small()
    simulator = _simulator(case, [0, 1, 2], np.ones(3), "case", 0.5)
    for second in (0, 600):
        simulator.run((second * 2 - simulator.ticks).clamp(min=0))
        now = simulator.observer.now
        flown = (now.PN @ now.r_BN_N).stack()
        at = np.array([float(second)])
        sidereal = sidereal_time_1982(ephemeris_time(case, at)).numpy()
        for number in range(3):
            expected = turned(orbit(case, number, at)[0], -sidereal)[0]
            # the simulation turns the Earth at a constant rate between hours, worth 0.1 m
            assert np.linalg.norm(flown[number].numpy() - expected) < 0.5


def test_off_nadir_angles_are_those_of_the_verifier():
    case, plan = small()
    positions, found = tracks(case), flight()
    assert len(plan) == len(found.off_nadir) > 0
    for k in range(len(plan)):
        times = np.arange(plan.start_s[k], plan.end_s[k] + 1, case.step_s) // case.step_s
        r = positions.r[plan.satellite[k], times]
        line, down = turned(on_ellipsoid(case.requests)[plan.task[k]], positions.sidereal[times]) - r, -r
        cosine = (line * down).sum(-1) / np.linalg.norm(line, axis=-1) / np.linalg.norm(down, axis=-1)
        # the largest one of all ticks is at least that of the grid, and not much more
        assert 0.0 <= found.off_nadir[k] - np.arccos(cosine).max() + 1e-7 < 0.01


def test_batteries_agree_with_the_verifier_but_for_the_length_of_slews():
    case, plan = small()
    promised = check(case, plan).power
    for number, slews in ((0, 4), (1, 3)):
        difference = abs(flight().final[number] - promised.final_wh[number])
        # the flight draws no power in settling, and slews from motion to motion take a few seconds more or less
        assert difference < slews * (case.satellites[number].settling_s + 5.0) * 360.0 / 3600.0
    assert flight().final[2] == pytest.approx(0.0, abs=2.0)


def test_wheels_may_draw_their_own_power():
    case, plan = small()
    found = fly(case, plan, power="wheels")
    assert np.array_equal(found.missed[:7], flight().missed[:7])
    assert np.array_equal(found.angle[:7], flight().angle[:7])
    assert (found.final[:2] > flight().final[:2] + 0.5).all()  # less than the 360 W of the case


def test_flights_do_not_depend_on_other_satellites():
    case, plan = small()
    alone = fly(case, plan, satellites=[1])
    mine = plan.satellite == 1
    for name in ("angle", "rate", "off_nadir", "least"):
        assert np.array_equal(getattr(alone, name)[mine], getattr(flight(), name)[mine])
    assert np.isnan(alone.angle[~mine]).all()
    assert alone.final[0] == flight().final[1]


def test_faster_slews_deliver_a_plan_as_promised():
    case, plan = small()
    plan = plan.take(np.array([0, 1, 4, 5]))
    assert fitting_factor(case, plan) == 1.0
    late = dataclasses.replace(plan, start_s=plan.start_s.copy(), end_s=plan.end_s.copy())
    late.start_s[1] -= 15  # 15 s for 25 degrees
    late.end_s[1] -= 15
    factor = fitting_factor(case, late, tick=0.5)
    assert 1.0 < factor < 2.0
    assert not fly(case, late, tick=0.5).delivered.all()
    assert fly(case, late, factor=factor, tick=0.5).delivered.all()
    hopeless = dataclasses.replace(late, start_s=late.start_s + np.array([0, -15, 0, 0]))
    hopeless.end_s[1] -= 15
    assert fitting_factor(case, hopeless, tick=0.5) == math.inf


def test_plans_are_thinned_by_the_slack_of_their_gaps():
    case, plan = small()
    kept = thinned(case, plan, 0.0)
    assert set(plan.task.tolist()) - set(kept.task.tolist()) == {2}
    slews = check(case, kept).slews
    slack = slews.gap - slews.required
    assert slack.min() >= 0.0
    assert len(thinned(case, kept, slack.min() - 1e-3)) == len(kept)
    assert kept.task[slack.argmin()] not in thinned(case, kept, slack.min() + 1e-3).task
    part = delivered(plan, flight())
    assert completed_weight(case, part) == pytest.approx(case.requests.weight[part.task].sum() / case.requests.weight.sum())


def test_the_command_shows_promised_and_delivered(run, tmp_path):
    case, plan = small()
    write_case(tmp_path / "case", case)
    write_solution(tmp_path / "plan.json", case, plan.take(np.arange(7)))
    result = run("aeossp", "fly", tmp_path / "case", tmp_path / "plan.json", "--margins", "5", "--out", tmp_path / "flown.json")
    assert result.exit_code == 0, result.output
    assert "5 of 7" in result.output
    assert "slack 5 s" in result.output
    kept = json.loads((tmp_path / "flown.json").read_text())
    assert [one["missed"] for one in kept["observations"]].count(None) == 5
    assert kept["rows"][0]["pointing"] == "1"
    result = run("aeossp", "fly", tmp_path / "case", tmp_path / "plan.json", "--power", "sun")
    assert result.exit_code != 0
    assert "power='sun' must be one of" in " ".join(result.output.split())


def test_refusals():
    case, plan = small()
    twice = dataclasses.replace(plan, start_s=np.full_like(plan.start_s, 300))
    check_refusals(
        refusal(lambda: fly(case, twice), ValueError, "overlap", "satellite 0"),
        refusal(lambda: fly(case, plan, tick=0.3), ValueError, "tick=0.3", "5 s"),
        refusal(lambda: fly(case, plan, power="sun"), ValueError, "power='sun'", "wheels"),
    )
