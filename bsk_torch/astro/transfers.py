"""Transfers between points about a chief: manoeuvres and paths for many targets and durations at once."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.clohessy_wiltshire import propagate, transfer, transition

__all__ = ["Transfers", "closest", "transfers"]


class Transfers(NamedTuple):
    """Transfers of N deputies to D targets in K durations, in the chief's Hill frame.

    Attributes:
        dv: Manoeuvres that begin them, [N, D, K, 3] m/s.
        cost: Manoeuvres that would take them to the target, [N, D, K] m/s; that of ``dv`` where it is not limited.
        path: Positions at S moments, evenly spaced up to the arrival, [N, D, K, S, 3] m.
        time: These moments, [K, S] s after the manoeuvre.
        start: Positions at the manoeuvre, [N, 3] m.
    """

    dv: Tensor
    cost: Tensor
    path: Tensor
    time: Tensor

    start: Tensor

    def distances(self) -> tuple[Tensor, Tensor]:
        """Return the smallest and the largest distance from the chief on each path, [N, D, K] m each."""
        whole = torch.cat([self.start[:, None, None, None].expand_as(self.path[..., :1, :]), self.path], -2)
        return closest(whole), torch.linalg.vector_norm(whole, dim=-1).amax(-1)

    def apart(self, rho: Tensor, velocity: Tensor, n: Tensor) -> Tensor:
        """Return the smallest distance on each path from deputies that drift on, [N, O, D, K] m.

        Args:
            rho: Their positions, [N, O, 3] m.
            velocity: Their velocities in the Hill frame, [N, O, 3] m/s.
            n: Mean motion of the chiefs, [N] rad/s.
        """
        time = torch.cat([torch.zeros_like(self.time[:, :1]), self.time], 1)
        drift, _ = propagate(rho[:, :, None, None], velocity[:, :, None, None], n[:, None, None, None], time)
        whole = torch.cat([self.start[:, None, None, None].expand_as(self.path[..., :1, :]), self.path], -2)
        return closest(whole[:, None] - drift[:, :, None])


def transfers(
    rho: Tensor, velocity: Tensor, n: Tensor, targets: Tensor, durations: Tensor, samples: int, most: Tensor | None = None
) -> Transfers:
    """Return transfers by the Clohessy-Wiltshire equations; see :mod:`bsk_torch.astro.clohessy_wiltshire`.

    Args:
        rho: Positions of deputies, [N, 3] m.
        velocity: Their velocities in the Hill frame, [N, 3] m/s.
        n: Mean motion of the chiefs, [N] rad/s.
        targets: Targets, [D, 3] m.
        durations: Durations, [K] s.
        samples: Number S of moments.
        most: Largest manoeuvres, [N] m/s; larger ones are scaled down to it, and their paths miss the target.
    """
    start, rate = rho[:, None, None], n[:, None, None]
    dv = transfer(start, targets[:, None], rate, durations) - velocity[:, None, None]
    cost = torch.linalg.vector_norm(dv, dim=-1)
    if most is not None:
        dv = dv * (most[:, None, None] / cost.clamp(min=1e-30)).clamp(max=1.0).unsqueeze(-1)
    after = velocity[:, None, None] + dv
    time = durations.unsqueeze(-1) * (torch.arange(1, samples + 1, device=rho.device) / samples)
    step = transition(rate, time)
    drift = (step.rr @ rho[:, None, None, :, None]).squeeze(-1)
    # the transition is that of every target, so its product with all of their velocities is one matrix product
    moved = torch.einsum("nksij,ndkj->ndksi", step.rv, after)
    return Transfers(dv, cost, drift[:, None] + moved, time, rho)


def closest(path: Tensor) -> Tensor:
    """Return the smallest distance from the origin, [...], of straight lines from point to point of a path [..., S, 3]."""
    a, way = path[..., :-1, :], path.diff(dim=-2)
    part = (-(a * way).sum(-1) / way.square().sum(-1).clamp(min=1e-30)).clamp(0.0, 1.0)
    return torch.linalg.vector_norm(a + way * part.unsqueeze(-1), dim=-1).amin(-1)
