"""Saved states and trainings go on as if they had never stopped: every preset, every way through a file, every collector."""

import dataclasses
from importlib.util import find_spec

import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch.presets import PRESETS
from bsk_torch.rl.marl.runs import configure, training_of
from tests.support.choices import legal_actions
from tests.support.trainings import weights

pytestmark = pytest.mark.compiled

OPTIONS = {
    "Constellation-v1": {"n_satellites": 3, "n_targets": 120},
    "AEOS-v1": {"n_targets": 120},
    "AEOSPower-v1": {"n_targets": 120},
}

needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="needs pip install 'bsk_torch[ray]'")

COLLECTORS = ("single", "multi", pytest.param("ray", marks=needs_ray))

OTHERS = set(PRESETS) - {"NadirScan-v1", "Constellation-v1"}
"""Presets that are tested at night."""


def make(name: str, **options):
    return bsk_torch.make(name, num_envs=2, time_limit=2400.0, **(OPTIONS.get(name, {}) | options))


def play(env, td, steps):
    found = []
    for step in steps:
        td = env.step(legal_actions(td, env.action_keys, step))["next"]
        found.append(td)
        td = td.exclude("reward")
    return found


FORMS = {
    "plain": lambda saved: saved,
    "nested": TensorDict.from_dict,
    "batched": lambda saved: TensorDict(saved, [2]),
    "all dimensions": lambda saved: TensorDict.from_dict(saved, auto_batch_size=True),
}


@pytest.mark.nightly(*OTHERS)
@pytest.mark.parametrize("name", PRESETS)
def test_states_come_back_from_files(name, tmp_path):
    """``torch.save(state.to_dict())``, read without trust, in all forms that a tensordict has: bit for bit."""
    env = make(name, seed=5)
    play(env, env.reset(), range(3))
    state = env.get_state()
    if env.fleet.size > 1:
        assert any(leaf.ndim > 2 and leaf.shape[1] > 1 for leaf in state.values(True, True))
    torch.save(state.to_dict(), tmp_path / "state.pt")
    seen = env.reset(TensorDict({"state": state}, [2]), set_state=True)
    expected = play(env, seen, range(3, 7))
    for form, change in FORMS.items():
        saved = change(torch.load(tmp_path / "state.pt", weights_only=True))
        other = make(name, seed=99)
        other.reset()
        other.restore(saved)
        seen = other.reset(TensorDict({"state": other.get_state()}, [2]), set_state=True)
        for one, two in zip(expected, play(other, seen, range(3, 7)), strict=True):
            for key in one.keys(True, True):
                assert torch.equal(one[key], two[key]), (form, key)


def config_of(name, collector, frames):
    few = {"num_envs": 4, "rollout": 4, "minibatch": 8, "epochs": 1, "hidden": (32,), "evaluate_every": 0, "seconds": None}
    few |= {"learning_rate_schedule": "constant", "entropy_schedule": "constant"}  # others depend on the number of frames
    options = OPTIONS.get(name, {}) | {"time_limit": 1800.0}
    many = {"collector": collector, "workers": 2}
    return configure(name, network="mlp" if name == "NadirScan-v1" else None, frames=frames, options=options, **few, **many)


@pytest.mark.nightly(*OTHERS, "multi", "ray")
@pytest.mark.parametrize("collector", COLLECTORS)
@pytest.mark.parametrize("name", PRESETS)
def test_resumed_trainings_are_the_uninterrupted_ones(name, collector, tmp_path):
    whole, half = config_of(name, collector, 64), config_of(name, collector, 32)
    expected = training_of(whole, tmp_path / "whole").run()
    first = training_of(half, tmp_path / "parts").run()
    again = training_of(dataclasses.replace(half, frames=64), tmp_path / "parts", resume=True).run()
    assert not torch.equal(weights(first), weights(again))
    assert torch.equal(weights(again), weights(expected))
