"""``bsk-torch risk``."""

import json

import pytest

pytestmark = pytest.mark.compiled

SHORT = ["--preset", "NadirScan-v1", "--time-limit", "1200", "--episodes", "20", "--repetitions", "4", "--num-envs", "16"]
LOW = ["--event", "battery_charge_fraction<0.25"]


def test_a_risk_is_estimated_and_its_ways_are_shown_saved_and_drawn(run, tmp_path):
    paths = {name: tmp_path / f"r.{name}" for name in ("save", "draw", "out")}
    paths = {"save": tmp_path / "p.json", "draw": tmp_path / "p.svg", "out": tmp_path / "r.json"}
    result = run("risk", "random", *SHORT, *LOW, *(word for name, path in paths.items() for word in (f"--{name}", path)))
    assert result.exit_code == 0, result.output
    assert "NadirScan-v1, random: battery_charge_fraction < 0.25" in result.output
    assert "95 % interval" in result.output
    assert "Ways to the event" in result.output
    assert "storedCharge_Init" in result.output
    kept, saved = json.loads(paths["out"].read_text()), json.loads(paths["save"].read_text())
    assert kept["probability"]["low"] < kept["probability"]["mean"] < kept["probability"]["high"]
    assert saved["options"] == {"time_limit": 1200.0}
    assert [episode["seed"] for episode in saved["episodes"]] == [way["seed"] for way in kept["ways"]]
    assert "battery_charge_fraction" in paths["draw"].read_text()


def test_a_risk_is_estimated_by_screening(run, tmp_path):
    result = run("risk", "random", *SHORT, *LOW, "--method", "screen", "--pool", "200", "--save", tmp_path / "p.json")
    assert result.exit_code == 0, result.output
    assert "screened: 200 seeds in each of 4 repetitions" in result.output
    assert "of the variance of levels" in result.output
    assert json.loads((tmp_path / "p.json").read_text())["episodes"]


def test_what_never_happens_has_an_upper_limit(run, tmp_path):
    result = run(
        "risk", "rule", *SHORT, "--event", "storage_level_fraction>2", "--smallest", "0.05", "--save", tmp_path / "p.json"
    )
    assert result.exit_code == 0, result.output
    assert "not seen; its probability is at most" in result.output
    assert "was not written: the event was not seen" in result.output
    assert not (tmp_path / "p.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("risk", "ruel", *SHORT), "did you mean 'rule'"),
        (("risk", "rule", *SHORT, "--level", "batery"), "did you mean 'battery'"),
        (("risk", "rule", *SHORT, "--event", "deaht"), "must be 'death', or a property"),
        (("risk", "rule", *SHORT, "--method", "sreen"), "must be one of ['subset', 'screen']"),
        (("risk", "rule", *SHORT, "--draw", "risk.gif"), "must end with .png, .svg or .pdf"),
        (("risk", "rule", *SHORT, "--save", "nowhere/r.json"), "there is no folder"),
        (("risk", "random", "--preset", "Constellation-v1", "--draw", "r.png"), "shows the episode of one satellite"),
    ],
)
def test_wrong_arguments_are_named(run, arguments, message):
    result = run(*arguments)
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
