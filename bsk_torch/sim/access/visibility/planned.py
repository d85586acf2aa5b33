"""Planned orbits: their samples and ephemeris, and positions between the nodes of an arc."""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import BEFORE, COUNT, positions
from bsk_torch.astro.multistep import lagrange
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.component import Bus, Track, neighbours
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_at
from bsk_torch.sim.orbit.builder import ARC, FINE
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING, PLAN_STEP
from bsk_torch.vec3 import Vec3


class PlannedOrbits(NamedTuple):
    """Planned orbits of n satellites as tables; see :class:`bsk_torch.sim.orbit.arcs.Arcs`."""

    samples: Samples  # positions in N, m, every 30 s
    ephemeris: Samples  # records of the Sun and of the Earth's orientation

    def take(self, rows: Tensor) -> PlannedOrbits:
        """Return the orbits of ``rows`` [m], which may repeat."""
        return PlannedOrbits(*(take_rows(part, rows) for part in self))


def take_rows(samples: Samples, rows: Tensor) -> Samples:
    """Return the samples of ``rows`` [m], which may repeat, without copying the table."""
    return Samples(samples.table, samples.start, rows if samples.owner is None else samples.owner[rows])


def records_around(track: Track, samples: Samples, time: Tensor) -> tuple[Tensor, Tensor]:
    """Return the records of a track around ``time`` [n] s, one time for each row, and the time since the middle one, [n] s."""
    rows = torch.arange(len(time), device=time.device) if samples.owner is None else samples.owner
    return neighbours(track, samples.table, rows, time - samples.start[rows])


def position_between(nodes: Samples, ephemeris: Samples, time: Tensor) -> tuple[Vec3, Bus]:
    """Return positions in N, m, at ``time`` [n] s since reset, from nodes a minute apart, and Sun and Earth at these times."""
    around, tau = records_around(ARC, nodes, time)
    records, ephemeris_tau = records_around(EPHEMERIS_TRACK, ephemeris, time)
    return Vec3.of(positions(around, tau * (1.0 / NODE_SPACING))), ephemeris_at(records.flatten(1).unbind(-1), ephemeris_tau)


def sample_planned(orbits: PlannedOrbits, start: Tensor, count: int) -> tuple[Vec3, Bus]:
    """Return planned positions, Sun and Earth at ``count`` times 30 s apart from ``start`` [n] s on, flattened to [n * count]."""
    time = (start.unsqueeze(-1) + PLAN_STEP * torch.arange(count, dtype=start.dtype, device=start.device)).flatten()
    orbits = orbits.take(torch.arange(len(start), device=start.device).repeat_interleave(count))
    records, tau = records_around(EPHEMERIS_TRACK, orbits.ephemeris, time)
    return Vec3.of(records_around(FINE, orbits.samples, time)[0].squeeze(1)), ephemeris_at(records.flatten(1).unbind(-1), tau)


# -- twice as many nodes -------------------------------------------------------------------------------------------------------


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
