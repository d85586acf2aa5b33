"""Masks of actions by name, for rules that say what a satellite may do."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import torch
from torch import Tensor

from bsk_torch.sim.params import nearest


def only(actions: Sequence[str], *names: str, where: Tensor) -> Tensor:
    """Which of A actions are allowed, [..., A], if only ``names`` are ``where`` [...] holds, and all of them elsewhere.

    Args:
        actions: Names of all actions, as ``satellite.action_description`` has them.
        *names: Names of some of them; ValueError, with the nearest name, for one that does not exist.
        where: Booleans.
    """
    return ~where.unsqueeze(-1) | _named(tuple(actions), names, where.device)


def never(actions: Sequence[str], *names: str, where: Tensor) -> Tensor:
    """Which of A actions are allowed, [..., A], if ``names`` are not ``where`` [...] holds; see :func:`only`."""
    return ~(where.unsqueeze(-1) & _named(tuple(actions), names, where.device))


@lru_cache
def _named(actions: tuple[str, ...], names: tuple[str, ...], device: torch.device) -> Tensor:
    """Whether each action is one of ``names``, [A]."""
    for name in names:
        if name not in actions:
            raise ValueError(f"{name!r} is not one of the actions; {nearest(name, actions)}")
    return torch.tensor([action in names for action in actions], device=device)
