"""``bsk-torch explain``."""

import functools
import json

import pytest
import torch

import bsk_torch
from bsk_torch.presets import PRESETS
from bsk_torch.rl.networks.plans import PLANS
from bsk_torch.rl.policies.files import save_policy

pytestmark = pytest.mark.compiled

SHORT = ("--time-limit", "1800", "--num-envs", "64")


@pytest.fixture
def scanning(tmp_path, monkeypatch):
    """A policy that scans all the time, where batteries are nearly empty at the start."""
    poor = functools.partial(PRESETS["NadirScan-v1"], sat_args={"storedCharge_Init": 2.5e4})
    monkeypatch.setitem(PRESETS, "NadirScan-v1", poor)
    env = bsk_torch.make("NadirScan-v1", num_envs=1, backend="eager")
    plan = PLANS["mlp"].of(env, (8,))
    networks = plan.build()
    with torch.no_grad():
        networks.actor.module[0].module[-1].bias.copy_(torch.tensor([100.0, 0.0, 0.0, 0.0]))
    save_policy(tmp_path / "policy.pt", plan, networks, "NadirScan-v1", {})
    return tmp_path


def test_deaths_are_explained_and_starts_tested(run, tmp_path, scanning):
    out = tmp_path / "failures.json"
    limits = ("--time-limit", "2400", "--num-envs", "256")
    drawn = tmp_path / "death.png"
    result = run("explain", scanning, "--seeds", "0:2", "--starts", "0:3", *limits, "--out", out, "--draw", drawn)
    assert result.exit_code == 0, result.output
    kept = json.loads(out.read_text())
    assert (kept["policy"], kept["seeds"], kept["episodes"]) == (scanning.name, [0, 2], 2)
    assert kept["causes"] == {"battery_valid": kept["died"]}
    assert kept["died"] == kept["saved"] + kept["lost"] + kept["open"] == len(kept["failures"]) > 0
    assert kept["survival"] == 1.0 - kept["died"] / 2
    assert kept["survival_of_the_best"]["at_least"] <= kept["survival_of_the_best"]["at_most"]
    assert kept["starts"]["seeds"] == [0, 3]
    assert kept["starts"]["survived"] > 0
    assert "last chance" in result.output
    assert f"{kept['died']} of 2 episodes end in death" in result.output
    assert "{" not in result.output
    assert f"{drawn}: the death in the episode of seed {kept['failures'][0]['seed']}" in result.output
    assert drawn.read_bytes().startswith(b"\x89PNG")


def test_survivors_need_no_explanation(run):
    result = run("explain", "rule", "--seed", "5", *SHORT)
    assert result.exit_code == 0, result.output
    assert result.output == "0 of 1 episodes end in death: survival 100.0%\n"
    assert "last chance" not in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("rulle",), "did you mean 'rule'?"),
        (("rule", "--seeds", "5:2"), "--seeds '5:2' names no episode"),
        (("rule", "--starts", "x"), "--starts 'x' must be A:B"),
        (("random", "--preset", "AEOS-v1"), "failures in AEOS-v1 cannot be explained: rescues need an action 'action_charge'"),
        (("random", "--preset", "Constellation-v1"), "Constellation-v1 has many satellites"),
    ],
)
def test_mistakes_are_named(run, arguments, message):
    result = run("explain", *arguments, *SHORT)
    assert result.exit_code == 1, result.output
    assert message in result.output
    assert len(result.output.splitlines()) == 1
