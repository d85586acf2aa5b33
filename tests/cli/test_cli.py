"""The command line: what is the same for all commands."""

import pytest

SHORT = ["--backend", "eager", "--time-limit", "300"]


def test_list_names_the_presets(run):
    output = run("list").output
    assert "NadirScan-v1  " in output
    assert "AEOS-v1  " in output


def test_args_prints_units_and_meaning(run):
    output = run("args", "NadirScan-v1").output
    assert "batteryStorageCapacity" in output
    assert "world_args" in output


def test_args_of_constellations_are_those_of_their_first_type(run):
    assert "losMaximumRange" in run("args", "RelayConstellation-v1").output


@pytest.mark.parametrize("command", [("args",), ("train", *SHORT), ("eval", "rule", *SHORT, "--preset")])
def test_an_unknown_preset_is_answered_with_the_nearest(run, command):
    result = run(*command, "NadirScam-v1")
    assert result.exit_code == 1
    assert "did you mean 'NadirScan-v1'" in result.output
    assert len(result.output.splitlines()) == 1


def test_agents_of_several_satellites_are_refused(run):
    result = run("train", *SHORT, "RelayConstellation-v1", "options.joint=true", "options.as_set=false")
    assert result.exit_code == 1
    assert "RelayConstellation-v1 cannot be learned: each satellite must be a separate agent" in result.output
    assert len(result.output.splitlines()) == 1
