"""Gymnasium's idioms on an environment of TorchRL fail at once, and the error says what to write."""

import pytest
import torch
from torchrl.envs import StepCounter

import bsk_torch
from bsk_torch.env.messages import ATTRIBUTES
from tests.wrappers.constellations import trio


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=2, backend="eager", time_limit=60.0)


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_an_attribute_of_gymnasium_names_the_one_to_read(env, name):
    assert not hasattr(env, name)
    with pytest.raises(AttributeError, match=rf"no attribute '{name}'.*TorchRL: "):
        getattr(env, name)


def test_the_advice_reaches_through_transforms(env):
    with pytest.raises(AttributeError, match=r"read env\.action_spec"):
        env.append_transform(StepCounter()).action_space  # noqa: B018


def test_other_unknown_attributes_fail_as_ever(env):
    with pytest.raises(AttributeError, match="no attribute 'satelite'"):
        env.satelite  # noqa: B018


@pytest.mark.parametrize(
    ("arguments", "advice"),
    [
        ({"seed": 1}, r"env\.set_seed\(seed\)"),
        ({"options": {}}, "set_state=True"),
        ({"sed": 1}, "tensordict and set_state"),
    ],
)
def test_reset_refuses_arguments_that_it_would_ignore(env, arguments, advice):
    with pytest.raises(TypeError, match=advice):
        env.reset(**arguments)


@pytest.mark.parametrize("action", [0, [0, 1], torch.tensor([0, 1])], ids=str)
def test_step_refuses_bare_actions(env, action):
    with pytest.raises(TypeError, match=r"td\['action'\] = actions; td = env\.step\(td\)\['next'\].*GymEnv"):
        env.step(action)


def test_a_constellation_names_the_action_of_its_group():
    env = trio(backend="eager")
    with pytest.raises(TypeError, match=r"td\['agents', 'action'\] = actions"):
        env.step([0, 1, 2])
