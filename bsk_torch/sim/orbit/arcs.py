"""Arcs: positions of satellites, computed ahead of the simulation in batched passes.

Above the modeled atmosphere an orbit does not depend on actions until the next maneuver, so it is solved in advance, and a
polynomial through positions a minute apart serves every tick. Of satellites that maneuver it is solved again from there on; see
:mod:`bsk_torch.sim.orbit.restartable`.

Two arcs are kept for each satellite. The *flown* arc is the one that Basilisk integrates at the simulation's rate. The *planned*
arc is that of BSK-RL's look-ahead, a Runge-Kutta propagation in steps of 30 s; its truncation error, meters per orbit, is
reproduced by adding the error of one such step to the equations of motion. Of the planned arc only the end is kept, which is
what look-ahead still has to search: arcs that grow keep what they have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import BEFORE, COUNT, coefficients, position, velocity
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.component import Bus, Track
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_records
from bsk_torch.sim.orbit.builder import ARC
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, LEAD_NODES, NODE_SPACING, NODES_PER_SEGMENT, PLAN_STEP, SAMPLES_PER_SEGMENT
from bsk_torch.sim.orbit.solution import Solution, Solver
from bsk_torch.sim.state import StateTable

PLANNED_SEGMENTS = 5  # number of stored hours of a planned arc that has not grown


def follow_arc(bus: Bus) -> None:
    """Interpolate position and velocity at the end of the tick: ``r_BN_N = p(s)`` and ``v_BN_N = p'(s) / NODE_SPACING``.

    ``p`` is the polynomial through neighboring nodes of the arc, m in N, and ``s`` the time since the last one in units of their
    spacing; see :mod:`bsk_torch.astro.interpolate`.
    """
    path, s = coefficients([node.r_BN_N for node in bus.arc]), bus.arc_tau * (1.0 / NODE_SPACING)
    bus.r_BN_N, bus.v_BN_N = position(path, s), velocity(path, s, NODE_SPACING)


REACH_AROUND = (COUNT - BEFORE) * NODE_SPACING
"""Seconds behind a time that arcs must cover so that the interpolation at that time is not one-sided."""

FARTHEST = 1e13  # largest number, in m, m/s or s, that arcs may hold; the Sun is 1.5e11 m away


class Arcs(StateTable):
    """Flown and planned arcs of satellites: ``spans`` hours of nodes for each, starting at its own time.

    ``flown`` [N, Q, 3] are positions in N, m, and ``ephemeris`` [N, H, 16] the records of Sun and Earth, from ``start`` [N] s on,
    positions from :data:`LEAD_NODES` nodes before; ``planned`` [N, P, 3] are the last planned ones, every 30 s;
    ``tail`` [N, T] is the state of the solver at the end of the arcs, and ``et`` [N] is ET at time zero, s.
    """

    flown: Tensor
    planned: Tensor
    ephemeris: Tensor
    tail: Tensor
    start: Tensor
    et: Tensor

    restarts = False
    """Whether arcs may restart in mid-episode; see :class:`bsk_torch.sim.orbit.restartable.RestartableArcs`."""

    def __init__(self, num_envs: int, spans: int, solver: Solver, kept: int = PLANNED_SEGMENTS, count: int = 1) -> None:
        """Make room for ``count`` satellites in each of ``num_envs`` episodes; planned arcs keep their last ``kept`` hours."""
        super().__init__(num_envs, count, solver.device)
        self.solver, self.kept = solver, kept
        self.declare("flown", None, LEAD_NODES + spans * NODES_PER_SEGMENT + 1, 3, grows=True, low=-FARTHEST, high=FARTHEST)
        self.declare("planned", None, min(spans, kept) * SAMPLES_PER_SEGMENT + 1, 3, grows=True, low=-FARTHEST, high=FARTHEST)
        self.declare("ephemeris", None, spans + 2, EPHEMERIS_TRACK.width, grows=True, low=-FARTHEST, high=FARTHEST)
        self.declare("tail", None, solver.tail, low=-FARTHEST, high=FARTHEST)
        self.declare("start", low=0.0, high=FARTHEST)
        self.declare("et")

    def check_relations(self, path: str) -> None:
        """See :meth:`StateTable.check_relations`: tables of equally many hours, which begin at a whole hour."""
        spans = (self.flown.shape[1] - LEAD_NODES - 1) // NODES_PER_SEGMENT
        planned = min(max((self.planned.shape[1] - 1) // SAMPLES_PER_SEGMENT, self.kept), spans)  # those that grow keep more
        widths = {
            "flown": LEAD_NODES + spans * NODES_PER_SEGMENT + 1,
            "planned": planned * SAMPLES_PER_SEGMENT + 1,
            "ephemeris": spans + 2,
        }
        for name, width in widths.items():
            if spans < 1 or self[name].shape[1] != width:
                raise ValueError(
                    f"'{path}{name}' of the saved state has {self[name].shape[1]} columns, where those of 'flown' are "
                    f"{self.flown.shape[1]}; arcs of {spans} hours have {width}"
                )
        off = off_the_hour(self.start - self.begun)
        self.refuse(f"{path}start", self.start, off, f"it must be a multiple of {ARC_SEGMENT:g} s after the orbit began")

    @property
    def length(self) -> float:
        """Seconds that every flown arc covers."""
        return (self.flown.shape[1] - 1 - LEAD_NODES) * NODE_SPACING

    @property
    def end(self) -> Tensor:
        """Time of the last node, [N]."""
        return self.start + self.length

    @property
    def begun(self) -> Tensor | float:
        """Time at which the current orbit began, [N] s or a number: zero, or that of the last maneuver."""
        return 0.0

    @property
    def room(self) -> Tensor | float:
        """Hours that can be solved before an arc has to move on, [N] or a number."""
        return 0.0

    @property
    def planned_samples(self) -> Samples:
        """The planned arc as a track, half a step early: rounding of a sample's time does not lead to the sample before."""
        return Samples(self.planned, self.planned_from - 0.5 * PLAN_STEP)

    @property
    def planned_from(self) -> Tensor:
        """Time of the first stored planned sample, [N]."""
        return self.end - (self.planned.shape[1] - 1) * PLAN_STEP

    @property
    def ephemeris_samples(self) -> Samples:
        """Sun and Earth as a track."""
        return Samples(self.ephemeris, self.start)

    def tracks(self, tracks: Sequence[Track]) -> tuple[Samples, ...]:
        """Return the samples of the tracks of a tick."""
        flown = Samples(self.flown, self.start - LEAD_NODES * NODE_SPACING)
        samples = {EPHEMERIS_TRACK.name: Samples(self.ephemeris, self.start), ARC.name: flown}
        return tuple([samples[track.name] for track in tracks])

    def solve(self, rows: Tensor, et: Tensor, r: Tensor, v: Tensor) -> Tensor:
        """Solve the arcs of ``rows`` [n] again from ET [n] and position and velocity [n, 3] at time zero.

        Return samples [n, 2 Q - 1, 3] of the whole planned arcs, every 30 s from time zero on, of which ``planned`` keeps the
        last.
        """
        self.start[rows], self.et[rows] = 0.0, et
        ephemeris = ephemeris_records(et, self.ephemeris.shape[1], earth=self.solver.earth)
        flown, planned, tail = self.solver.begin(et, r, v, ephemeris, self.flown.shape[1] - LEAD_NODES)
        self.ephemeris[rows], self.flown[rows], self.tail[rows] = ephemeris, flown, tail
        self.planned[rows] = planned[:, -self.planned.shape[1] :]
        return planned

    def extend(self, rows: Tensor) -> None:
        """Move the arcs of ``rows`` on by an hour, dropping one at their beginning."""
        start = self.start[rows] + ARC_SEGMENT
        ephemeris = ephemeris_records(self.et[rows], self.ephemeris.shape[1], start, self.solver.earth)
        kept, planned = self.flown[rows, NODES_PER_SEGMENT:], self.planned[rows, SAMPLES_PER_SEGMENT:]
        flown, new, tail = self._solved(rows, self.et[rows], self.tail[rows], start, ephemeris, kept)
        self.start[rows], self.ephemeris[rows], self.tail[rows] = start, ephemeris, tail
        self.flown[rows], self.planned[rows] = flown, torch.cat([planned, new], 1)

    def _solved(self, rows: Tensor, *state: Tensor) -> Solution:
        """Solve the next hour of ``rows`` [n]; FloatingPointError if positions are not finite."""
        solution = self.solver.extend(*state)
        self._check_finite(rows, solution.planned, solution.flown)
        return solution

    def _check_finite(self, rows: Tensor, planned: Tensor, flown: Tensor) -> None:
        wrong = ~torch.isfinite(planned).flatten(1).all(1) | ~torch.isfinite(flown[:, -1]).all(1)
        wrong = wrong & (self.et[rows] != 0.0)  # where no episode has begun, there is no orbit yet
        if bool(wrong.any()):
            envs = (rows[wrong] // self.count).unique().tolist()
            raise FloatingPointError(
                f"the orbits of environments {envs[:5]} ({len(envs)} in all) do not stay finite in the next hour"
            )

    def grow(self) -> None:
        """Make every arc an hour longer; nothing changes if that fails."""
        ephemeris = ephemeris_records(self.et, self.ephemeris.shape[1] + 1, self.start, self.solver.earth)
        flown, new, tail = self._solved(self.all_rows, self.et, self.tail, self.start, ephemeris, self.flown)
        self.__dict__.update(ephemeris=ephemeris, flown=flown, planned=torch.cat([self.planned, new], 1), tail=tail)

    def keep(self, samples: int) -> None:
        """Make room for so many planned samples; what lies before those of an arc that kept fewer has been searched."""
        missing = samples - self.planned.shape[1]
        if missing > 0:
            self.__dict__["planned"] = torch.nn.functional.pad(self.planned, (0, 0, missing, 0))


def off_the_hour(seconds: Tensor) -> Tensor:
    """Return whether times, s, are no whole hours, but for rounding."""
    hours = seconds / ARC_SEGMENT
    return ~((hours - torch.round(hours)).abs() < 1e-9)


def segments_for(seconds: float) -> int:
    """Return the number of hours of arc that cover ``seconds``, at least one."""
    return max(1, math.ceil(seconds / ARC_SEGMENT))
