"""``bsk-torch export-aeosbench`` and ``import-aeosbench``, and measures in ``bsk-torch eval``."""

from __future__ import annotations

import csv
import json

import pytest

from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write

pytestmark = pytest.mark.compiled

SHORT = ["--time-limit", "100"]


@pytest.fixture
def cases(tmp_path):
    write(tmp_path / "cases/00001", constellation(1), tasks(40))
    write(tmp_path / "cases/00002", constellation(2), tasks(60))
    return tmp_path / "cases"


def test_exported_files_can_be_imported(run, cases, tmp_path):
    common = ["--cases", cases, "--sensor", "on", *SHORT]
    result = run("export-aeosbench", "nearest_task", *common, "--out", tmp_path / "data")
    assert result.exit_code == 0, result.output
    assert "test.json: 2 cases" in result.output
    result = run("import-aeosbench", tmp_path / "data", *common, "--episodes-out", tmp_path / "all.csv")
    assert result.exit_code == 0, result.output
    with (tmp_path / "all.csv").open() as file:
        lines = list(csv.DictReader(file))
    for name, line in zip(("00001", "00002"), lines, strict=True):
        kept = json.loads((tmp_path / f"data/trajectories.0/test/00/{name}.json").read_text())
        assert float(line["PCR"]) == pytest.approx(kept["PCR"])
        assert float(line["PC"]) == pytest.approx(kept["PC"])


def test_measures_are_columns_of_evaluations(run, tmp_path):
    options = [f"--option={text}" for text in ("satellites=2", "tasks=[4,6]", "sensor=on", "until_done=false")]
    place = tmp_path / "e.json"
    result = run("eval", "nearest_task", "--preset", "AEOSBench-v1", *options, *SHORT, "--seeds", "0:2", "--out", place)
    assert result.exit_code == 0, result.output
    kept = json.loads(place.read_text())
    assert list(kept["nearest_task"]["measures"]) == ["CR", "WCR", "PCR", "WPCR", "TAT", "PC", "CS"]
    assert kept["nearest_task"]["measures"]["CR"]["mean"] == kept["nearest_task"]["return"]["mean"] == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["eval", "nearest_task", "--option", "satellites"], "must be NAME=VALUE"),
        (["eval", "nearest_task", "--option", "num_envs=2"], "choose these with --seeds"),
        (["eval", "nearest_task", "--option", "backend=eager"], "it is the option --backend of the command"),
        (["eval", "nearest_task", "--preset", "AEOSBench-v1", "--option", "sensors=on"], "did you mean 'sensor'"),
        (["export-aeosbench", "nearest_task", "--cases", "none", "--out", "."], "none: no constellation.json"),
        (["import-aeosbench", ".", "--cases", "{cases}"], "no 00001.pth and no 00001/assignment_runs.json"),
        (
            ["export-aeosbench", "nearest_task", "--cases", "{cases}", "--out", ".", "--sensor", "of"],
            "sensor='of' must be one of",
        ),
    ],
)
def test_errors(run, cases, arguments, message):
    result = run(*(text.format(cases=cases) for text in arguments))
    assert result.exit_code != 0
    assert message in " ".join(result.output.split())


def test_names_that_the_benchmark_does_not_have_are_refused_before_the_flight(run, tmp_path, monkeypatch):
    write(tmp_path / "cases/one", constellation(1), tasks(40))
    monkeypatch.setattr("bsk_torch.tasks.aeos_bench.commands.bench", lambda *given: pytest.fail("an environment was made"))
    result = run("export-aeosbench", "nearest_task", "--cases", tmp_path / "cases", "--out", tmp_path / "data")
    assert result.exit_code != 0
    assert "the benchmark names cases by numbers below 100,000" in " ".join(result.output.split())
