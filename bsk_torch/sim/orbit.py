"""Where the satellite will be: arcs computed ahead of the simulation, in batched passes.

Without manoeuvres and above the felt atmosphere an orbit depends on nothing that the agent does, so it is solved in advance:
Picard iteration on Chebyshev nodes evaluates an hour at a time, and a quintic between nodes a minute apart serves every tick.

Two arcs are kept for each satellite. The *flown* arc is the one that Basilisk integrates at the simulation's rate. The *planned*
arc is the one that bsk_rl looks ahead on, a Runge-Kutta propagation in steps of 30 s; its truncation error, metres per orbit, is
reproduced by adding the error of one such step to the equations of motion.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import Node, quintic_position, quintic_velocity
from bsk_torch.sim.span import PER_SPAN, SPACING, SPAN, Solver, first_node
from bsk_torch.vec3 import Vec3


class Arcs:
    """Flown and planned arcs of N satellites: ``spans`` hours of nodes for each, starting at its own time.

    ``flown`` and ``planned`` are [N, Q, 9]; ``start`` [N] is the time, s, of the first node.
    """

    def __init__(self, n: int, spans: int, solver: Solver) -> None:
        """Make room for ``n`` satellites."""
        self.solver, self.device = solver, solver.device
        device = solver.device
        shape = (n, spans * PER_SPAN + 1, 9)
        self.flown = torch.zeros(shape, dtype=torch.float64, device=device)
        self.planned = torch.zeros_like(self.flown)
        self.start = torch.zeros(n, dtype=torch.float64, device=device)
        self.et = torch.zeros_like(self.start)

    @property
    def length(self) -> float:
        """Seconds that every arc covers."""
        return (self.flown.shape[1] - 1) * SPACING

    @property
    def end(self) -> Tensor:
        """Time of the last node, [N]."""
        return self.start + self.length

    def reset(self, rows: Tensor, et: Tensor, r: Tensor, v: Tensor) -> None:
        """Solve the arcs of ``rows`` [n] anew from ET [n] and position and velocity [n, 3] at time zero."""
        self.start[rows], self.et[rows] = 0.0, et
        node = first_node(et, r, v)
        parts = [[node.unsqueeze(1)], [node.unsqueeze(1)]]
        for k in range(round(self.length / SPAN)):
            for part, new in zip(parts, self.solver.solve(et + k * SPAN, *(p[-1][:, -1] for p in parts)), strict=True):
                part.append(new)
        self.flown[rows], self.planned[rows] = (torch.cat(part, 1) for part in parts)

    def adopt(self, rows: Tensor, other: Arcs) -> None:
        """Take over the arcs of ``rows`` from others of the same length."""
        self.flown[rows], self.planned[rows] = other.flown[rows], other.planned[rows]
        self.start[rows], self.et[rows] = other.start[rows], other.et[rows]

    def extend(self, rows: Tensor, spans: int) -> None:
        """Move the arcs of ``rows`` on by ``spans`` hours, dropping as many at their beginning."""
        for _ in range(spans):
            arcs = self.flown[rows], self.planned[rows]
            new = self.solver.solve(self.et[rows] + self.end[rows], arcs[0][:, -1], arcs[1][:, -1])
            self.flown[rows], self.planned[rows] = (
                torch.cat([arc[:, PER_SPAN:], nodes], 1) for arc, nodes in zip(arcs, new, strict=True)
            )
            self.start[rows] += SPAN

    def grow(self) -> None:
        """Make every arc an hour longer."""
        new = self.solver.solve(self.et + self.end, self.flown[:, -1], self.planned[:, -1])
        self.flown, self.planned = (
            torch.cat([arc, nodes], 1) for arc, nodes in zip((self.flown, self.planned), new, strict=True)
        )

    def nodes(self, rows: Tensor, time: Tensor, count: int) -> tuple[Tensor, Tensor]:
        """``count`` consecutive flown nodes [n, count, 9] around time [n] of ``rows``, and the time of the first, [n]."""
        index = torch.floor((time - self.start[rows]) / SPACING).long()
        index = index.clamp(0, self.flown.shape[1] - count)
        steps = torch.arange(count, device=self.device)
        return self.flown[rows.unsqueeze(-1), index.unsqueeze(-1) + steps], self.start[rows] + index * SPACING

    def planned_position(self, rows: Tensor, time: Tensor) -> Vec3:
        """Planned position in N at time [m] of ``rows`` [m]."""
        index = torch.floor((time - self.start[rows]) / SPACING).long().clamp(0, self.planned.shape[1] - 2)
        first, second = (as_node(self.planned[rows, index + k]) for k in (0, 1))
        return quintic_position((time - self.start[rows]) / SPACING - index, SPACING, first, second)


def as_node(values: Tensor) -> Node:
    """Node of values [..., 9]."""
    return Node(*(Vec3.of(values[..., k : k + 3]) for k in (0, 3, 6)))


def position_on_arc(nodes: tuple[Tensor, ...], first: Tensor, tau: Tensor) -> tuple[Vec3, Vec3]:
    """Position and velocity at tau from three nodes (27 planes) the first of which lies at ``first`` (same clock, s)."""
    s = (tau - first) * (1.0 / SPACING)
    later = s >= 1.0
    planes = [torch.where(later, b, a) for a, b in zip(nodes[:18], nodes[9:], strict=True)]
    s = torch.where(later, s - 1.0, s)
    start, end = (Node(*(Vec3(*planes[k + i : k + i + 3]) for i in (0, 3, 6))) for k in (0, 9))
    return quintic_position(s, SPACING, start, end), quintic_velocity(s, SPACING, start, end)


def spans_for(seconds: float) -> int:
    """Hours of arc that cover ``seconds``."""
    return max(1, math.ceil(seconds / SPAN))
