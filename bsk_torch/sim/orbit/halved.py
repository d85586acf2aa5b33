"""Flown arcs at twice as many nodes, as planned arcs have."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import BEFORE, COUNT
from bsk_torch.astro.multistep import lagrange
from bsk_torch.sim.orbit.grid import LEAD_NODES


@functools.cache
def _weights(interval: int) -> tuple[float, ...]:
    """Return the weights of ten nodes in the position at the middle of an interval, counted from node :data:`BEFORE` on."""
    s = interval + 0.5
    return tuple(sum(float(c) * s**k for k, c in enumerate(terms)) for terms in lagrange(tuple(k - BEFORE for k in range(COUNT))))


def halved(flown: Tensor) -> Tensor:
    """Return positions at the last Q nodes of flown arcs [n, LEAD_NODES + Q, 3] m, and between them, [n, 2 Q - 1, 3] m.

    Those between nodes lie on the polynomials of :mod:`bsk_torch.astro.interpolate`; the last four on that through the last ten.
    """
    nodes, first = flown[:, LEAD_NODES:], flown[:, LEAD_NODES - BEFORE :]
    count = first.shape[1] - COUNT + 1
    middle = [_sum(first, count, 0), *(_sum(first[:, -COUNT:], 1, k) for k in range(1, COUNT - BEFORE - 1))]
    return torch.cat([torch.stack([nodes[:, :-1], torch.cat(middle, 1)], 2).flatten(1, 2), nodes[:, -1:]], 1)


def _sum(nodes: Tensor, count: int, interval: int) -> Tensor:
    """Return the positions at the middle of an interval of ``count`` polynomials through nodes [n, count + 9, 3]."""
    terms = (nodes[:, k : k + count] * weight for k, weight in enumerate(_weights(interval)))
    return functools.reduce(torch.add, terms)  # element by element: sums of matrix products depend on the batch
