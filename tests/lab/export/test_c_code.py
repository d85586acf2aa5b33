"""The C code decides as the package does."""

import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch.env.rollout import decide, play_episodes
from bsk_torch.lab.export.c_code import literal
from bsk_torch.lab.export.graph import MEMORY, OBSERVATION, flat
from bsk_torch.rl.evaluation.evaluate import start_episodes
from tests.lab.export.conftest import KINDS, compiled, situations

pytestmark = pytest.mark.compiled

TIE = 1e-4
"""Lead of an action, in logits, below which rounding may decide."""


@pytest.mark.parametrize("kind", KINDS)
def test_it_repeats_the_record_and_decides_alike_in_any_situation(exported, kind):
    policy = exported(kind)
    graphs = policy.graphs()
    assert set(graphs) == set(KINDS[kind][2])
    for group, graph in graphs.items():
        contract = policy.contracts[group]
        act, replay = compiled(policy.folders[group])
        n = len(contract["record"]["outputs"]["action"])
        assert n >= 15
        assert replay.startswith(f"{n} of {n} recorded decisions agree")
        inputs = situations(graph, contract)
        package = decide(policy.policies()[group], TensorDict(dict(zip(graph.paths, inputs, strict=True)), [200]))
        parts = [part for path, part in zip(graph.paths, inputs, strict=True) if path[:1] == OBSERVATION]
        memory = [part.clone() for path, part in zip(graph.paths, inputs, strict=True) if path == MEMORY]
        width = package["action" if graph.is_real else "logits"].shape[1]
        chosen, out = act(flat(parts), torch.ones(200, 1) if graph.is_real else inputs[-1], width, *memory)
        assert bool(memory) == ("gru" in kind)
        for part in memory:
            assert torch.allclose(part, package["next", "memory"], rtol=0.0, atol=1e-5)
        if graph.is_real:
            assert torch.allclose(out, package["action"], rtol=0.0, atol=1e-5)
            assert package["action"].std() > 0.1
            continue
        assert torch.allclose(out, package["logits"], rtol=1e-5, atol=TIE / 2)
        ours, theirs = (package["logits"].gather(1, x[:, None]) for x in (package["action"], chosen))
        assert bool(inputs[-1].gather(1, chosen[:, None]).all())
        assert float((ours - theirs).abs().max()) < TIE
        assert int((chosen != package["action"]).sum()) <= 1
        assert len(chosen.unique()) > 0.8 * graph.plan.n_actions


def test_it_refuses_what_flight_software_must_not_act_on(exported):
    policy = exported("mlp")
    act, _ = compiled(policy.folders["agents"])
    good = torch.tensor(policy.contracts["agents"]["record"]["inputs"]["observation"][:1])
    assert act(good, torch.zeros(1, 4), 4)[0].tolist() == [-1]
    for wrong in (torch.nan, torch.inf, -torch.inf):
        for column in (0, good.shape[1] - 1):
            broken = good.clone()
            broken[0, column] = wrong
            assert act(broken, torch.ones(1, 4), 4)[0].tolist() == [-2]


def test_a_memory_that_starts_at_zero_follows_episodes(exported):
    """The C code, with the memory that it made itself, decides as the package does, and unlike without one."""
    policy = exported("gru")
    act, _ = compiled(policy.folders["agents"])
    env, package = bsk_torch.make(policy.preset, num_envs=8, env_ids=[0] * 8, **policy.options), policy.policies()["agents"]
    for seed in (0, 1):  # the second episodes start with new zeros
        memory, decisions, forgetful = torch.zeros(8, 1, 6), 0, 0
        for playing, step in play_episodes(env, package, start_episodes(env, range(8 * seed, 8 * seed + 8))):
            asked, own = step[playing], memory[playing]
            chosen, _ = act(asked["observation"], asked["action_mask"], 4, own)
            assert torch.equal(chosen, asked["action"])
            memory[playing] = own
            forgetful += int((act(asked["observation"], asked["action_mask"], 4, own * 0.0)[0] != chosen).sum())
            decisions += len(chosen)
        assert decisions > 400
        assert forgetful > 200


def test_it_refuses_a_memory_that_is_not_finite_and_leaves_it(exported):
    policy = exported("gru")
    act, _ = compiled(policy.folders["agents"])
    observed = torch.tensor(policy.contracts["agents"]["record"]["inputs"]["observation"][:1])
    for wrong in (torch.nan, torch.inf):
        memory = torch.tensor([[[0.0, 0.5, wrong, 0.0, 0.0, 0.0]]])
        before = memory.clone()
        assert act(observed, torch.ones(1, 4), 4, memory)[0].tolist() == [-2]
        assert memory.nan_to_num().equal(before.nan_to_num())


def test_constants_are_read_as_the_same_float32():
    values = torch.cat([torch.randn(500), torch.tensor([0.0, 1.0, -3.0, 1e10, 1e-38, 16777216.0, 3.4e38])])
    texts = [literal(value) for value in values.tolist()]
    assert all(text.endswith("f") and any(sign in text for sign in ".e") for text in texts)
    assert torch.equal(torch.tensor([float(text[:-1]) for text in texts]), values)


def test_weights_and_code_are_small_and_allocate_nothing(exported):
    sources = [(folder / "policy.c").read_text() for kind in KINDS for folder in exported(kind).folders.values()]
    assert len(sources) == 7
    for source in sources:
        assert "alloc" not in source
        assert [line for line in source.splitlines() if line.startswith("#include")] == [
            '#include "policy.h"',
            "#include <float.h>",
            "#include <math.h>",
            "#include <stddef.h>",
        ]
