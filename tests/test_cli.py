"""The command line, in process."""

import json

import pytest
import torch
from typer.testing import CliRunner

from bsk_torch.cli import app

SHORT = ["--backend", "eager", "--time-limit", "300", "--episodes", "2"]


@pytest.fixture
def run():
    threads = torch.get_num_threads()
    yield lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])
    torch.set_num_threads(threads)


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


@pytest.mark.compiled
@pytest.mark.parametrize(
    "command", [("train", *SHORT, "Constellation-v1"), ("evaluate", "random", "--preset", "Constellation-v1")]
)
def test_constellations_are_trained_by_a_script(run, command):
    result = run(*command)
    assert result.exit_code == 1
    assert "scripts/train_constellation.py --preset Constellation-v1" in result.output


@pytest.mark.parametrize("command", [("args",), ("train", *SHORT), ("evaluate", "rule", *SHORT, "--preset")])
def test_an_unknown_preset_is_answered_with_the_nearest(run, command):
    result = run(*command, "NadirScam-v1")
    assert result.exit_code == 1
    assert "did you mean 'NadirScan-v1'" in result.output
    assert len(result.output.splitlines()) == 1


def test_evaluate_refuses_what_is_no_policy(run):
    result = run("evaluate", "rulle", *SHORT)
    assert result.exit_code == 1
    assert "did you mean 'rule'?" in result.output


def test_evaluate_prints_a_table(run):
    result = run("evaluate", "random", *SHORT)
    assert result.exit_code == 0, result.output
    assert "random" in result.output
    assert "±" in result.output


def test_train_compares_and_draws(run, tmp_path):
    result = run("train", "NadirScan-v1", "--frames", 20, "--num-envs", 4, "--rollout", 5, "--out", tmp_path, *SHORT)
    assert result.exit_code == 0, result.output
    assert {path.name for path in tmp_path.iterdir()} == {
        "config.json", "evaluation.json", "learning_curve.png", "log.csv", "policy.pt", "timeline.png",
    }  # fmt: skip
    assert set(json.loads((tmp_path / "evaluation.json").read_text())) == {"random", "rule", "untrained", "trained"}
    again = run("evaluate", tmp_path, *SHORT)
    assert again.exit_code == 0, again.output


@pytest.mark.compiled
def test_train_with_attention_knows_the_targets_and_draws_them(run, tmp_path):
    shown = ("--backend", "compiled", "--time-limit", "300", "--episodes", "2")
    sizes = ("--frames", 10, "--num-envs", 2, "--rollout", 5)
    result = run("train", "AEOSCity-v1", "--network", "attention", *sizes, "--out", tmp_path, *shown)
    assert result.exit_code == 0, result.output
    assert "imaged" in result.output
    assert (tmp_path / "ground_track.png").is_file()
    kept = json.loads((tmp_path / "evaluation.json").read_text())
    assert set(kept) == {"random", "greedy", "nearest", "hasty", "untrained", "trained"}
    assert kept["greedy"]["counts"]["imaged"] >= 0.0
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["network"] == "attention"
    assert config["options"]["as_set"] is True
    again = run("evaluate", tmp_path, *shown)
    assert again.exit_code == 0, again.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("AEOS-v1", "--network", "attetnion"), "did you mean 'attention'"),
        (("NadirScan-v1", "--network", "attention"), "use network='mlp'"),
    ],
)
def test_a_network_that_does_not_exist_or_fit_is_refused(run, arguments, message):
    result = run("train", *arguments, *SHORT)
    assert result.exit_code == 1
    assert message in result.output
    assert len(result.output.splitlines()) == 1


def test_evaluate_refuses_baselines_that_do_not_fit(run):
    result = run("evaluate", "greedy", "--preset", "NadirScan-v1", *SHORT)
    assert result.exit_code == 1
    assert "'greedy' does not fit NadirScan-v1" in result.output
