"""Files of policies, and what they are refused for."""

import logging

import pytest
import torch

import bsk_torch
from bsk_torch.rl.networks.plans import MLPPlan
from bsk_torch.rl.policies.files import check_fits, load_policy, read_card, save_policy


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=2, seed=0, backend="eager", time_limit=300.0)


@pytest.fixture
def path(tmp_path, env):
    plan = MLPPlan.of(env, (8,))
    save_policy(
        tmp_path / "policy.pt", plan, plan.build(), "NadirScan-v1", {"time_limit": 300.0, "backend": "eager", "x": object()}
    )
    return tmp_path / "policy.pt"


def test_a_policy_says_what_it_is_for(path, env):
    card = read_card(path.parent)
    assert (card["preset"], card["options"], card["network"]) == ("NadirScan-v1", {"time_limit": 300.0}, "mlp")
    check_fits(card, env)
    assert [file.name for file in path.parent.iterdir()] == ["policy.pt"]


def test_a_policy_of_another_problem_names_both(path):
    card = read_card(path)
    other = bsk_torch.make("AEOSPower-v1", num_envs=1, backend="eager", time_limit=300.0)
    with pytest.raises(ValueError, match=r"trained for NadirScan-v1 .*n_observed=12, n_actions=4; AEOSPower-v1 has n_observed="):
        check_fits(card, other, "AEOSPower-v1")


def test_another_version_is_noted(path, env, caplog):
    card = read_card(path) | {"bsk_torch": "0.0.1"}
    with caplog.at_level(logging.WARNING):
        check_fits(card, env)
    assert "bsk_torch 0.0.1" in caplog.text


def test_weights_that_do_not_fit_are_refused(path):
    card = read_card(path)
    card["actor"] = {name: value[..., :-1] for name, value in card["actor"].items()}
    torch.save(card, path)
    with pytest.raises(ValueError, match="does not fit this version"):
        load_policy(path)


@pytest.mark.parametrize("content", [b"no policy", b""])
def test_files_that_are_no_policies_are_refused(tmp_path, content):
    (tmp_path / "policy.pt").write_bytes(content)
    with pytest.raises(ValueError, match="is no file of a policy"):
        load_policy(tmp_path)


def test_other_files_of_torch_are_refused(tmp_path):
    torch.save({"weights": torch.zeros(2)}, tmp_path / "policy.pt")
    with pytest.raises(ValueError, match="no policy of this version"):
        load_policy(tmp_path / "policy.pt")


def test_a_missing_policy_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no policy"):
        load_policy(tmp_path / "nowhere")
