"""Actions for presets of all kinds."""

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDictBase


def legal_actions(td: TensorDictBase, action_keys: Iterable[Any], step: int) -> TensorDictBase:
    """Set actions that depend on the number of the step and what is legal only.

    Real numbers are a manoeuvre of some centimetres per second, and a drift of some minutes.
    """
    for key in action_keys:
        agents, generator = key[:-1] if isinstance(key, tuple) else (), torch.Generator().manual_seed(step)
        mask = td.get((*agents, "action_mask"), None)
        if mask is not None:
            draw = torch.rand(mask.shape, generator=generator)
            td = td.set(key, torch.where(mask, draw, -1.0).argmax(-1))
            continue
        draw = torch.rand(*td[agents].batch_size, 4, generator=generator)
        td = td.set(key, torch.where(torch.arange(4) < 3, 0.1 * (draw - 0.5), 100.0 + 200.0 * draw))
    return td
