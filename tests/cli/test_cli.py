"""The command line: what is the same for all commands."""

import pytest

SHORT = ["--backend", "eager", "--time-limit", "300"]


def test_list_names_the_presets(run):
    output = run("list").output
    assert "NadirScan-v1  " in output
    assert "AEOS-v1  " in output


@pytest.mark.parametrize("columns", [80, 100])
def test_args_shows_values_of_the_preset_before_defaults(run, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = run("args", "NadirScan-v1").output.splitlines()
    assert max(map(len, lines)) <= columns
    assert [line.strip() for line in lines if line.strip() in ("sat_args", "world_args")] == ["sat_args", "world_args"]
    cells = {line.split()[0]: line.split() for line in lines if line.split()}
    assert cells["panelArea"][1:4] == ["0.25", "1", "area"]
    assert cells["batteryStorageCapacity"][1:3] == ["720000", "288000"]
    assert cells["basePowerDraw"][1:3] == ["-10", "0"]
    assert cells["mass"][1:] == ["330", "hub", "mass", "(kg)"]


def test_args_of_constellations_are_those_of_their_first_type(run):
    assert "losMaximumRange" in run("args", "RelayConstellation-v1").output


def test_agents_of_several_satellites_are_refused(run):
    result = run("train", *SHORT, "RelayConstellation-v1", "options.joint=true", "options.as_set=false")
    assert result.exit_code == 1
    assert "RelayConstellation-v1 cannot be learned: each satellite must be a separate agent" in result.output
    assert len(result.output.splitlines()) == 1
