"""Episodes do not depend on how far arcs were solved and windows searched for them, which other environments decide."""

import pytest
import torch

import bsk_torch
from tests.support.choices import legal_actions

STEPS, COUNT = 8, 3

WORLDS = {
    "NadirScan-v1": dict(time_limit=20_000.0),
    "AEOSPower-v1": dict(time_limit=20_000.0),
    "AEOSConstellation-v1": dict(time_limit=20_000.0),
    "RSOInspection-v1": dict(),
}


@pytest.mark.compiled
@pytest.mark.parametrize("preset", WORLDS)
def test_episodes_do_not_notice_arcs_that_others_have_grown(preset):
    """Bit for bit: one environment's arcs are an hour longer from the beginning on, and again after every second step."""
    plain, grown = (bsk_torch.make(preset, num_envs=COUNT, backend="compiled", seed=5, **WORLDS[preset]) for _ in range(2))
    for simulator in grown.fleet.simulators:
        simulator.lookahead.grow()
    mine, theirs = plain.reset(), grown.reset()
    for step in range(STEPS):
        mine, theirs = (env.step(legal_actions(td, env.action_keys, step)) for env, td in ((plain, mine), (grown, theirs)))
        keys = set(mine.keys(True, True))
        assert keys == set(theirs.keys(True, True))
        for key in keys:
            assert torch.equal(mine[key], theirs[key]), (step, key)
        mine, theirs = (env.step_mdp(td) for env, td in ((plain, mine), (grown, theirs)))
        if step % 2:
            for simulator in grown.fleet.simulators:
                simulator.lookahead.grow()
    lengths = [[simulator.lookahead.arcs.length for simulator in env.fleet.simulators] for env in (plain, grown)]
    assert all(one < other for one, other in zip(*lengths, strict=True))
