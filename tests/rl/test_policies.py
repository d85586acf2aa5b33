"""Files of policies, and what they are refused for."""

import logging
import random

import pytest
import torch

import bsk_torch
from bsk_torch.cli.policies import warn_of_objects
from bsk_torch.rl.networks.plans import MLPPlan
from bsk_torch.rl.policies.checksummed import CHECKSUM_MARK, save_checksummed
from bsk_torch.rl.policies.files import check_fits, policy_of_file, read_card, save_policy
from bsk_torch.rl.policies.pretrained import FOLDER
from tests.support.refusals import check_refusals, refusal


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


def test_another_version_is_noted(path, env, caplog):
    card = read_card(path) | {"bsk_torch": "0.0.1"}
    with caplog.at_level(logging.WARNING):
        check_fits(card, env)
    assert "bsk_torch 0.0.1" in caplog.text


def test_rejects_flipped_bits(path):
    def flipped(place):
        changed = bytearray(content)
        changed[place // 8] ^= 1 << place % 8
        path.write_bytes(changed)
        policy_of_file(path)

    content, draw = path.read_bytes(), random.Random(1)
    places = [draw.randrange(8 * len(content)) for _ in range(200)]
    check_refusals(refusal(lambda place=place: flipped(place), ValueError, "policy.pt", "damaged") for place in places)


def test_a_policy_of_release_0_1_loads_with_a_warning(path, caplog):
    card, weights = read_card(path), weights_of(path)
    torch.save(card, path)
    assert weights_of(path).equal(weights)
    assert "has no checksum" in caplog.text


def weights_of(path):
    return torch.cat([value.double().flatten() for value in policy_of_file(path).state_dict().values()])


def test_rejects_files_of_others(path, tmp_path):
    def holding(content):
        path.write_bytes(content)
        policy_of_file(path)

    def without_checksum(entries):
        torch.save(entries, path)
        policy_of_file(path)

    def saved(**entries):
        save_checksummed(path, card | entries)
        policy_of_file(path)

    def weight(value):
        saved(actor=card["actor"] | {next(iter(card["actor"])): value})

    planned = lambda n_observed, hidden: saved(plan={"n_observed": n_observed, "n_actions": 4, "hidden": hidden})
    card, version = read_card(path), bsk_torch.__version__
    narrow = card | {"actor": {name: value[..., :-1] for name, value in card["actor"].items()}}
    cost = {"decisions": 5, "core_seconds": 1.0, "tuning_runs": 0}
    infinite = {name: torch.full_like(value, torch.nan) for name, value in card["actor"].items()}
    other = bsk_torch.make("AEOSPower-v1", num_envs=1, backend="eager", time_limit=300.0)
    check_refusals(
        refusal(lambda: check_fits(card, other, "AEOSPower-v1"), ValueError, "NadirScan-v1", "n_observed=12", "AEOSPower-v1"),
        refusal(lambda: policy_of_file(tmp_path / "nowhere"), FileNotFoundError, "nowhere", "policy.pt"),
        refusal(lambda: holding(b"no policy"), ValueError, "policy.pt", "file of a policy"),
        refusal(lambda: holding(b""), ValueError, "policy.pt", "file of a policy"),
        refusal(lambda: without_checksum({"weights": torch.zeros(2)}), ValueError, "policy.pt", version),
        refusal(lambda: without_checksum(narrow), ValueError, "policy.pt", "plan", "shape"),
        refusal(lambda: saved(actor=infinite), ValueError, "policy.pt", version, "not finite"),
        refusal(lambda: saved(preset=5), ValueError, "policy.pt", version),
        refusal(lambda: saved(options=[1]), ValueError, "policy.pt", version),
        refusal(lambda: saved(options={"log_dir": "somewhere"}), ValueError, "policy.pt", "'log_dir'"),
        refusal(lambda: saved(training={"decisions": 5}), ValueError, "policy.pt", version),
        refusal(lambda: saved(training=cost | {"core_seconds": float("nan")}), ValueError, "policy.pt", version),
        refusal(lambda: saved(training=cost | {"tuning_runs": "none"}), ValueError, "policy.pt", version),
        refusal(lambda: saved(network=None), ValueError, "policy.pt", version),
        refusal(lambda: saved(network="mpl"), ValueError, "network", "'mpl'", "'mlp'"),
        refusal(lambda: saved(groups=5), ValueError, "policy.pt", version),
        refusal(lambda: saved(groups={}), ValueError, "policy.pt", version),
        refusal(lambda: saved(groups={"a": 5}), ValueError, "policy.pt", version),
        refusal(lambda: saved(actor={"x": "y"}), ValueError, "policy.pt", version),
        refusal(lambda: saved(plan={}), ValueError, "policy.pt", "MLPPlan", "'n_observed'"),
        refusal(lambda: planned(12, "wide"), ValueError, "policy.pt", "'size'", "str"),
        refusal(lambda: planned(12, (10**6, 10**6)), ValueError, "policy.pt", "plan", "shape"),
        refusal(lambda: planned(12, (8,) * 65), ValueError, "policy.pt", "65 layers", "64"),
        refusal(lambda: planned(12, (8,) * 10**5), ValueError, "policy.pt", version),
        refusal(lambda: planned(-1, (8,)), ValueError, "policy.pt", version),
        refusal(lambda: saved(options={"a": [[[[[1]]]]]}), ValueError, "policy.pt", version),
        refusal(lambda: saved(options={"a": {"b": {1: 2}}}), ValueError, "policy.pt", version),
        refusal(lambda: saved(objects=["a b"]), ValueError, "policy.pt", version),
        refusal(lambda: weight(torch.zeros(1).expand(10**6, 10**5)), ValueError, "policy.pt", "tensors have 400,000,000"),
        refusal(lambda: weight(torch.zeros(2, 2).to_sparse()), ValueError, "policy.pt", "plain"),
        refusal(lambda: weight(torch.zeros(2, 2, device="meta")), ValueError, "policy.pt"),
    )


def test_files_keep_plain_options_and_name_objects(tmp_path, env, caplog):
    plan, sat_args = MLPPlan.of(env, (8,)), {"panelArea": 0.3, "wheelSpeeds": (1.0, 2.0)}
    options = {"sat_args": sat_args, "scenario": object(), "rewarder": {"part": object()}}
    save_policy(tmp_path / "policy.pt", plan, plan.build(), "NadirScan-v1", options)
    card = read_card(tmp_path)
    assert (card["options"], card["objects"]) == ({"sat_args": sat_args}, ["rewarder", "scenario"])
    for preset, given in (("mine.py:scanner", {}), ("NadirScan-v1", {"rewarder", "scenario"}), ("NadirScan-v1", {"rewarder"})):
        warn_of_objects("runs/a", card, preset, given)
    [message] = caplog.messages
    assert "its own scenario," in message


def test_policies_of_the_package_carry_checksums_and_no_logs(tmp_path, env):
    plan = MLPPlan.of(env, (8,))
    save_policy(tmp_path / "policy.pt", plan, plan.build(), "NadirScan-v1", {"log_dir": "x", "log_level": "INFO", "as_set": True})
    assert read_card(tmp_path)["options"] == {"as_set": True}
    files = sorted(FOLDER.glob("*.pt"))
    assert len(files) >= 7
    assert all(file.read_bytes()[:-32].endswith(CHECKSUM_MARK) for file in files)
