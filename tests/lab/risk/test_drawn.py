"""What is drawn for seeds without a reset is what a reset to them draws."""

import pytest
import torch

import bsk_torch
from bsk_torch.lab.risk.drawn import drawn_arguments, drawn_of_seeds, suns
from bsk_torch.rl.evaluation.evaluate import start_episodes

SEEDS = torch.tensor([0, 7, 2**33 + 1, 2**52 + 5, 7])


@pytest.mark.compiled
@pytest.mark.parametrize("preset", ["NadirScan-v1", "FaultyScan-v1", "AEOSPower-v1", "Constellation-v1"])
def test_draws_without_a_reset_are_those_of_a_reset(preset):
    env = bsk_torch.make(preset, num_envs=len(SEEDS), env_ids=[0] * len(SEEDS), time_limit=300.0)
    env.reset()
    before = drawn_arguments(env)[1].clone()
    names, drawn = drawn_of_seeds(env, SEEDS)
    assert torch.equal(drawn_arguments(env)[1], before)
    start_episodes(env, SEEDS.tolist())
    assert names == drawn_arguments(env)[0]
    assert torch.equal(drawn, drawn_arguments(env)[1])
    assert torch.equal(drawn[1], drawn[4])
    many = torch.arange(3000) + 2**40
    assert torch.equal(drawn_of_seeds(env, many)[1][2990:], drawn_of_seeds(env, many[2990:])[1])


def test_the_sun_is_given_in_the_hill_frames_of_drawn_orbits():
    env = bsk_torch.make("NadirScan-v1", num_envs=2, env_ids=[0, 0], time_limit=300.0, backend="eager")
    names, drawn = drawn_of_seeds(env, SEEDS)
    sun = suns(names, drawn)
    assert sun.shape == (5, 3)
    assert torch.allclose(sun.norm(dim=1), torch.ones(5, dtype=torch.float64))
    start_episodes(env, SEEDS[:2].tolist())
    up, far = (x / x.norm(dim=1, keepdim=True) for x in (env.satellite.dynamics.r_BN_N, env.simulator.world.r_SN_N))
    assert torch.allclose((up * far).sum(1), sun[:2, 0], atol=1e-9)
    assert suns(["storageInit"], drawn[:, :1]).shape == (5, 0)
