"""``bsk-torch eval``."""

import csv
import importlib
import json

import pytest
import torch

import bsk_torch
from bsk_torch.rl.networks.plans import PLANS
from bsk_torch.rl.policies.files import save_policy

pytestmark = pytest.mark.compiled

SHORT = ["--time-limit", "600"]
TWO = [*SHORT, "--seeds", "0:2"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run with the policy of a network that has learned nothing."""
    path = tmp_path_factory.mktemp("run")
    env = bsk_torch.make("NadirScan-v1", num_envs=1, backend="eager")
    plan = PLANS["mlp"].of(env, (8,))
    save_policy(path / "policy.pt", plan, plan.build(), "NadirScan-v1", {})
    return path


def test_policies_are_compared_with_the_baselines_that_fit(run, folder, tmp_path):
    result = run("eval", folder, *TWO, "--out", tmp_path / "all.json", "--episodes-out", tmp_path / "all.csv")
    assert result.exit_code == 0, result.output
    kept = json.loads((tmp_path / "all.json").read_text())
    assert list(kept) == ["trained", "random", "rule", "cautious"]
    assert all(name in result.output for name in kept)
    assert set(kept["trained"]["gain"]) == {"random", "rule", "cautious"}
    assert kept["random"]["gain"] == {}
    assert kept["rule"]["survival"] == 1.0
    with (tmp_path / "all.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [(line["policy"], line["seed"]) for line in lines] == [(name, seed) for name in kept for seed in "01"]
    returns = [float(line["return"]) for line in lines if line["policy"] == "rule"]
    assert sum(returns) / 2 == pytest.approx(kept["rule"]["return"]["mean"], abs=1e-12)


def test_shielded_policies_stand_beside_the_same_without(run, folder, tmp_path):
    result = run("eval", folder / "policy.pt", *TWO, "--no-baselines", "--shield", "safe", "--out", tmp_path / "e.json")
    assert result.exit_code == 0, result.output
    kept = json.loads((tmp_path / "e.json").read_text())
    assert list(kept) == ["trained + safe", "trained"]
    assert set(kept["trained + safe"]["gain"]) == {"trained"}


def test_the_policy_that_comes_with_the_package(run, folder, tmp_path, monkeypatch):
    pretrained = importlib.import_module("bsk_torch.rl.policies.pretrained")
    monkeypatch.setattr(pretrained, "makings", lambda: {"NadirScan-v1": {}})
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    (tmp_path / "NadirScan-v1.pt").write_bytes((folder / "policy.pt").read_bytes())
    result = run("eval", "pretrained", *TWO, "--no-baselines", "--out", tmp_path / "e.json")
    assert result.exit_code == 0, result.output
    assert list(json.loads((tmp_path / "e.json").read_text())) == ["pretrained"]
    result = run("eval", "pretrained", "--preset", "AEOS-v1", *TWO)
    assert result.exit_code == 1
    assert "there is no pretrained policy for 'AEOS-v1'" in result.output


def test_a_rule_may_come_from_the_present_folder(run, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")  # is taken off again afterwards, with what the command puts there
    (tmp_path / "my_shield.py").write_text(
        "from bsk_torch.act import allow_only\n\n\n"
        "def only_charge(see, actions):\n"
        "    return allow_only(actions, 'action_charge', where=see['time'] >= 0.0)\n"
    )
    result = run("eval", "random", *TWO, "--no-baselines", "--shield", "my_shield:only_charge", "--out", "e.json")
    assert result.exit_code == 0, result.output
    kept = json.loads((tmp_path / "e.json").read_text())
    assert kept["random + my_shield:only_charge"]["collected"] == 0.0
    assert kept["random"]["collected"] > 0.0


def test_one_seed_is_one_episode(run, tmp_path):
    result = run("eval", "rule", *SHORT, "--no-baselines", "--seeds", "7", "--episodes-out", tmp_path / "e.csv")
    assert result.exit_code == 0, result.output
    with (tmp_path / "e.csv").open() as file:
        assert [line["seed"] for line in csv.DictReader(file)] == ["7"]


def test_a_rule_that_does_not_fit_is_refused_with_those_that_do(run):
    result = run("eval", "greedy", *TWO)
    assert result.exit_code == 1
    assert "Scanner1 observes no targets. Baselines that fit: random, rule, cautious" in result.output
    assert len(result.output.splitlines()) == 1


def test_a_policy_of_another_preset_is_refused(run, folder):
    result = run("eval", folder, "--preset", "AEOSPower-v1", *TWO)
    assert result.exit_code == 1
    assert "NadirScan-v1" in result.output
    assert "AEOSPower-v1" in result.output
    assert "n_actions=4" in result.output
    assert len(result.output.splitlines()) == 1


def test_a_preset_that_does_not_know_the_options_of_the_policy_is_refused(run, folder, tmp_path):
    card = torch.load(folder / "policy.pt", weights_only=True) | {"preset": "AEOS-v1", "options": {"as_set": True}}
    torch.save(card, tmp_path / "policy.pt")
    result = run("eval", tmp_path, "--preset", "NadirScan-v1", *TWO)
    assert result.exit_code == 1
    assert "trained for AEOS-v1 with {'as_set': True}; NadirScan-v1 cannot be made so" in result.output


def test_a_file_that_is_no_policy_is_refused(run, tmp_path):
    (tmp_path / "policy.pt").write_text("nothing")
    result = run("eval", tmp_path, *TWO)
    assert result.exit_code == 1
    assert "is no file of a policy" in result.output


def test_a_policy_of_another_version_is_told_of(run, folder, tmp_path, caplog):
    card = torch.load(folder / "policy.pt", weights_only=True) | {"bsk_torch": "0.0.1"}
    torch.save(card, tmp_path / "policy.pt")
    result = run("eval", tmp_path, "--no-baselines", *TWO)
    assert result.exit_code == 0, result.output
    assert "the policy is of bsk_torch 0.0.1" in caplog.text
