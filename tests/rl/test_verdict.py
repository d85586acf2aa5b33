"""The last line of a training, and the table of scores behind it."""

import json
import math
from pathlib import Path

import pytest
import torch

from bsk_torch._listed import LISTED, REMARKS, makings, scores
from bsk_torch.cli.presets import scored
from bsk_torch.rl.evaluation.evaluate import Evaluation
from bsk_torch.rl.training import verdict as module
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.verdict import FEWEST, MOST, compared_episodes, verdict

ROOT = Path(__file__).parents[2]

UNMEASURED = {"Constellation-v1", "ThreeSensors-v1", "TipAndCue-v1", "Walker4-v1"}
"""Presets whose rules take core-minutes, to be measured on a quiet machine."""

ROW = {"mean": 1.0, "half_width": 0.1, "survival": 1.0, "options": {}, "core_seconds": 10.0}


def results(**shifts):
    """Results of policies whose returns differ by ``shifts``, and by noise of 0.1 from episode to episode."""
    generator = torch.Generator().manual_seed(1)
    common = torch.randn(64, generator=generator, dtype=torch.float64)
    made = {}
    for name, shift in shifts.items():
        returns = 10.0 + common + shift + 0.1 * torch.randn(64, generator=generator, dtype=torch.float64)
        one = torch.ones(64, dtype=torch.float64)
        made[name] = Evaluation(returns=returns, collected=returns, survived=one, decisions=one, seconds=one, deaths={})
    return made


def entry(gain, half):
    """Entry of a preset in the table."""
    policies = dict.fromkeys(("random", "rule", "cautious", "pretrained"), ROW)
    return {"episodes": 100, "best_rule": "cautious", "gain": {"mean": gain, "half_width": half}, "policies": policies}


def known(monkeypatch, **entries):
    """Replace the tables of scores and of published policies."""
    monkeypatch.setattr(module, "scores", lambda: entries)
    made = {"frames": 1000, "seconds": 600.0, "command": "bsk-torch train A --frames 1000"}
    monkeypatch.setattr(module, "makings", lambda: {name: made for name in entries if name != "C"})


@pytest.mark.parametrize(
    ("preset", "shifts", "expected"),
    [
        ("A", {"hasty": 0.0, "nearest": -3.0, "trained": 1.0}, ["the policy is better than the best rule, hasty: "]),
        (
            "A",
            {"hasty": 0.0, "trained": -1.0, "untrained": 5.0, "random": 5.0},
            ["rule hasty is better", "train A --frames 1000"],
        ),
        (
            "A",
            {"hasty": 0.0, "trained": 0.0},
            ["rule hasty may be as good", "in 64 unseen", "better than cautious by +0.5 ± 0.1"],
        ),
        ("B", {"hasty": 0.0, "trained": -1.0}, ["not known to be better than cautious (+0.1 ± 0.2): use the rule"]),
        ("C", {"hasty": 0.0, "trained": -1.0}, ["no training is known to do better in C: use the rule"]),
        ("mine", {"hasty": 0.0, "trained": -1.0}, ["imitate=hasty"]),
        ("A", {"random": 0.0, "trained": 1.0}, []),
    ],
)
def test_a_training_ends_with_the_better_of_policy_and_rule(monkeypatch, preset, shifts, expected):
    known(monkeypatch, A=entry(0.5, 0.1), B=entry(0.1, 0.2), C=entry(0.0, 0.1) | {"gain": None})
    monkeypatch.delenv("COLUMNS", raising=False)
    line = verdict(results(**shifts), preset)
    assert [part for part in expected if part not in line] == []
    assert bool(line) == bool(expected)


def test_presets_without_a_policy_say_what_policies_can_gain():
    assert verdict(results(glide=0.0, trained=-1.0), "CWDocking-v1").replace("\n", " ").endswith(REMARKS["CWDocking-v1"])
    assert REMARKS["CWDocking-v1"] in scored("CWDocking-v1")
    assert set(makings()).isdisjoint(REMARKS)
    for name in ("docking", "inspection"):
        found = json.loads((ROOT / "benchmarks" / "results" / f"thruster_{name}.json").read_text())
        rule = found["rows"][1]
        most = math.ceil(100.0 * (found["bound"] - rule["return"])) / 100.0
        assert REMARKS[found["options"]["preset"]] == f"no policy can gain more than {most} over {rule['entrant']}"


def test_a_comparison_takes_a_tenth_of_the_training_at_most(monkeypatch):
    known(monkeypatch, A=entry(0.5, 0.1))  # an episode of six policies: 0.6 core-s
    assert compared_episodes(PPOConfig("A", seconds=420.0)) == 64
    assert compared_episodes(PPOConfig("A", frames=700)) == 64  # at the speed of the published training
    assert compared_episodes(PPOConfig("A", seconds=5.0)) == FEWEST  # and of a default training at least
    assert compared_episodes(PPOConfig("A", seconds=1e6)) == compared_episodes(PPOConfig("mine")) == MOST


def test_every_preset_has_scores_of_its_rules_and_its_policy():
    table = scores()
    assert list(table) == [name for name in LISTED if name not in UNMEASURED or name in table], (
        "python scripts/tools/measure_presets.py --presets NAME adds a preset"
    )
    for name, found in table.items():
        policies = found["policies"]
        wanted = {"random", *LISTED[name].rules, *(["pretrained"] if name in makings() else [])}
        assert wanted <= {policy.partition(",")[0] for policy in policies}, name
        assert found["episodes"] >= 8
        rules = {policy: row["mean"] for policy, row in policies.items() if policy not in ("random", "pretrained")}
        assert found["best_rule"] == max(rules, key=rules.get)
        if name in makings():
            assert found["gain"]["mean"] == pytest.approx(policies["pretrained"]["mean"] - rules[found["best_rule"]], abs=1e-9)
