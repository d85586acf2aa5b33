"""Commands with an environment that is a function in a file of the user's."""

import json

import pytest

pytestmark = pytest.mark.compiled

FILE = """
import bsk_torch

def scanner(num_envs):
    return bsk_torch.make("NadirScan-v1", num_envs=num_envs, time_limit=300.0)

def careful(observation):
    return (observation[:, 1] < 0.4).long()
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / f"own_{tmp_path.name}.py"
    path.write_text(FILE)
    return path


def test_from_the_function_to_the_viewer(run, file, tmp_path):
    mine, folder = f"{file}:scanner", tmp_path / "run"
    tiny = ["num_envs=4", "rollout=4", "evaluate_every=0", "hidden=[8]"]
    trained = run("train", mine, "--frames", 16, "--out", folder, "--episodes", 2, *tiny, f"imitate={file}:careful")
    assert trained.exit_code == 0, trained.output
    assert f"report {folder} --preset {mine}" in " ".join(trained.output.split()).replace("\n", "")
    played = run("eval", folder, "--preset", mine, "--seeds", "0:2", "--out", tmp_path / "e.json")
    assert played.exit_code == 0, played.output
    assert [*json.loads((tmp_path / "e.json").read_text())] == ["trained", "random", "rule", "cautious"]
    shown = run("view", mine, "--policy", folder, "--out", tmp_path / "page.html")
    assert shown.exit_code == 0, shown.output
    assert (tmp_path / "page.html").stat().st_size > 1e5


def test_functions_that_only_files_name_are_not_imported(run, file, tmp_path):
    mine, folder = f"{file}:scanner", tmp_path / "run"
    folder.mkdir()
    config = ("bsk_torch.rl.training.config", "PPOConfig", "save_config")
    module = __import__(config[0], fromlist=config[1:])
    module.save_config(module.PPOConfig(mine, options={}), folder / "config.yaml")
    file.write_text("raise SystemExit('executed')")
    result = run("train", folder, "--resume", "--frames", 16)
    assert result.exit_code == 1
    assert "--preset" in result.output
    assert "executed" not in result.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["train", "{file}:scaner"], ["'scanner'"]),
        (["eval", "random", "--preset", "nobody.py:scanner"], ["no file", "nobody.py"]),
        (["view", "{file}:scanner"], ["no pretrained policy", "random"]),
    ],
)
def test_what_is_wrong_is_said(run, file, arguments, words):
    result = run(*(text.format(file=file) for text in arguments))
    assert result.exit_code == 1
    assert all(word in " ".join(result.output.split()) for word in words)
