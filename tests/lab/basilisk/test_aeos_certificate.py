"""Certificates of the suite of AEOS-Bench."""

from dataclasses import replace

import numpy as np
import pytest

from bsk_torch.lab.basilisk.aeos_certificate import CLOSE, Flown, certify_bench, comparison
from bsk_torch.lab.commands.entrants import entrant_of
from bsk_torch.lab.suites.suite import SUITES, bench_folder
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write


def flown(seen, success, away=0.0):
    """A flight of a satellite and a task for three seconds."""
    sigma = np.array([0.0, 0.0, away])[:, None, None] * np.ones(3)
    return Flown(sigma, np.array(seen, dtype=bool)[:, None, None], np.array([success]), np.array([sum(seen)]), energy=36.0)


def test_flights_are_compared_as_long_as_the_second_one_agrees():
    one, job = flown([0, 1, 1], 2), [{"duration": 2, "release_time": 1}]
    exact = comparison(one, one, one, job)
    assert exact.agrees
    assert exact.same
    assert (exact.seconds, exact.sights, exact.successes) == ((3, 3), (2, 0), (1, 1, 1))
    shares = dict.fromkeys(("CR", "WCR", "PCR", "WPCR"), 1.0)
    assert exact.measures[0] == shares | {"TAT": 1.0, "PC": 36.0, "CS": pytest.approx(1.0 + 1.0 / 25200.0 + 0.01 / 100.0)}
    other = flown([0, 0, 1], -1, away=0.1)
    chaotic = comparison(one, flown([0, 1, 1], 2, away=0.1), other, job)
    assert (chaotic.seconds, chaotic.sights, chaotic.agrees) == ((3, 2), (1, 1), False)
    late = comparison(one, flown([0, 1, 1], 2, away=0.1), flown([0, 1, 0], -1, away=0.1), job)
    assert late.agrees
    assert not late.same
    assert late.measures[1]["PCR"] == 0.5
    assert comparison(one, one, flown([0, 1, 1], 2, away=2.0 * CLOSE), job).agrees is False


def test_what_to_install_is_said_where_basilisk_is_missing(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    task = SUITES["aeosbench"][0]
    with pytest.raises(ImportError, match="flying needs Basilisk"):
        certify_bench(task, entrant_of("nearest_task", [task]), 1)


@pytest.mark.basilisk
@pytest.mark.compiled
@pytest.mark.parametrize("rule", ["nearest_task", "soonest_task"])
def test_short_flights_agree_with_basilisk(rule, tmp_path):
    write(tmp_path / "00001", constellation(2), tasks(40))
    task = bench_folder(tmp_path)
    task = replace(task, options=task.options | {"time_limit": 400.0})
    summary = certify_bench(task, entrant_of(rule, [task]), 1).summary()
    assert summary["agrees"]
    assert summary["satellite_seconds"] == [800]
    assert summary["satellite_seconds_compared"][0] > 100
    assert summary["attitude_difference"][0] < 1e-6
    assert summary["sights"][0] > 0
