"""When the next eclipse starts and ends, as bsk_rl's look-ahead answers it."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.ephemeris import sun_state
from bsk_torch.astro.interpolate import quintic_position
from bsk_torch.sim.orbit import Arcs, as_node
from bsk_torch.sim.span import PLAN_STEP, SPACING, SPAN
from bsk_torch.vec3 import Vec3

SEARCH_STEP, SEARCHES = 6000.0, 3
"""bsk_rl searches ahead of the query by 0, 6000 and 12000 s, and does not look at what the third search finds."""

NEVER = 2**30
"""Sample index of a transition that the arc does not contain."""

UNKNOWN = 1.0
"""What a query answers where all searches fail: one second after the epoch."""


def planned_samples(arcs: Arcs, rows: Tensor) -> Vec3:
    """Planned positions of ``rows`` every 30 s along their arcs, [n, K] components in N."""
    nodes = as_node(arcs.planned[rows])
    start, end = (
        type(nodes)(*(Vec3(*(x[:, part] for x in vector)) for vector in nodes)) for part in (slice(0, -1), slice(1, None))
    )
    middle = quintic_position(torch.tensor(0.5, dtype=torch.float64, device=arcs.device), SPACING, start, end)

    def woven(node: Tensor, between: Tensor) -> Tensor:
        pairs = torch.stack([node[:, :-1], between], -1).flatten(1)
        return torch.cat([pairs, node[:, -1:]], 1)

    return Vec3(*(woven(n, m) for n, m in zip(nodes.r, middle, strict=True)))


def _sun_along(et: Tensor, count: int) -> Vec3:
    """Sun at ``count`` samples from ET [n], [n, count] components: on a straight line within each hour."""
    per_span = round(SPAN / PLAN_STEP)
    sample = torch.arange(count, device=et.device)
    span = (sample // per_span).clamp(max=max(0, (count - 2) // per_span))
    middles = et.unsqueeze(-1) + SPAN * (torch.arange(int(span[-1]) + 1, device=et.device) + 0.5)
    r_sun, v_sun = (Vec3.of(x[:, span]) for x in sun_state(middles))
    return r_sun + v_sun * (PLAN_STEP * sample - SPAN * (span + 0.5))


def _next_true(flags: Tensor) -> Tensor:
    """Index of the first true flag at or after each sample of [n, K]; NEVER where there is none."""
    index = torch.arange(flags.shape[1], device=flags.device).expand(flags.shape)
    marked = torch.where(flags, index, torch.full_like(index, NEVER))
    return marked.flip(1).cummin(1).values.flip(1)


class EclipseTable:
    """Transitions into and out of the umbra on the 30 s grid of the planned arcs, and how far bsk_rl would know them.

    ``sampled`` and ``known`` [N] are the times up to which bsk_rl's trajectory would have been propagated, and up to which
    transitions would have been recorded.
    """

    def __init__(self, arcs: Arcs) -> None:
        """Prepare the table of ``arcs``; fill it with :meth:`refresh`."""
        self.arcs = arcs
        self.sampled, self.known = torch.zeros_like(arcs.start), torch.zeros_like(arcs.start)
        self.starts = self.ends = torch.zeros(0)

    def refresh(self, rows: Tensor) -> None:
        """Classify the samples of ``rows`` after their arcs have changed."""
        r = planned_samples(self.arcs, rows)
        count = r.x.shape[1]
        r_sun = _sun_along(self.arcs.et[rows] + self.arcs.start[rows], count)
        dark = illumination(r, r_sun) <= 0.0
        before = torch.cat([dark[:, :1], dark[:, :-1]], 1)
        self._make_room(count)
        # bsk_rl's samples carry the illumination of the sample before
        self.starts[rows], self.ends[rows] = _next_true(dark & ~before), _next_true(before & ~dark)

    def _make_room(self, count: int) -> None:
        if self.starts.shape[1:] != (count,):
            self.starts = torch.full((len(self.arcs.start), count), NEVER, device=self.arcs.device)
            self.ends = self.starts.clone()

    def adopt(self, rows: Tensor, other: EclipseTable) -> None:
        """Take over ``rows`` from a table of arcs of the same length."""
        self._make_room(other.starts.shape[1])
        self.starts[rows], self.ends[rows] = other.starts[rows], other.ends[rows]
        self.sampled[rows], self.known[rows] = other.sampled[rows], other.known[rows]

    def _next(self, table: Tensor, rows: Tensor, time: Tensor) -> Tensor:
        index = torch.floor((time - self.arcs.start[rows]) / PLAN_STEP).long() + 1
        sample = table[rows, index.clamp(0, table.shape[1] - 1)]
        seconds = self.arcs.start[rows] + sample * PLAN_STEP
        return torch.where(sample >= NEVER, torch.full_like(seconds, torch.inf), seconds)

    def needs(self, rows: Tensor, time: Tensor) -> Tensor:
        """Time up to which the arcs of ``rows`` must reach to answer a query at ``time`` [n]."""
        return torch.maximum(time + SEARCH_STEP * (SEARCHES - 1), self.known[rows]) + 2 * PLAN_STEP

    def query(self, rows: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
        """Start and end of the next eclipse after ``time`` [n], s, not necessarily of the same one; [n] each."""
        start, end = self._next(self.starts, rows, time), self._next(self.ends, rows, time)
        last = torch.maximum(start, end) + PLAN_STEP
        found = last <= self.known[rows]
        for k in range(SEARCHES):
            reach = torch.floor((time + k * SEARCH_STEP + PLAN_STEP) / PLAN_STEP + 1e-9) * PLAN_STEP
            sampled = torch.where(found, self.sampled[rows], torch.maximum(self.sampled[rows], reach))
            self.sampled[rows] = sampled
            self.known[rows] = torch.where(found, self.known[rows], sampled)
            if k < SEARCHES - 1:
                found = found | (last <= self.known[rows])
        unknown = torch.full_like(start, UNKNOWN)
        return torch.where(found, start, unknown), torch.where(found, end, unknown)
