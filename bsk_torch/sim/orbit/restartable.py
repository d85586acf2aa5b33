"""Arcs of satellites that maneuver: solved again from the time of a maneuver on, for the rows that thrust, an hour at first.

Each row has its own beginning, which need be no whole hour, and is solved as far as runs and queries need: the end of the tables
is room that may be empty yet.
"""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.interpolate import BEFORE, COUNT, coefficients
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.environment.ephemeris import ephemeris_records
from bsk_torch.sim.orbit.arcs import FARTHEST, PLANNED_SEGMENTS, Arcs, off_the_hour
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, LEAD_NODES, NODE_SPACING, NODES_PER_SEGMENT, RECORDS, SAMPLES_PER_SEGMENT
from bsk_torch.sim.orbit.solution import Solver
from bsk_torch.vec3 import Vec3


class RestartableArcs(Arcs):
    """Arcs of satellites that maneuver; see :class:`~bsk_torch.sim.orbit.arcs.Arcs`.

    ``epoch`` [N] is the time, s since reset, at which the current orbit began, and ``solved`` [N] the time of the last
    known node; later table entries are undefined.
    """

    epoch: Tensor
    solved: Tensor

    restarts = True

    @override
    def __init__(self, num_envs: int, spans: int, solver: Solver, kept: int = PLANNED_SEGMENTS, count: int = 1) -> None:
        super().__init__(num_envs, spans, solver, kept, count)
        self.declare("epoch", low=0.0, high=FARTHEST)
        self.declare("solved", low=0.0, high=FARTHEST)

    def check_relations(self, path: str) -> None:
        """See :meth:`StateTable.check_relations`: what is known ends within the tables, whole hours after the orbit began."""
        super().check_relations(path)
        wrong = (self.solved > self.start + self.length) | (self.solved < self.start) | (self.start < self.epoch)
        wrong = wrong | off_the_hour(self.solved - self.start)
        self.refuse(f"{path}solved", self.solved, wrong, "it must lie within the arc, whole hours after its start")

    @property
    def end(self) -> Tensor:
        """Time of the last known node, [N]."""
        return self.solved

    @property
    def begun(self) -> Tensor:
        """Time at which the current orbit began, [N] s."""
        return self.epoch

    @property
    def room(self) -> Tensor:
        """Hours that can be solved before an arc has to move on, [N]."""
        return torch.round((self.start + self.length - self.solved) / ARC_SEGMENT)

    @override
    def solve(self, rows: Tensor, et: Tensor, r: Tensor, v: Tensor) -> Tensor:
        planned = super().solve(rows, et, r, v)
        self.epoch[rows], self.solved[rows] = 0.0, self.length
        return planned

    def copy_from(self, other: Arcs, rows: Tensor) -> None:
        """Take over the arcs of ``rows`` [n] that have just been solved from time zero on, in tables of the same length."""
        for name in other:
            self[name][rows] = other[name][rows]
        self.epoch[rows], self.solved[rows] = 0.0, self.length

    def restart(self, rows: Tensor, time: Tensor, r: Tensor, v: Tensor) -> None:
        """Let new orbits of ``rows`` [n] begin at ``time`` [n] s, with positions, m, and velocities, m/s, in N, [n, 3].

        The first hour is solved. A backward continuation of the new orbit stands before its beginning.
        """
        et = self.et[rows] + time
        ephemeris = ephemeris_records(self.et[rows], self.ephemeris.shape[1], time, self.solver.earth)
        flown, planned, tail = self.solver.begin(et, r, v, ephemeris[:, :RECORDS].contiguous(), NODES_PER_SEGMENT + 1)
        self._check_finite(rows, planned, flown)
        self.epoch[rows], self.start[rows], self.solved[rows] = time, time, time + ARC_SEGMENT
        self.ephemeris[rows], self.tail[rows] = ephemeris, tail
        self.flown[rows, : flown.shape[1]] = flown
        self.planned[rows, self.planned.shape[1] - planned.shape[1] :] = planned

    def extend(self, rows: Tensor) -> None:
        """Solve the next hour of ``rows``; those whose tables are full drop an hour at their beginning."""
        full = rows[self.room[rows] < 0.5]
        if len(full):
            self.flown[full, :-NODES_PER_SEGMENT] = self.flown[full, NODES_PER_SEGMENT:]
            self.start[full] += ARC_SEGMENT
            self.ephemeris[full] = ephemeris_records(self.et[full], self.ephemeris.shape[1], self.start[full], self.solver.earth)
        hours = torch.round((self.solved[rows] - self.start[rows]) / ARC_SEGMENT).long().unsqueeze(-1)
        count = torch.arange(LEAD_NODES + 1 + NODES_PER_SEGMENT, device=self.device)
        column = hours * NODES_PER_SEGMENT + count
        records = hours + torch.arange(RECORDS, device=self.device)
        row, epoch = rows.unsqueeze(-1), self.epoch[rows]
        flown, planned, tail = self._solved(
            rows,
            self.et[rows] + epoch,
            self.tail[rows],
            torch.round((self.solved[rows] - epoch) / ARC_SEGMENT) * ARC_SEGMENT,
            self.ephemeris[row, records],
            self.flown[row, column[:, : LEAD_NODES + 1]],
        )
        self.flown[row, column[:, LEAD_NODES + 1 :]] = flown[:, LEAD_NODES + 1 :]
        self.planned[rows] = torch.cat([self.planned[rows, SAMPLES_PER_SEGMENT:], planned], 1)
        self.tail[rows] = tail
        self.solved[rows] += ARC_SEGMENT

    def grow(self) -> None:
        """Make room for an hour more in every arc; nothing is solved."""
        ephemeris = ephemeris_records(self.et, self.ephemeris.shape[1] + 1, self.start, self.solver.earth)
        flown = torch.cat([self.flown, self.flown[:, -1:].expand(-1, NODES_PER_SEGMENT, -1)], 1)
        self.__dict__.update(ephemeris=ephemeris, flown=flown)
        self.keep(self.planned.shape[1] + SAMPLES_PER_SEGMENT)  # the last sample is that of the end

    def state_at(self, rows: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
        """Return flown position, m, and velocity, m/s, in N, [n, 3], of ``rows`` [n] at ``time`` [n] s.

        Better than the derivative of the polynomial through positions, which is good to 5e-8 m/s, that is millimeters after some
        orbits: the accelerations a_j at the nodes around are integrated. With the node k before, steps of h and
        ``a(s) = sum_n c_n s^n`` through them::

            r_(k+1) = r_k + h v_k + h^2 sum_n c_n / ((n + 1) (n + 2))
            v(s) = v_k + h sum_n c_n s^(n+1) / (n + 1)
            r(s) = r_k + h v_k s + h^2 sum_n c_n s^(n+2) / ((n + 1) (n + 2))
        """
        lead = self.start[rows] - LEAD_NODES * NODE_SPACING
        last = torch.round((self.solved[rows] - lead) / NODE_SPACING)
        first = (torch.floor((time - lead) / NODE_SPACING) - BEFORE).clamp(min=0.0)
        first = torch.minimum(first, last - (COUNT - 1))
        around = torch.arange(COUNT, device=self.device)
        nodes = self.flown[rows.unsqueeze(-1), first.long().unsqueeze(-1) + around]
        times = (lead + first * NODE_SPACING).unsqueeze(-1) + NODE_SPACING * around.to(time.dtype)
        a = self.solver.accelerations(nodes, Samples(self.ephemeris[rows], self.start[rows] - times[:, 0]))
        c = coefficients([Vec3.of(node) for node in a.unbind(1)])
        s = (time - times[:, BEFORE]) / NODE_SPACING
        h = NODE_SPACING
        once = [term * (1.0 / (n + 1)) for n, term in enumerate(c)]
        twice = [term * (1.0 / (n + 2)) for n, term in enumerate(once)]
        r_k, r_next = (Vec3.of(nodes[:, BEFORE + k]) for k in (0, 1))
        step = (r_next - r_k) - _sum(twice) * (h * h)
        v = step * (1.0 / h) + _horner(once, s) * s * h
        r = r_k + step * s + _horner(twice, s) * (s * s) * (h * h)
        return r.stack(), v.stack()


def _sum(terms: list[Vec3]) -> Vec3:
    total = terms[-1]
    for term in terms[-2::-1]:
        total = total + term
    return total


def _horner(terms: list[Vec3], s: Tensor) -> Vec3:
    total = terms[-1]
    for term in terms[-2::-1]:
        total = term + total * s
    return total
