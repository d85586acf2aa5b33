"""Files of policies, and what they are refused for."""

import logging
import random

import pytest
import torch

import bsk_torch
from bsk_torch.rl.networks.plans import MLPPlan
from bsk_torch.rl.policies.checksummed import CHECKSUM_MARK, save_checksummed
from bsk_torch.rl.policies.files import check_fits, load_policy, read_card, save_policy
from bsk_torch.rl.policies.pretrained import FOLDER


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


# -- damaged files, and files of others -------------------------------------------------------------------------------


def test_a_flipped_bit_is_noticed(path):
    content, draw = path.read_bytes(), random.Random(1)
    for place in [draw.randrange(8 * len(content)) for _ in range(200)]:
        changed = bytearray(content)
        changed[place // 8] ^= 1 << place % 8
        path.write_bytes(changed)
        with pytest.raises(ValueError, match=r"policy\.pt' is a damaged policy"):
            load_policy(path)


def test_a_policy_of_release_0_1_loads_with_a_warning(path, caplog):
    card, weights = read_card(path), weights_of(path)
    torch.save(card, path)
    assert weights_of(path).equal(weights)
    assert "has no checksum" in caplog.text


def weights_of(path):
    return torch.cat([value.double().flatten() for value in load_policy(path).state_dict().values()])


def test_policies_of_the_package_carry_checksums():
    files = sorted(FOLDER.glob("*.pt"))
    assert len(files) >= 7
    assert all(file.read_bytes()[:-32].endswith(CHECKSUM_MARK) for file in files)


@pytest.mark.parametrize(
    ("entry", "value", "message"),
    [
        ("preset", 5, "no policy of this version"),
        ("options", [1], "no policy of this version"),
        ("network", None, "no policy of this version"),
        ("network", "mpl", "did you mean 'mlp'"),
        ("groups", 5, "no policy of this version"),
        ("groups", {}, "no policy of this version"),
        ("groups", {"a": 5}, "no policy of this version"),
        ("actor", {"x": "y"}, "no policy of this version"),
        ("plan", {}, "does not fit this version"),
        ("plan", {"n_observed": 12, "n_actions": 4, "hidden": "wide"}, "does not fit this version"),
        ("plan", {"n_observed": 12, "n_actions": 4, "hidden": (10**9, 10**9)}, "its plan"),
        ("plan", {"n_observed": -1, "n_actions": 4, "hidden": (8,)}, "does not fit this version"),
        ("options", {"log_dir": "somewhere"}, "not taken from files"),
    ],
)
def test_entries_of_others_are_refused(path, entry, value, message):
    save_checksummed(path, read_card(path) | {entry: value})
    with pytest.raises(ValueError, match=message):
        load_policy(path)


def test_weights_that_are_not_finite_are_refused(path):
    card = read_card(path)
    next(iter(card["actor"].values())).view(-1)[0] = torch.nan
    save_checksummed(path, card)
    with pytest.raises(ValueError, match="no policy of this version"):
        load_policy(path)


def test_logs_are_not_kept(tmp_path, env):
    plan = MLPPlan.of(env, (8,))
    save_policy(tmp_path / "policy.pt", plan, plan.build(), "NadirScan-v1", {"log_dir": "x", "log_level": "INFO", "as_set": True})
    assert read_card(tmp_path)["options"] == {"as_set": True}
