"""Motion of a deputy close to a chief on a nearly circular orbit, in the chief's Hill frame.

The Clohessy-Wiltshire equations, with position (x, y, z), m: radial, along the track, and normal, and mean motion n, rad/s::

    x'' = 3 n^2 x + 2 n y',  y'' = -2 n x',  z'' = -n^2 z

(Clohessy and Wiltshire, Terminal Guidance System for Satellite Rendezvous, 1960; Schaub and Junkins, section 14.4). They leave
out terms of the order of distance over radius and of the eccentricity.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["Transition", "circumnavigation", "propagate", "pushed", "transfer", "transition"]


class Transition(NamedTuple):
    """State transition over a time: ``rho(t) = rr rho + rv rho'`` and ``rho'(t) = vr rho + vv rho'``, [..., 3, 3] each."""

    rr: Tensor
    rv: Tensor
    vr: Tensor
    vv: Tensor


def transition(n: Tensor, time: Tensor) -> Transition:
    """Return the state transition over ``time`` [...] s with mean motion ``n`` [...] rad/s."""
    n, time = torch.broadcast_tensors(n, time)
    angle = n * time
    s, c = torch.sin(angle), torch.cos(angle)
    rows: dict[str, tuple[Tensor | int, ...]] = {
        "rr": (4.0 - 3.0 * c, 0, 0, 6.0 * (s - angle), 1, 0, 0, 0, c),
        "rv": (s / n, 2.0 * (1.0 - c) / n, 0, 2.0 * (c - 1.0) / n, (4.0 * s - 3.0 * angle) / n, 0, 0, 0, s / n),
        "vr": (3.0 * n * s, 0, 0, 6.0 * n * (c - 1.0), 0, 0, 0, 0, -n * s),
        "vv": (c, 2.0 * s, 0, -2.0 * s, 4.0 * c - 3.0, 0, 0, 0, c),
    }
    filled = {
        name: torch.stack([x if isinstance(x, Tensor) else torch.full_like(s, x) for x in row], -1).unflatten(-1, (3, 3))
        for name, row in rows.items()
    }
    return Transition(**filled)


def propagate(rho: Tensor, velocity: Tensor, n: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
    """Return position, m, and velocity, m/s, after ``time`` [...] s from ``rho`` and ``velocity`` [..., 3]."""
    step = transition(n, time)
    rho, velocity = rho.unsqueeze(-1), velocity.unsqueeze(-1)
    return (step.rr @ rho + step.rv @ velocity).squeeze(-1), (step.vr @ rho + step.vv @ velocity).squeeze(-1)


def pushed(n: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
    """Return the change of position and velocity by a constant acceleration a: ``r a`` m and ``v a`` m/s, [..., 3, 3] each.

    The integrals of ``rv`` and ``vv`` of :func:`transition` over ``time`` [...] s, with mean motion ``n`` [...] rad/s.
    """
    n, time = torch.broadcast_tensors(n, time)
    angle = n * time
    s, one_c = torch.sin(angle), 2.0 * torch.sin(0.5 * angle) ** 2  # 1 - cos(angle), without cancellation
    zero, square = torch.zeros_like(s), n * n
    across = 2.0 * (angle - s) / square
    r = (one_c / square, across, zero, -across, 4.0 * one_c / square - 1.5 * time**2, zero, zero, zero, one_c / square)
    along = 2.0 * one_c / n
    v = (s / n, along, zero, -along, 4.0 * s / n - 3.0 * time, zero, zero, zero, s / n)
    first, second = (torch.stack(row, -1).unflatten(-1, (3, 3)) for row in (r, v))
    return first, second


def transfer(rho: Tensor, target: Tensor, n: Tensor, time: Tensor) -> Tensor:
    """Return the velocity, m/s [..., 3], that takes a deputy from ``rho`` to ``target`` [..., 3] m in ``time`` [...] s.

    ``rho' = rv^-1 (target - rr rho)``. No velocity does so after multiples of half a period, where ``rv`` is singular: the result
    is not finite there.
    """
    step = transition(n, time)
    ahead = target - (step.rr @ rho.unsqueeze(-1)).squeeze(-1)
    along = step.rv[..., 0, 0], step.rv[..., 0, 1], step.rv[..., 1, 1]
    determinant = along[0] * along[2] + along[1] * along[1]
    x = (along[2] * ahead[..., 0] - along[1] * ahead[..., 1]) / determinant
    y = (along[1] * ahead[..., 0] + along[0] * ahead[..., 1]) / determinant
    return torch.stack([x, y, ahead[..., 2] / step.rv[..., 2, 2]], -1)


def circumnavigation(direction: Tensor, n: Tensor) -> Tensor:
    """Return the velocity, m/s [..., 3], with which a deputy at ``direction`` [..., 3] m flies around the chief without drift.

    ``y' = -2 n x`` cancels the drift along the track, and ``x' = n y / 2`` centers the ellipse of axes 1 to 2 on the chief.
    """
    x, y, _ = direction.unbind(-1)
    return torch.stack([0.5 * n * y, -2.0 * n * x, torch.zeros_like(x)], -1)
