"""The action that continues a task, which environments of all kinds share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

NO_ACTION = 2**31 - 1
"""Action that continues a satellite's task; the last action of every space does the same."""

CLOSE = 1.0
"""Distance from ``NO_ACTION`` within which a floating-point number is treated as equal, since float32 cannot represent it."""


def is_no_action(action: object) -> bool:
    """Return whether an action only continues the task: None, ``NO_ACTION``, or a sequence or array of ``NO_ACTION`` only.

    Floating-point numbers within 1 of ``NO_ACTION`` count as equal. Empty arrays and non-numeric values are actions.
    """
    if action is None:
        return True
    values = action.detach().cpu().numpy() if isinstance(action, Tensor) else action
    if isinstance(values, bool) or not isinstance(values, int | float | np.number | np.ndarray | list | tuple):
        return False
    values = np.asarray(values)
    if values.size == 0 or not np.issubdtype(values.dtype, np.number):
        return False
    exact = np.issubdtype(values.dtype, np.integer)
    return bool(np.all(values == NO_ACTION if exact else np.abs(values.astype(np.float64) - NO_ACTION) <= CLOSE))


def no_action_like(action: Any) -> Any:
    """Return ``NO_ACTION`` for an integer, else an array or tensor of the action's shape and type filled with it."""
    if isinstance(action, int | np.integer):
        return NO_ACTION
    if isinstance(action, Tensor):
        return torch.full_like(action, NO_ACTION)
    return action * 0 + NO_ACTION


def no_action_keep_indices(actions: Sequence[object], n_observations: int) -> tuple[list[int], list[int]]:
    """Return the actions of an episode without those that only continue a task, and the corresponding observations.

    These are the observations from which the remaining actions were chosen, and the last one, so that its duration is kept.
    """
    kept = [k for k, action in enumerate(actions) if not is_no_action(action)]
    return kept, [*kept, n_observations - 1]
