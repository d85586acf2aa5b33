"""Where the satellite will be: arcs computed ahead of the simulation, in batched passes.

Without manoeuvres and above the felt atmosphere an orbit depends on nothing that the agent does, so it is solved in advance, and
a polynomial through positions a minute apart serves every tick.

Two arcs are kept for each satellite. The *flown* arc is the one that Basilisk integrates at the simulation's rate. The *planned*
arc is the one that bsk_rl looks ahead on, a Runge-Kutta propagation in steps of 30 s; its truncation error, metres per orbit, is
reproduced by adding the error of one such step to the equations of motion. Of the planned arc only the end is kept, which is
what look-ahead still has to search.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import coefficients, position, velocity
from bsk_torch.lanes.loop import Samples
from bsk_torch.sim.component import Bus, Track
from bsk_torch.sim.paths import ARC
from bsk_torch.sim.sky import SKY, sky_records
from bsk_torch.sim.solver import Solver
from bsk_torch.sim.span import LEAD, PER_SPAN, SPACING, SPAN

FIELDS = ("flown", "planned", "sky", "tail", "start", "et")
"""What arcs consist of."""

PLANNED_SPANS = 5
"""Hours of the planned arc that are kept."""


def follow_arc(bus: Bus) -> None:
    """Take position and velocity at the end of the tick from the arc."""
    path, s = coefficients([node.r for node in bus.arc]), bus.arc_tau * (1.0 / SPACING)
    bus.r, bus.v = position(path, s), velocity(path, s, SPACING)


class Arcs:
    """Flown and planned arcs of N satellites: ``spans`` hours of nodes for each, starting at its own time.

    ``flown`` [N, Q, 3] are positions in N, m, and ``sky`` [N, H, 16] the records of Sun and Earth, from time ``start`` [N] s on,
    positions from :data:`LEAD` nodes before; ``planned`` [N, P, 3] are the last planned positions.
    """

    def __init__(self, n: int, spans: int, solver: Solver, kept: int = PLANNED_SPANS) -> None:
        """Make room for ``n`` satellites; of planned arcs the last ``kept`` hours are kept."""
        self.solver, self.device = solver, solver.device

        def empty(*shape: int) -> Tensor:
            return torch.zeros(n, *shape, dtype=torch.float64, device=solver.device)

        self.kept = kept
        self.flown, self.sky = empty(LEAD + spans * PER_SPAN + 1, 3), empty(spans + 2, SKY.width)
        self.planned, self.tail = empty(min(spans, kept) * PER_SPAN + 1, 3), empty(solver.tail)
        self.start, self.et = empty(), empty()

    @property
    def length(self) -> float:
        """Seconds that every flown arc covers."""
        return (self.flown.shape[1] - 1 - LEAD) * SPACING

    @property
    def end(self) -> Tensor:
        """Time of the last node, [N]."""
        return self.start + self.length

    @property
    def planned_samples(self) -> Samples:
        """The planned arc as a track."""
        return Samples(self.planned, self.planned_from)

    @property
    def planned_from(self) -> Tensor:
        """Time of the first planned node that is kept, [N]."""
        return self.end - (self.planned.shape[1] - 1) * SPACING

    @property
    def sky_samples(self) -> Samples:
        """Sun and Earth as a track."""
        return Samples(self.sky, self.start)

    def tracks(self, tracks: Sequence[Track]) -> tuple[Samples, ...]:
        """Samples of the tracks of a tick."""
        samples = {SKY.name: self.sky_samples, ARC.name: Samples(self.flown, self.start - LEAD * SPACING)}
        return tuple(samples[track.name] for track in tracks)

    def reset(self, rows: Tensor, et: Tensor, r: Tensor, v: Tensor) -> Tensor:
        """Solve the arcs of ``rows`` [n] anew from ET [n] and position and velocity [n, 3] at time zero.

        Returns:
            Samples [n, 2 Q - 1, 3] of the whole planned arcs, every 30 s from time zero on.
        """
        self.start[rows], self.et[rows] = 0.0, et
        sky = sky_records(et, self.sky.shape[1])
        flown, planned, tail = self.solver.begin(et, r, v, sky, self.flown.shape[1] - LEAD)
        self.sky[rows], self.flown[rows], self.tail[rows] = sky, flown, tail
        self.planned[rows] = planned[:, ::2][:, -self.planned.shape[1] :]
        return planned

    def adopt(self, rows: Tensor, other: Arcs) -> None:
        """Take over the arcs of ``rows`` from others of the same length."""
        for name in FIELDS:
            getattr(self, name)[rows] = getattr(other, name)[rows]

    def extend(self, rows: Tensor) -> None:
        """Move the arcs of ``rows`` on by an hour, dropping one at their beginning."""
        self.start[rows] += SPAN
        self.sky[rows] = sky_records(self.et[rows] + self.start[rows], self.sky.shape[1])
        self._lengthen(rows, PER_SPAN)

    def grow(self) -> None:
        """Make every arc an hour longer."""
        pad = torch.nn.functional.pad
        self.flown = pad(self.flown, (0, 0, 0, PER_SPAN))
        if self.planned.shape[1] <= self.kept * PER_SPAN:
            self.planned = pad(self.planned, (0, 0, PER_SPAN, 0))
        self.sky = sky_records(self.et + self.start, self.sky.shape[1] + 1)
        self._lengthen(torch.arange(len(self.start), device=self.device), 0)

    def _lengthen(self, rows: Tensor, drop: int) -> None:
        """Solve another hour for ``rows``, whose first ``drop`` flown nodes go."""
        flown = self.flown[rows, drop : self.flown.shape[1] + drop - PER_SPAN]
        planned = self.planned[rows, PER_SPAN:]
        start, tail, sky = self.start[rows], self.tail[rows], self.sky[rows]
        flown, new, self.tail[rows] = self.solver.extend(self.et[rows], tail, start, sky, flown)
        self.flown[rows], self.planned[rows] = flown, torch.cat([planned, new[:, 1::2]], 1)


def spans_for(seconds: float) -> int:
    """Hours of arc that cover ``seconds``."""
    return max(1, math.ceil(seconds / SPAN))
