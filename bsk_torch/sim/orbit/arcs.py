"""Arcs: positions of satellites, computed ahead of the simulation in batched passes.

Without manoeuvres and above the modelled atmosphere an orbit does not depend on actions, so it is solved in advance, and
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
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.component import Bus, Track
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_records
from bsk_torch.sim.orbit.builder import ARC
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, LEAD_NODES, NODE_SPACING, NODES_PER_SEGMENT
from bsk_torch.sim.orbit.solution import Solver
from bsk_torch.sim.state import StateTable

PLANNED_SEGMENTS = 5
"""Number of hours of the planned arc that are kept."""


def follow_arc(bus: Bus) -> None:
    """Interpolate position and velocity at the end of the tick: ``r_BN_N = p(s)`` and ``v_BN_N = p'(s) / NODE_SPACING``.

    ``p`` is the polynomial through neighbouring nodes of the arc, m in N, and ``s`` the time since the last one in units of their
    spacing; see :mod:`bsk_torch.astro.interpolate`.
    """
    path, s = coefficients([node.r_BN_N for node in bus.arc]), bus.arc_tau * (1.0 / NODE_SPACING)
    bus.r_BN_N, bus.v_BN_N = position(path, s), velocity(path, s, NODE_SPACING)


class Arcs(StateTable):
    """Flown and planned arcs of satellites: ``spans`` hours of nodes for each, starting at its own time.

    ``flown`` [N, Q, 3] are positions in N, m, and ``ephemeris`` [N, H, 16] the records of Sun and Earth, from ``start`` [N] s on,
    positions from :data:`LEAD_NODES` nodes before; ``planned`` [N, P, 3] are the last planned positions, ``tail`` [N, T] is the
    state of the solver at the end of the arcs, and ``et`` [N] is ET at time zero, s.
    """

    flown: Tensor
    planned: Tensor
    ephemeris: Tensor
    tail: Tensor
    start: Tensor
    et: Tensor

    def __init__(self, num_envs: int, spans: int, solver: Solver, kept: int = PLANNED_SEGMENTS, count: int = 1) -> None:
        """Make room for ``count`` satellites in each of ``num_envs`` episodes; planned arcs keep their last ``kept`` hours."""
        super().__init__(num_envs, count, solver.device)
        self.solver, self.kept = solver, kept
        self.declare("flown", None, LEAD_NODES + spans * NODES_PER_SEGMENT + 1, 3, grows=True)
        self.declare("planned", None, min(spans, kept) * NODES_PER_SEGMENT + 1, 3, grows=True)
        self.declare("ephemeris", None, spans + 2, EPHEMERIS_TRACK.width, grows=True)
        self.declare("tail", None, solver.tail)
        self.declare("start")
        self.declare("et")

    @property
    def length(self) -> float:
        """Seconds that every flown arc covers."""
        return (self.flown.shape[1] - 1 - LEAD_NODES) * NODE_SPACING

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
        return self.end - (self.planned.shape[1] - 1) * NODE_SPACING

    @property
    def ephemeris_samples(self) -> Samples:
        """Sun and Earth as a track."""
        return Samples(self.ephemeris, self.start)

    def tracks(self, tracks: Sequence[Track]) -> tuple[Samples, ...]:
        """Return the samples of the tracks of a tick."""
        samples = {
            EPHEMERIS_TRACK.name: self.ephemeris_samples,
            ARC.name: Samples(self.flown, self.start - LEAD_NODES * NODE_SPACING),
        }
        return tuple(samples[track.name] for track in tracks)

    def solve(self, rows: Tensor, et: Tensor, r: Tensor, v: Tensor) -> Tensor:
        """Solve the arcs of ``rows`` [n] anew from ET [n] and position and velocity [n, 3] at time zero.

        Returns:
            Samples [n, 2 Q - 1, 3] of the whole planned arcs, every 30 s from time zero on.
        """
        self.start[rows], self.et[rows] = 0.0, et
        ephemeris = ephemeris_records(et, self.ephemeris.shape[1])
        flown, planned, tail = self.solver.begin(et, r, v, ephemeris, self.flown.shape[1] - LEAD_NODES)
        self.ephemeris[rows], self.flown[rows], self.tail[rows] = ephemeris, flown, tail
        self.planned[rows] = planned[:, ::2][:, -self.planned.shape[1] :]
        return planned

    def extend(self, rows: Tensor) -> None:
        """Move the arcs of ``rows`` on by an hour, dropping one at their beginning."""
        self.start[rows] += ARC_SEGMENT
        self.ephemeris[rows] = ephemeris_records(self.et[rows] + self.start[rows], self.ephemeris.shape[1])
        self._lengthen(rows, NODES_PER_SEGMENT)

    def grow(self) -> None:
        """Make every arc an hour longer."""
        pad = torch.nn.functional.pad
        self.flown = pad(self.flown, (0, 0, 0, NODES_PER_SEGMENT))
        if self.planned.shape[1] <= self.kept * NODES_PER_SEGMENT:
            self.planned = pad(self.planned, (0, 0, NODES_PER_SEGMENT, 0))
        self.ephemeris = ephemeris_records(self.et + self.start, self.ephemeris.shape[1] + 1)
        self._lengthen(torch.arange(len(self.start), device=self.device), 0)

    def _lengthen(self, rows: Tensor, drop: int) -> None:
        """Solve another hour for ``rows``, whose first ``drop`` flown nodes go."""
        flown = self.flown[rows, drop : self.flown.shape[1] + drop - NODES_PER_SEGMENT]
        planned = self.planned[rows, NODES_PER_SEGMENT:]
        start, tail, ephemeris = self.start[rows], self.tail[rows], self.ephemeris[rows]
        flown, new, self.tail[rows] = self.solver.extend(self.et[rows], tail, start, ephemeris, flown)
        self.flown[rows], self.planned[rows] = flown, torch.cat([planned, new[:, 1::2]], 1)


def segments_for(seconds: float) -> int:
    """Return the number of hours of arc that cover ``seconds``, at least one."""
    return max(1, math.ceil(seconds / ARC_SEGMENT))
