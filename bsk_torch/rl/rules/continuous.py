"""Bounds of continuous actions, and random continuous actions."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form

Bounds = tuple[tuple[float, float], ...]
"""Minimum and maximum of each number of a continuous action; empty for discrete actions."""


def bounds_of(env: SatelliteTasking) -> Bounds:
    """Return the bounds of the actions of an environment.

    ValueError for infinite bounds, between which no action can be drawn, and for hybrid actions.
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


def spread(lot: Tensor, bounds: Bounds) -> Tensor:
    """Return actions [..., A] uniform within their bounds, computed from one uniform float64 number per action, [...].

    Each number of an action uses separate binary digits of the uniform number.
    """
    values, digits = [], 2.0 ** (48 // len(bounds))
    for low, high in bounds:
        lot = lot * digits
        digit = lot.floor()
        lot = lot - digit
        values.append(low + (digit + 0.5) / digits * (high - low))
    return torch.stack(values, -1)
