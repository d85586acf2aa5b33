"""Gymnasium's spaces for TorchRL's specs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from bsk_torch.env.action_forms import CHOICE, VALUES, form
from bsk_torch.env.satellite_group import SatelliteGroup

SEPARATOR = "/"
"""Between the names of a nested observation; Stable-Baselines3 supports one level, and torch does not allow dots in module
names."""


def flat(tree: Mapping[str, object]) -> dict[str, Any]:
    """Return the leaves of nested dictionaries or Dict spaces, by their joined names."""
    leaves: dict[str, object] = {}
    for name, part in tree.items():
        inner = flat(part) if isinstance(part, Mapping) else None
        leaves |= {name: part} if inner is None else {f"{name}{SEPARATOR}{key}": leaf for key, leaf in inner.items()}
    return leaves


def flat_rows(observation: Mapping[str, object], batch_dims: int = 1) -> dict[str, np.ndarray]:
    """Return the arrays of a named observation as Stable-Baselines3 takes them: by joined names, and single numbers as [1]."""
    return {name: leaf if leaf.ndim > batch_dims else leaf[..., np.newaxis] for name, leaf in flat(observation).items()}


def map_leaves(value: Any, function: Callable[[Tensor], Any]) -> Any:
    """Return ``function`` of an observation, or of every part of a named one, as nested dictionaries."""
    if isinstance(value, Tensor):
        return function(value)
    return {name: map_leaves(part, function) for name, part in value.items()}


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


def action_space(satellite: SatelliteGroup, extra: int = 0) -> spaces.Space[object]:
    """Return the space of a satellite's action, with ``extra`` choices at the end that continue its task.

    That is Discrete; a Box of float32 where actions are real numbers; or a Dict of the two as ``"values"`` and ``"choice"``.
    """
    builder = form(satellite)
    if builder is None:
        return spaces.Discrete(satellite.actions.n_actions + extra)
    low, high = (side.cpu().numpy().astype(np.float32) for side in (builder.low, builder.high))
    box = spaces.Box(low, high, dtype=np.float32)
    return spaces.Dict({VALUES: box, CHOICE: spaces.Discrete(builder.n_actions + extra)}) if builder.is_hybrid else box
