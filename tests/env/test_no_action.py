"""NO_ACTION and its helpers, case by case as bsk_rl 1.3.8 answers them."""

import numpy as np
import pytest
import torch

from bsk_torch.env.no_action import NO_ACTION, is_no_action, no_action_keep_indices, no_action_like

NONE_AT_ALL = [
    None,
    NO_ACTION,
    np.int64(NO_ACTION),
    float(NO_ACTION),
    np.float32(NO_ACTION),
    NO_ACTION + 1.0,
    [NO_ACTION, NO_ACTION],
    (float(NO_ACTION),),
    np.full(3, NO_ACTION, np.float32),
    torch.full((2,), NO_ACTION),
]
ACTIONS = [0, -1, 3.5, NO_ACTION - 2.0, NO_ACTION - 1, [NO_ACTION, 0], [], np.array([]), "image", ["image"], True, torch.zeros(2)]


@pytest.mark.parametrize("action", NONE_AT_ALL, ids=repr)
def test_no_action_is_recognized_in_every_form(action):
    assert is_no_action(action) is True


@pytest.mark.parametrize("action", ACTIONS, ids=repr)
def test_anything_else_is_an_action(action):
    assert is_no_action(action) is False


def test_no_action_has_a_shape_and_indices():
    assert no_action_like(3) == NO_ACTION
    like = no_action_like(np.zeros(2, np.float32))
    assert like.dtype == np.float32
    assert is_no_action(like)
    tensor = no_action_like(torch.zeros(2, 3, dtype=torch.int64))
    assert tensor.shape == (2, 3)
    assert is_no_action(tensor)
    assert no_action_keep_indices([0, NO_ACTION, 2, None], 5) == ([0, 2], [0, 2, 4])
