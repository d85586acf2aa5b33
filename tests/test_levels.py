"""Levels, shards and measured costs of the tests: nothing is lost between the levels, and nothing runs twice."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.support import levels
from tests.support.levels import LEVELS, LONG, PROMISES, SLOW, Results, in_shard, level, parse_shard, read_durations

ROOT = Path(__file__).parents[1]


def test_a_level_follows_from_the_duration():
    durations = {"slow": 2 * SLOW, "long": 2 * LONG, "fast": SLOW}
    assert [level(name, durations) for name in ("new", "fast", "slow")] == ["default", "default", "full"]
    assert level("long", durations) == "nightly"


def test_a_mark_names_what_runs_at_night():
    whole, some = pytest.mark.nightly.mark, pytest.mark.nightly("eager", "AEOS-v1").mark
    assert level("fast", {}, [whole]) == level("t[AEOS-v1]", {}, [some]) == level("t[2-eager]", {}, [some]) == "nightly"
    for name in ("t", "t[compiled]", "t[eagerly]", "t[AEOS-v1x]"):
        assert level(name, {}, [some, pytest.mark.compiled.mark]) == "default"


def exists(name):
    """Whether there is a test function of an id."""
    file, _, test = name.partition("::")
    function = re.sub(r"\[.*", "", test, flags=re.DOTALL).rpartition("::")[2]
    return re.search(rf"\bdef {function}\b", (ROOT / file).read_text()) is not None


def test_promises_are_tests_of_the_default():
    assert PROMISES
    for name in PROMISES.values():
        assert exists(name), f"{name} is no test"
        assert level(name, {name: 2 * LONG}) == "default"


def test_durations_are_of_tests_that_exist():
    durations = read_durations()
    assert durations
    for name, seconds in durations.items():
        assert exists(name), f"{name} is no test"
        assert seconds > SLOW


@pytest.mark.parametrize("count", [1, 2, 3])
def test_shards_are_a_partition_into_equal_parts(count):
    seconds = {f"file{k}": 1.0 + k % 7 for k in range(60)}
    shards = [in_shard(seconds, number, count) for number in range(1, count + 1)]
    assert sorted(name for shard in shards for name in shard) == sorted(seconds)
    loads = [sum(seconds[name] for name in shard) for shard in shards]
    assert max(loads) - min(loads) <= max(seconds.values())


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0"])
def test_rejects_wrong_shards(text):
    with pytest.raises(pytest.UsageError, match=re.escape(text)):
        parse_shard(text)


def report(test, seconds, fixtures=(), loaded=(), built=()):
    cost = (seconds, [list(key) for key in fixtures], list(loaded))  # as it comes from another process
    properties = [("cost", (test, cost, [[list(key), value] for key, value in dict(fixtures).items()], dict(built)))]
    return SimpleNamespace(when="teardown", skipped=False, user_properties=properties)


@pytest.fixture
def results(monkeypatch, tmp_path):
    monkeypatch.setattr(levels, "DURATIONS", tmp_path / "durations.json")
    monkeypatch.setattr(levels.kernels, "listed", lambda: frozenset({"listed"}))
    (tmp_path / "durations.json").write_text(json.dumps({"t.py::gone": 2 * SLOW, "t.py::long": 2 * LONG, "other.py::slow": 1.0}))
    return Results(SimpleNamespace(getoption={"measure": True, "levels": "default,full"}.get))


def test_fixtures_are_shared_and_kernels_are_not(results):
    for name in ("a", "b"):
        results.pytest_runtest_logreport(report(name, 0.25, {("here", "env", 0): 4.0}, ["listed", "own"], {"own": 1.0}))
    assert results.seconds() == {"a": 0.25 + 2.0 + 1.0, "b": 0.25 + 2.0 + 1.0}


def test_tests_that_became_slow_are_named_and_noted(results, tmp_path):
    results.pytest_runtest_logreport(report("t.py::fast", 0.5 * SLOW))
    results.pytest_runtest_logreport(report("t.py::slow", 3 * SLOW))
    lines = []
    results.pytest_terminal_summary(SimpleNamespace(write_line=lines.append))
    assert len(lines) == 1
    assert lines[0].endswith(": t.py::slow")
    noted = json.loads((tmp_path / "durations.json").read_text())
    assert noted == {"t.py::long": 2 * LONG, "t.py::slow": 3 * SLOW, "other.py::slow": 1.0}


def test_kernels_of_earlier_runs_make_no_test_fast(results, tmp_path):
    for name, kernels in (("gone", ["own"]), ("again", ["listed"])):
        results.pytest_runtest_logreport(report(f"t.py::{name}", 0.5 * SLOW, loaded=kernels))
    results.pytest_terminal_summary(SimpleNamespace(write_line=print))
    noted = json.loads((tmp_path / "durations.json").read_text())
    assert noted == {"t.py::gone": 2 * SLOW, "t.py::long": 2 * LONG, "other.py::slow": 1.0}


def test_every_level_is_one_of_the_script():
    text = (ROOT / "scripts" / "test.sh").read_text()
    for name in LEVELS[1:]:
        assert f"--{name}" in text
    assert f"for part in {' '.join(LEVELS)}" in text


PYTHON = """#!/bin/sh
case "$*" in
    *"-m venv"*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
    *"-m pip"*) echo "no index" >&2 && exit 1 ;;
    *) exit INSTALLED ;;
esac
"""
"""A Python whose package index does not answer; its exit status for anything else says whether packages are installed."""


@pytest.mark.parametrize(
    ("installed", "said"), [(1, "without it, nothing can be tested"), (0, "testing with what .venv has")], ids=["new", "old"]
)
def test_an_index_that_does_not_answer_is_one_line(installed, said, tmp_path):
    for name in ("scripts/test.sh", "pyproject.toml", "constraints.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    python = tmp_path / "python"
    python.write_text(PYTHON.replace("INSTALLED", str(installed)))
    python.chmod(0o755)
    done = subprocess.run(
        ["bash", str(tmp_path / "scripts/test.sh")],
        env={"PATH": os.environ["PATH"], "PYTHON": str(python)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert said in done.stderr
    assert "Traceback" not in done.stderr
