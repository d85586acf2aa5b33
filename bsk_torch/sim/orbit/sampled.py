"""Arcs of SGP4's positions, in place of integrated ones: for satellites that must be where other tools put them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.earth_rotation import teme_axes
from bsk_torch.astro.element_sets import ElementSet
from bsk_torch.sim.environment.ephemeris import ephemeris_records
from bsk_torch.sim.orbit.arcs import PLANNED_SEGMENTS, Arcs
from bsk_torch.sim.orbit.grid import (
    ARC_SEGMENT,
    LEAD_NODES,
    NODE_SPACING,
    NODES_PER_SEGMENT,
    PLAN_STEP,
    SAMPLES_PER_SEGMENT,
)
from bsk_torch.sim.orbit.solution import Solution, Solver


class SampledArcs(Arcs):
    """Arcs sampled from element sets, one for each of the ``count`` satellites; see :class:`~bsk_torch.sim.orbit.arcs.Arcs`.

    Flown and planned arcs are the same path.
    """

    def __init__(
        self,
        num_envs: int,
        spans: int,
        solver: Solver,
        kept: int = PLANNED_SEGMENTS,
        count: int = 1,
        *,
        elements: Sequence[ElementSet],
    ) -> None:
        super().__init__(num_envs, spans, solver, kept, count)
        self.elements = tuple(elements)

    @override
    def solve(self, rows: Tensor, et: Tensor, r: Tensor, v: Tensor) -> Tensor:
        spans = (self.flown.shape[1] - LEAD_NODES - 1) // NODES_PER_SEGMENT
        start = torch.zeros_like(et)
        self.start[rows], self.et[rows], self.tail[rows] = start, et, 0.0
        self.ephemeris[rows] = ephemeris_records(et, self.ephemeris.shape[1], earth=self.solver.earth)
        path = self._path(rows, et, start, -2 * LEAD_NODES, 2 * spans * NODES_PER_SEGMENT + 1)
        planned = path[:, 2 * LEAD_NODES :].contiguous()
        self.flown[rows], self.planned[rows] = path[:, ::2], planned[:, -self.planned.shape[1] :]
        return planned

    @override
    def _solved(self, rows: Tensor, *known: Tensor) -> Solution:
        et, tail, start, _, kept = known
        end = start + (kept.shape[1] - 1 - LEAD_NODES) * NODE_SPACING
        planned = self._path(rows, et, end, 1, SAMPLES_PER_SEGMENT + 1)
        return Solution(torch.cat([kept, planned[:, 1::2]], 1), planned, tail)

    def _path(self, rows: Tensor, et: Tensor, start: Tensor, first: int, last: int) -> Tensor:
        """Return positions in N, [n, last - first, 3] m, every 30 s, numbered from ``start`` [n] s after ET [n], s, on.

        TEME turns by 1e-8 rad in an hour, so its axes are interpolated between whole hours.
        """
        steps = torch.arange(first, last, dtype=torch.float64, device=self.device) * PLAN_STEP
        found = self.flown.new_empty(len(rows), len(steps), 3)
        for k, elements in enumerate(self.elements):
            mine = torch.nonzero(rows % self.count == k).squeeze(-1)
            begin, row = torch.unique(et[mine] + start[mine], return_inverse=True)
            if not len(begin):
                continue
            elements.check_age(begin)
            r_T = elements.teme_states((begin.unsqueeze(-1) + steps).flatten())[0].view(len(begin), len(steps), 3)
            hour = torch.floor(steps / ARC_SEGMENT)
            knots = torch.arange(float(hour[0]), float(hour[-1]) + 2.0, dtype=torch.float64, device=self.device)
            NT = teme_axes(begin.unsqueeze(-1) + ARC_SEGMENT * knots).mT
            at, share = (hour - hour[0]).long(), (steps / ARC_SEGMENT - hour)[:, None, None]
            axes = NT[:, at] * (1.0 - share) + NT[:, at + 1] * share
            found[mine] = (axes @ r_T.unsqueeze(-1)).squeeze(-1)[row]
        return found


def with_elements(
    sat_args: Mapping[str, object] | Sequence[Mapping[str, object]], count: int
) -> tuple[list[dict[str, object]], tuple[ElementSet, ...]]:
    """Return the arguments of ``count`` satellites that start with SGP4's own velocities, and their element sets.

    ValueError unless each satellite has one element set.
    """
    each = [sat_args] * count if isinstance(sat_args, Mapping) else sat_args
    plain = []
    for arguments in each:
        orbit = arguments.get("oe")
        if not isinstance(orbit, ElementSet):
            raise ValueError(
                f"orbit='sgp4' flies element sets, but sat_args has oe={orbit}; use from_tle, or leave out orbit= to integrate"
            )
        plain.append(dataclasses.replace(orbit, matched=False))
    return [{**arguments, "oe": orbit} for arguments, orbit in zip(each, plain, strict=True)], tuple(plain)
