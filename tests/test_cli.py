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
    assert "NadirScan-v1  " in run("list").output


def test_args_prints_units_and_meaning(run):
    output = run("args", "NadirScan-v1").output
    assert "batteryStorageCapacity" in output
    assert "world_args" in output


@pytest.mark.parametrize("command", [("args",), ("train", *SHORT), ("evaluate", "rule", *SHORT, "--preset")])
def test_an_unknown_preset_is_answered_with_the_nearest(run, command):
    result = run(*command, "NadirScam-v1")
    assert result.exit_code == 1
    assert "did you mean 'NadirScan-v1'?" in result.output
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
