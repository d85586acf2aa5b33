"""Gymnasium's spaces for TorchRL's specs."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from bsk_torch.env import SatelliteTasking


def observation_space(spec: Any, batch_dims: int = 1) -> spaces.Space[Any]:
    """Return the space of one observation: a Box, or a Dict of them for a Composite spec.

    Args:
        spec: Spec of a batch of observations.
        batch_dims: Number of leading dimensions to leave out: 1 for environments, 2 for environments and agents.
    """
    if hasattr(spec, "items"):
        return spaces.Dict({name: observation_space(part, batch_dims) for name, part in spec.items()})
    return unbounded(tuple(spec.shape[batch_dims:]), spec.dtype)


def unbounded(shape: tuple[int, ...], dtype: torch.dtype) -> spaces.Box:
    """Return the space of all arrays of a shape."""
    return spaces.Box(-np.inf, np.inf, shape, torch.empty((), dtype=dtype).numpy().dtype.type)


def action_space(core: SatelliteTasking) -> spaces.Discrete:
    """Return the space of one environment's action."""
    return spaces.Discrete(core.satellite.actions.n_actions)
