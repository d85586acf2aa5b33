"""Rules for thrusters."""

import pytest
import torch

import bsk_torch
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.policies.shared_policy import rule, shared_baselines


@pytest.mark.compiled
def test_glide_docks():
    env = bsk_torch.make("CWDocking-v1", num_envs=16, env_ids=[0] * 16)
    results = evaluate(rule("glide", env), env, seeds=range(16))
    assert results.counts["docked"].all()
    assert results.survived.all()
    assert results.seconds.max() < 800.0
    assert results.returns.min() > 2.0


@pytest.mark.compiled
def test_seek_inspects():
    env = bsk_torch.make("CWInspection-v1", num_envs=8, env_ids=[0] * 8)
    results = evaluate(rule("seek", env), env, seeds=range(8))
    assert results.survived.all()
    assert (results.counts["inspected"] == 99).all()
    assert results.returns.min() > 1.9


@pytest.mark.parametrize(("preset", "name"), [("CWDocking-v1", "glide"), ("CWInspection-v1", "seek")])
def test_rules_apply_to_their_presets(preset, name):
    env = bsk_torch.make(preset, num_envs=1, backend="eager")
    assert set(shared_baselines(env)) == {"random", name}


@pytest.mark.parametrize(
    ("preset", "name", "numbers"),
    [
        ("CWDocking-v1", "glide", {"share": (0.8, 0.5), "gain": (6.0, 2.0)}),
        ("CWInspection-v1", "seek", {"speed": (0.22, 0.1), "distance": (60.0, 40.0), "back": (0.01, 0.02), "gain": (1.5, 0.5)}),
    ],
)
def test_each_row_of_a_tuning_has_its_own_numbers(preset, name, numbers):
    env = bsk_torch.make(preset, num_envs=2, seed=0, backend="eager")
    decide, seen = rule(name, env).module, env.reset()["observation"]
    actions = decide(seen, **{key: torch.tensor(values) for key, values in numbers.items()})
    assert torch.equal(actions[0], decide(seen)[0])  # the first ones are those of the rule
    assert torch.equal(actions[1], decide(seen, **{key: values[1] for key, values in numbers.items()})[1])
    assert not torch.equal(actions[1], decide(seen)[1])
