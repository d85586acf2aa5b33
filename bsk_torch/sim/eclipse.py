"""When the next eclipse starts and ends, as bsk_rl's look-ahead answers it."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.sim.orbit import Arcs
from bsk_torch.sim.ragged import stored, tabulate
from bsk_torch.sim.sight import Sight, View
from bsk_torch.sim.span import PLAN_STEP, SPAN

SEARCH_STEP, SEARCHES = 6000.0, 3
"""bsk_rl searches ahead of the query by 0, 6000 and 12000 s, and does not look at what the third search finds."""

UNKNOWN = 1.0
"""What a query answers where all searches fail: one second after the epoch."""


class EclipseTable:
    """Transitions into and out of the umbra on the 30 s grid of the planned arcs, and how far bsk_rl would know them.

    ``starts`` and ``ends`` [N, W] are the times, s, of the transitions, padded with infinity. ``sampled`` and ``known`` [N]
    are the times up to which bsk_rl's trajectory would have been propagated, and up to which transitions would have been
    recorded.
    """

    def __init__(self, arcs: Arcs, sight: Sight) -> None:
        """Prepare the table of ``arcs``."""
        self.arcs, self.sight = arcs, sight
        self.sampled, self.known = torch.zeros_like(arcs.start), torch.zeros_like(arcs.start)
        self.starts = torch.full((len(arcs.start), 1), torch.inf, dtype=torch.float64, device=arcs.device)
        self.ends = self.starts.clone()

    def reset(self, rows: Tensor, view: View, duration: Tensor) -> None:
        """Find the transitions of new arcs of ``rows`` [n]; windows have been generated for ``duration`` [n] s."""
        self.sampled[rows], self.known[rows] = duration, 0.0
        found = self._transitions(view, torch.zeros_like(duration), round(self.arcs.length / PLAN_STEP))
        self.starts, self.ends = (stored(old, rows, new) for old, new in zip((self.starts, self.ends), found, strict=True))

    def lengthen(self, rows: Tensor) -> None:
        """Find the transitions of the last hour of ``rows``; those before their arcs' beginning are forgotten."""
        view = View(self.arcs.planned_samples, self.arcs.sky_samples).of(rows)
        found = self._transitions(view, self.arcs.end[rows] - SPAN, round(SPAN / PLAN_STEP))
        self.starts, self.ends = (
            self._appended(old, rows, new) for old, new in zip((self.starts, self.ends), found, strict=True)
        )

    def _appended(self, old: Tensor, rows: Tensor, new: Tensor) -> Tensor:
        past = torch.where(old[rows] < self.arcs.start[rows].unsqueeze(-1), torch.inf, old[rows])
        both = torch.cat([past, new], 1).sort(1).values
        width = max(1, int(torch.isfinite(both).sum(1).max()))
        return stored(old, rows, both[:, :width])

    def _transitions(self, view: View, start: Tensor, steps: int) -> tuple[Tensor, Tensor]:
        """Times of the transitions into and out of the umbra after ``start`` [n], within so many samples, [n, W] each."""
        dark = self.sight.dark(view, start, steps + 1)
        before, after = dark[:, :-1], dark[:, 1:]

        def times(flags: Tensor) -> Tensor:
            row, sample = torch.nonzero(flags, as_tuple=True)
            return tabulate(row, start[row] + PLAN_STEP * (sample + 1), len(start))[0]

        return times(after & ~before), times(before & ~after)

    def adopt(self, rows: Tensor, other: EclipseTable) -> None:
        """Take over ``rows`` from a table of arcs of the same length."""
        self.starts, self.ends = stored(self.starts, rows, other.starts[rows]), stored(self.ends, rows, other.ends[rows])
        self.sampled[rows], self.known[rows] = other.sampled[rows], other.known[rows]

    @staticmethod
    def _next(table: Tensor, time: Tensor) -> Tensor:
        soonest = (torch.floor(time * (1.0 / PLAN_STEP)) + 1.0) * PLAN_STEP
        return torch.where(table >= soonest.unsqueeze(-1), table, torch.inf).amin(1)

    def needs(self, time: Tensor) -> Tensor:
        """Time up to which the arcs must reach to answer a query at ``time`` [N]."""
        return torch.maximum(time + SEARCH_STEP * (SEARCHES - 1), self.known) + 2 * PLAN_STEP

    def query(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Start and end of the next eclipse after ``time`` [N], s, not necessarily of the same one; [N] each."""
        start, end = self._next(self.starts, time), self._next(self.ends, time)
        last = torch.maximum(start, end) + PLAN_STEP
        found = last <= self.known
        for k in range(SEARCHES):
            reach = torch.floor((time + k * SEARCH_STEP + PLAN_STEP) / PLAN_STEP + 1e-9) * PLAN_STEP
            self.sampled = torch.where(found, self.sampled, torch.maximum(self.sampled, reach))
            self.known = torch.where(found, self.known, self.sampled)
            if k < SEARCHES - 1:
                found = found | (last <= self.known)
        unknown = torch.full_like(start, UNKNOWN)
        return torch.where(found, start, unknown), torch.where(found, end, unknown)
