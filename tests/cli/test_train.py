"""``bsk-torch train``."""

import json
import logging

import pytest

from bsk_torch.rl.training.config import PPOConfig, load_config
from bsk_torch.rl.training.log import read_log
from bsk_torch.rl.training.workers import Cores
from tests.support.programs import forked_processes

pytestmark = pytest.mark.compiled

SIZES = ["num_envs=4", "rollout=5"]
SHORT = ["--backend", "compiled", "--time-limit", "300", "--episodes", "2"]


def test_train_compares_and_draws(run, tmp_path):
    result = run("train", "NadirScan-v1", "--frames", 20, *SIZES, "--out", tmp_path, *SHORT)
    assert result.exit_code == 0, result.output
    data = {"checkpoint.pt", "config.yaml", "evaluation.json", "evaluations.csv", "log.csv", "policy.pt"}
    assert {path.name for path in tmp_path.iterdir()} == data | {"learning_curve.png", "timeline.png"}
    assert set(json.loads((tmp_path / "evaluation.json").read_text())) == {"random", "rule", "cautious", "untrained", "trained"}
    again = run("eval", tmp_path, "--seeds", "0:2", *SHORT[:4])
    assert again.exit_code == 0, again.output


def test_without_a_comparison_no_episode_is_evaluated(run, tmp_path):
    alone = (*SHORT[:-1], "0")
    result = run("train", "NadirScan-v1", "--frames", 20, *SIZES, "--out", tmp_path / "run", "--seeds", 2, *alone)
    assert result.exit_code == 0, result.output
    assert "unseen episodes" not in result.output
    for seed in range(2):
        written = {path.name for path in (tmp_path / f"run/seed_{seed}").iterdir()}
        assert {"policy.pt", "learning_curve.png", "timeline.png"} <= written
        assert "evaluation.json" not in written
    page = run("report", tmp_path / "run/seed_1", "--episodes", 2)
    assert page.exit_code == 0, page.output
    assert "Episodes in the viewer" in (tmp_path / "run/seed_1/report.html").read_text()


def test_train_with_attention_knows_the_targets_and_draws_them(run, tmp_path):
    shown = ("--backend", "compiled", "--time-limit", "300", "--episodes", "2")
    sizes = ("--frames", 10, "num_envs=2", "rollout=5")
    result = run("train", "AEOSCity-v1", "--network", "attention", *sizes, "--out", tmp_path, *shown)
    assert result.exit_code == 0, result.output
    assert "imaged" in result.output
    assert (tmp_path / "ground_track.png").is_file()
    kept = json.loads((tmp_path / "evaluation.json").read_text())
    assert set(kept) == {"random", "greedy", "nearest", "hasty", "farsighted", "untrained", "trained"}
    assert kept["greedy"]["counts"]["imaged"] >= 0.0
    config = load_config(tmp_path / "config.yaml", PPOConfig)
    assert config.network == "attention"
    assert config.options["as_set"] is True
    again = run("eval", tmp_path, "--seeds", "0:2", *shown[:4])
    assert again.exit_code == 0, again.output


def test_without_matplotlib_pictures_are_left_out(run, tmp_path, monkeypatch):
    monkeypatch.setattr("bsk_torch.cli.training.find_spec", lambda name: None)
    result = run("train", "NadirScan-v1", "--frames", 20, *SIZES, "--out", tmp_path, *SHORT)
    assert result.exit_code == 0, result.output
    assert result.output.count("no pictures were drawn: they need matplotlib; pip install 'bsk_torch[viz]'") == 1
    assert (tmp_path / "policy.pt").is_file()
    assert not list(tmp_path.glob("*.png"))


def test_the_number_of_processes_is_chosen_and_kept(run, tmp_path, monkeypatch, caplog):
    caplog.set_level(logging.INFO, logger="bsk_torch")
    monkeypatch.setattr("bsk_torch.rl.training.workers.available_cores", lambda: Cores(2, "2 available cores"))
    sizes = ["num_envs=64", "rollout=2"]
    with forked_processes():
        result = run("train", "NadirScan-v1", "--frames", 128, "--workers", "auto", *sizes, "--out", tmp_path, *SHORT)
    assert result.exit_code == 0, result.output
    assert "workers=auto: collector=multi workers=2, for 2 available cores" in caplog.text
    config = load_config(tmp_path / "config.yaml", PPOConfig)
    assert (config.collector, config.workers) == ("multi", 2)
    monkeypatch.setattr("bsk_torch.rl.training.workers.available_cores", lambda: Cores(1, "1 available core"))
    with forked_processes():
        again = run("train", tmp_path, "--resume", "frames=256", *SHORT[4:])
    assert again.exit_code == 0, again.output
    assert "workers=2 is more than 1 available core: the processes share them; workers=1 is as fast" in caplog.text
    assert read_log(tmp_path / "log.csv")["frames"] == [128, 256]
    refused = run("train", tmp_path, "--resume", "workers=auto", *SHORT[4:])
    assert refused.exit_code == 1
    assert "workers=2" in refused.output


def test_several_seeds_are_compared(run, tmp_path):
    result = run("train", "NadirScan-v1", "--frames", 20, "--seeds", 2, *SIZES, "--out", tmp_path / "runs", *SHORT)
    assert result.exit_code == 0, result.output
    assert {path.name for path in (tmp_path / "runs").iterdir()} == {"seed_0", "seed_1"}
    assert "seed 1" in result.output


def test_a_run_goes_on_with_a_larger_budget(run, tmp_path):
    assert run("train", "NadirScan-v1", "--frames", 20, *SIZES, "--out", tmp_path, *SHORT).exit_code == 0
    again = run("train", tmp_path, "--resume", "frames=40", *SHORT[4:])
    assert again.exit_code == 0, again.output
    assert read_log(tmp_path / "log.csv")["frames"] == [20, 40]


def test_a_folder_with_results_is_left_alone(run, tmp_path):
    (tmp_path / "policy.pt").write_text("precious")
    result = run("train", "NadirScan-v1", "--frames", 20, *SIZES, "--out", tmp_path, *SHORT)
    assert result.exit_code == 1
    assert "is not empty" in result.output
    assert "--resume" not in result.output
    (tmp_path / "config.yaml").write_text("preset: NadirScan-v1")
    result = run("train", "NadirScan-v1", "--frames", 20, *SIZES, "--out", tmp_path, *SHORT)
    assert result.output.endswith(f"or resume the run in it with: bsk-torch train {tmp_path} --resume\n")
    assert (tmp_path / "policy.pt").read_text() == "precious"


def test_a_run_that_was_stopped_before_its_checkpoint_begins_again(run, tmp_path, caplog):
    run("train", "NadirScan-v1", "--frames", 20, *SIZES, "--out", tmp_path, *SHORT)
    (tmp_path / "checkpoint.pt").unlink()
    result = run("train", tmp_path, "--resume", "--episodes", 2)
    assert result.exit_code == 0, result.output
    assert [record.getMessage() for record in caplog.records if "begins again" in record.getMessage()] == [
        f"{tmp_path} holds no checkpoint.pt; the run begins again"
    ]
