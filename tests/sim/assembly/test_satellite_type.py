"""What simulations of satellites of one type share."""

import pytest
import torch

from bsk_torch import make, rand
from bsk_torch.rand import first_key

pytestmark = pytest.mark.compiled

N = 40
"""Environments, enough for prepared episodes."""


@pytest.fixture(scope="module")
def env():
    return make("Constellation-v1", n_satellites=3, num_envs=N, seed=1)


def test_batches_prepared_episodes_and_copies_share_one_type(env):
    """Nothing is kept twice; a trial has one satellite of the type, and the same tick."""
    own, copy = env.fleet.simulators, env.like(2).fleet.simulators
    env.reset()
    for simulators in (copy, env.pool.fleet.simulators):
        assert [s.type for s in simulators] == [s.type for s in own]
    alone = own[0].type.alone
    assert (alone.usage.columns, alone.arguments.count) == (own[0].columns[:1], 1)
    assert alone.tick is own[0].tick
    one, all_three = (kind.arguments.draw(first_key(2)) for kind in (alone, own[0].type))
    drawn = [name for name, value in all_three.items() if isinstance(value, torch.Tensor) and len(value) == 6]
    assert drawn
    for name in drawn:
        assert torch.equal(one[name], all_three[name].view(2, 3, *all_three[name].shape[1:])[:, 0])


def test_changed_arguments_make_another_type(env):
    """The tick is the same unless a parameter may differ now; the old type is as it was."""
    old = env.simulator.type
    charge = old.changed([(0, "storedCharge_Init", 5e4, None)], [], N)
    assert charge.tick is old.tick
    assert charge.arguments.draw(first_key(2))["storedCharge_Init"].view(-1)[0] == 5e4
    mass = old.changed([(0, "mass", rand.Uniform(300.0, 310.0), None)], [], N)
    assert mass.tick is not old.tick
    freed = set(old.tick.shared.fields) - set(mass.tick.shared.fields)
    assert freed
    assert freed <= set(mass.tick.own.fields)
    for name in mass.tick.shared.fields:
        assert torch.equal(mass.tick.shared.view(mass.uniform, name), old.tick.shared.view(old.uniform, name))
    assert "mass" not in old.arguments.sat_args.random
