"""Action masks by the names of actions, for rules such as a safety shield."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import torch
from torch import Tensor

from bsk_torch.sim.arguments.values import nearest


def allow_only(actions: Sequence[str], *names: str, where: Tensor) -> Tensor:
    """Return a mask [..., A] of the ``actions`` that allows only those in ``names`` ``where`` [...] holds, and all elsewhere.

    ``actions`` are the names of all A actions, as in ``satellite.action_description``.
    """
    return ~where.unsqueeze(-1) | _is_named(tuple(actions), names, where.device)


def forbid(actions: Sequence[str], *names: str, where: Tensor) -> Tensor:
    """Return a mask that forbids some actions where a condition holds, [..., A] bool; see :func:`allow_only`."""
    return ~(where.unsqueeze(-1) & _is_named(tuple(actions), names, where.device))


@lru_cache
def _is_named(actions: tuple[str, ...], names: tuple[str, ...], device: torch.device) -> Tensor:
    for name in names:
        if name not in actions:
            raise ValueError(f"{name!r} is not an action; {nearest(name, actions)}")
    return torch.tensor([action in names for action in actions], device=device)
