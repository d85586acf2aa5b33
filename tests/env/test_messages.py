"""Gymnasium's idioms on an environment of TorchRL fail at once, and the error says what to write."""

import pytest
import torch
from torchrl.envs import StepCounter

import bsk_torch
from bsk_torch.env.messages import ATTRIBUTES
from tests.support.refusals import check_refusals, refusal
from tests.wrappers.constellations import trio


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=2, backend="eager", time_limit=60.0)


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_an_attribute_of_gymnasium_names_the_one_to_read(env, name):
    assert not hasattr(env, name)
    with pytest.raises(AttributeError, match=rf"no attribute '{name}'.*TorchRL: "):
        getattr(env, name)


def test_rejects_calls_of_gymnasium(env):
    """The advice reaches through transforms; an unknown attribute fails as ever; a constellation names its group."""
    group, step = trio(backend="eager"), ("td['action']", "env.step(td)", "GymEnv")
    check_refusals(
        refusal(lambda: env.append_transform(StepCounter()).action_space, AttributeError, "'action_space'", "env.action_spec"),
        refusal(lambda: env.satelite, AttributeError, "'satelite'"),
        refusal(lambda: env.reset(seed=1), TypeError, "seed", "env.set_seed(seed)"),
        refusal(lambda: env.reset(options={}), TypeError, "options", "set_state=True"),
        refusal(lambda: env.reset(sed=1), TypeError, "sed", "tensordict", "set_state"),
        *(refusal(lambda a=a: env.step(a), TypeError, a, *step) for a in (0, [0, 1], torch.tensor([0, 1]))),
        refusal(lambda: group.step([0, 1, 2]), TypeError, [0, 1, 2], "td['agents', 'action']"),
    )
