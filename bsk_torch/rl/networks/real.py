"""Policies whose actions are real numbers: bounds, and networks of their distributions."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form

Bounds = tuple[tuple[float, float], ...]
"""Lowest and highest value of each number of an action; empty where actions are chosen by their numbers."""

INITIAL_SCALE = 0.5
"""Deviation of actions at the start, before they are squashed into their bounds."""

SCALES = (0.01, 2.0)
"""Least and largest deviation."""


def bounds_of(env: SatelliteTasking) -> Bounds:
    """Return the bounds of the actions of an environment.

    Raises:
        ValueError: For bounds that are infinite, between which nothing can be drawn, and for hybrid actions.
    """
    builder = form(env.satellite)
    if builder is None:
        return ()
    title = f"action {builder.entry.name!r} of {env.satellite.name}"
    if builder.is_hybrid:
        raise ValueError(
            f"{title} has real numbers and a choice, which networks here do not learn; write an act.ContinuousAction whose last "
            "number is the choice"
        )
    pairs = tuple(zip(builder.low.tolist(), builder.high.tolist(), strict=True))
    endless = [
        f"{name} in {list(pair)}" for name, pair in zip(builder.names, pairs, strict=True) if not all(map(math.isfinite, pair))
    ]
    if endless:
        raise ValueError(
            f"{title} has infinite bounds ({', '.join(endless)}); give it finite ones, such as "
            "act.ImpulsiveThrust(max_dv=1.0, max_drift_duration=600.0), to learn or to draw actions"
        )
    return pairs


class Bell(nn.Module):
    """Means and deviations of normal distributions by a network; the deviations do not depend on the situation."""

    def __init__(self, network: nn.Module, width: int) -> None:
        """``network`` gives the ``width`` means."""
        super().__init__()
        self.network = network
        self.log_scale = nn.Parameter(torch.full((width,), math.log(INITIAL_SCALE)))

    def forward(self, *seen: Tensor) -> tuple[Tensor, Tensor]:
        """Means and deviations, [..., A] each."""
        loc = self.network(*seen)
        low, high = map(math.log, SCALES)
        return loc, self.log_scale.clamp(low, high).exp().expand_as(loc)


def squashed(bounds: Bounds) -> dict[str, Any]:
    """Return the arguments of TorchRL's ``TanhNormal`` beside mean and deviation."""
    low, high = torch.tensor(bounds, dtype=torch.float32).unbind(-1)
    return {"low": low, "high": high}


def spread(lot: Tensor, bounds: Bounds) -> Tensor:
    """Return actions [..., A] that are uniform within their bounds, by uniform numbers [...] of float64, one for each action.

    Each number of an action takes its own binary digits of the lot.
    """
    values, digits = [], 2.0 ** (48 // len(bounds))
    for low, high in bounds:
        lot = lot * digits
        whole = lot.floor()
        lot = lot - whole
        values.append(low + (whole + 0.5) / digits * (high - low))
    return torch.stack(values, -1)
