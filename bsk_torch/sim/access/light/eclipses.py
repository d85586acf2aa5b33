"""Times at which the next eclipse starts and ends, and what a look-ahead on samples gives for them."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from bsk_torch.astro.roots import find_root
from bsk_torch.codegen.build import entry, load
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.access.visibility.interface import Visibility
from bsk_torch.sim.access.visibility.planned import PlannedOrbits
from bsk_torch.sim.access.windows.next_windows import check_times
from bsk_torch.sim.access.windows.padded import tabulate
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, PLAN_STEP, SAMPLES_PER_SEGMENT
from bsk_torch.sim.state import StateTable

SHORTEST_SEARCH, LONGEST_SEARCH, REVOLUTIONS = 12_000.0, 172_800.0, 1.1
"""A search looks ahead for more than a revolution, as the Sun and the node move meanwhile; these are its bounds, s."""

ITERATIONS = 8  # iterations of regula falsi that find a transition between two samples, to a microsecond

INSIDE = 1e-6
"""Distance, in steps of the grid, that transitions keep from its samples, so that rounding does not put them before or behind."""

SEARCH_STEP, SEARCHES = 6000.0, 3
"""Searches go up to 0, 6000 and 12000 s after the query; what the third one finds is ignored."""

ROUNDING = 1e-9  # error of times by rounding, in steps of the grid
NOT_FOUND = 1.0  # the answer to a query whose searches all fail: one second after the epoch

CONSTANTS = torch.tensor([PLAN_STEP, SEARCH_STEP, SEARCHES, ROUNDING, NOT_FOUND], dtype=torch.float64)
"""The struct ``Constants`` of the kernel of such queries."""


@cache
def next_eclipses_kernel() -> Callable[..., None]:
    """Return the kernel of queries on samples, built or loaded when it is first needed."""
    source = Path(__file__).with_name("next_eclipses.cpp").read_text()
    return entry(load(source, "search for the next eclipses"), "ip" + "pipi" + "ppp" + "pp" + "ppp")


def search_range(r_N: Tensor, v_N: Tensor) -> Tensor:
    """Return how far queries look ahead on orbits through positions, [n, 3] m, with velocities, [n, 3] m/s: [n] s."""
    per_a = (2.0 / r_N.norm(dim=-1) - (v_N * v_N).sum(-1) / MU_EARTH).clamp(min=1e-12)
    period = 2.0 * math.pi / torch.sqrt(MU_EARTH * per_a**3)
    return (REVOLUTIONS * period).clamp(SHORTEST_SEARCH, LONGEST_SEARCH)


class EclipseTable(StateTable):
    """Transitions into and out of the umbra on the planned arcs; an eclipse between two samples 30 s apart has none.

    Transitions on samples are those behind these. Samples are propagated only as far as queries need, and answers depend on how
    far that is. So the table also keeps the progress of that propagation.
    """

    searched: Tensor
    ahead: Tensor  # how far queries look ahead, [N] s; see search_range
    sampled: Tensor  # time up to which samples have been propagated, [N] s
    known: Tensor  # time up to which their transitions have been recorded, [N] s
    starts: Tensor  # times of transitions into the umbra, [N, W] s since reset, padded with infinity
    ends: Tensor  # times of transitions out of it, likewise

    def __init__(self, arcs: Arcs, visibility: Visibility) -> None:
        super().__init__(arcs.num_envs, arcs.count, arcs.device)
        self.arcs, self.visibility = arcs, visibility
        self.__dict__["searched"] = SEARCH_STEP * torch.arange(SEARCHES, dtype=torch.float64, device=arcs.device).unsqueeze(-1)
        self.declare("ahead", SHORTEST_SEARCH, low=SHORTEST_SEARCH, high=LONGEST_SEARCH)
        self.declare("sampled", 0.0, low=0.0)
        self.declare("known", 0.0, low=0.0)
        self.declare("starts", math.inf, 1, grows=True, low=0.0)
        self.declare("ends", math.inf, 1, grows=True, low=0.0)

    def search(self, rows: Tensor, orbits: PlannedOrbits, ahead: Tensor, duration: Tensor) -> None:
        """Find the transitions of new planned arcs of ``rows`` [n]; queries look ``ahead`` [n] s.

        ``duration`` [n] are the seconds for which windows have been generated.
        """
        self.ahead[rows], self.sampled[rows], self.known[rows] = ahead, duration, 0.0
        starts, ends = self._transitions(orbits, torch.zeros_like(duration), round(self.arcs.length / PLAN_STEP))
        self.write_rows("starts", rows, starts)
        self.write_rows("ends", rows, ends)

    def lengthen(self, rows: Tensor) -> None:
        """Add the transitions in the last hour of the arcs of ``rows``; drop those before the begin of the arcs."""
        orbits = PlannedOrbits(self.arcs.planned_samples, self.arcs.ephemeris_samples).take(rows)
        starts, ends = self._transitions(orbits, self.arcs.end[rows] - ARC_SEGMENT, round(ARC_SEGMENT / PLAN_STEP))
        self._append("starts", rows, starts)
        self._append("ends", rows, ends)

    def _append(self, name: str, rows: Tensor, new: Tensor) -> None:
        old = self[name][rows]
        present = torch.where(old < self.arcs.start[rows].unsqueeze(-1), torch.inf, old)
        both = torch.cat([present, new], 1).sort(1).values
        width = max(1, int(torch.isfinite(both).sum(1).max()))
        self.write_rows(name, rows, both[:, :width])

    def _transitions(self, orbits: PlannedOrbits, start: Tensor, steps: int) -> tuple[Tensor, Tensor]:
        """Return the times of transitions into and out of the umbra after ``start`` [n] s, within whole hours, [n, W] each."""
        depth = self.visibility.umbra(orbits, start, steps + 1)
        dark = depth > 0.0
        row, sample = torch.nonzero(dark[:, 1:] != dark[:, :-1], as_tuple=True)
        time = start[row] + PLAN_STEP * (sample.to(start.dtype) + _crossing(depth, row, sample))
        enters = dark[row, sample + 1]
        starts, ends = (tabulate(row[chosen], time[chosen], len(start))[0] for chosen in (enters, ~enters))
        return starts, ends

    def restart(self, rows: Tensor, ahead: Tensor) -> None:
        """Forget the transitions of ``rows`` [n], whose arcs have just restarted, and find those in their first hour.

        Queries look ahead for ``ahead`` [n] s from now on.
        """
        begun = self.arcs.start[rows]
        self.ahead[rows], self.sampled[rows], self.known[rows] = ahead, begun, begun
        orbits = PlannedOrbits(self.arcs.planned_samples, self.arcs.ephemeris_samples).take(rows)
        starts, ends = self._transitions(orbits, begun, round(ARC_SEGMENT / PLAN_STEP))
        self.write_rows("starts", rows, starts)
        self.write_rows("ends", rows, ends)

    def missing(self, time: Tensor, start: Tensor, end: Tensor) -> Tensor:
        """Return whether what :meth:`next` has answered, [N] s each, may lie beyond the end of the arcs, [N]."""
        limit = time + self.ahead
        return (torch.maximum(start, end) >= limit) & (self.arcs.end < limit)

    def next(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Return the next start and the next end of an eclipse after ``time`` [N] s, [N] s each.

        Within an eclipse, the end is that of the present one and the start that of the following one. Neither is later than
        ``ahead`` seconds from ``time``, which stands for "not within that time", too.
        """
        now, limit = time.unsqueeze(-1), time + self.ahead
        start, end = (torch.where(table > now, table, torch.inf).amin(1) for table in (self.starts, self.ends))
        return torch.minimum(start, limit), torch.minimum(end, limit)

    def sample_to(self, time: Tensor) -> None:
        """Note that samples have been propagated to ``time`` [N] s, but for orbits that have restarted."""
        later, begun = torch.maximum(self.sampled, time), self.arcs.begun
        self.sampled = torch.where(begun > 0.0, self.sampled, later) if isinstance(begun, Tensor) else later

    def _next(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Return the samples behind the next start and the next end, [N] s each, after that at or before ``time`` [N] s."""
        if self.arcs.restarts:
            begun, slack = self.arcs.begun, ROUNDING
            soonest = (torch.floor((time - begun) * (1.0 / PLAN_STEP) + slack) + 1.0 - slack) * PLAN_STEP + begun
        else:
            soonest = (torch.floor(time * (1.0 / PLAN_STEP)) + 1.0) * PLAN_STEP
        soonest = soonest.unsqueeze(-1)
        begun = self.arcs.begun.unsqueeze(-1) if isinstance(self.arcs.begun, Tensor) else 0.0
        tables = (torch.ceil((table - begun) / PLAN_STEP) * PLAN_STEP + begun for table in (self.starts, self.ends))
        start, end = (torch.where(table >= soonest, table, torch.inf).amin(1) for table in tables)
        return start, end

    def needs(self, time: Tensor) -> Tensor:
        """Return the time, [N] s, which the arcs must reach for a query at ``time`` [N] s."""
        return torch.maximum(time + SEARCH_STEP * (SEARCHES - 1), self.known) + 2 * PLAN_STEP

    def unknown(self, time: Tensor) -> Tensor:
        """Return whether the next start or the next end after ``time`` [N] s lies beyond what has been searched, [N]."""
        start, end = self._next(time)
        return torch.isinf(start) | torch.isinf(end)

    def query_if_covered(self, time: Tensor) -> tuple[Tensor, Tensor] | None:
        """Return what :meth:`query` does; None, and note nothing, if the arcs do not reach as far as the query needs."""
        if self.visibility.kernels:
            return self._by_kernel(time, self.arcs.end)
        return self.query(time) if bool((self.needs(time) <= self.arcs.end).all()) else None

    def _by_kernel(self, time: Tensor, reached: Tensor | None) -> tuple[Tensor, Tensor] | None:
        """Return what :meth:`query` does, bit for bit; None if arcs that go to ``reached`` [N] s are too short.

        TypeError for times that are not float64, or of another shape: kernels read addresses.
        """
        begun = self.arcs.begun if isinstance(self.arcs.begun, Tensor) else None
        times = {"time": time, "begun": begun, "reached": reached, "sampled": self.sampled, "known": self.known}
        check_times(self.starts.shape[:1], times)
        start, end = time.new_empty(2, len(time)).unbind(0)
        late = ctypes.c_int64()
        next_eclipses_kernel()(
            len(time), CONSTANTS,
            self.starts.contiguous(), self.starts.shape[1], self.ends.contiguous(), self.ends.shape[1],
            time.contiguous(), None if begun is None else begun.contiguous(), None if reached is None else reached.contiguous(),
            self.sampled, self.known,
            start, end, ctypes.addressof(late),
        )  # fmt: skip
        return None if late.value else (start, end)

    def query(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Return the answer on samples to a query after ``time`` [N] s: times of samples, [N] s each."""
        if self.visibility.kernels:
            answer = self._by_kernel(time, None)
            assert answer is not None
            return answer
        start, end = self._next(time)
        last = torch.maximum(start, end) + PLAN_STEP
        # each search propagates the trajectory, in whole steps, and records transitions up to there
        begun = self.arcs.begun
        elapsed = time - begun + self.searched
        reach = torch.floor((elapsed + PLAN_STEP) / PLAN_STEP + ROUNDING) * PLAN_STEP + begun
        after = torch.maximum(self.sampled, reach)
        early, late = (last <= after[:-1]).unbind(0)  # found by the first search, by the first two; the third does not count
        first, second, third = after.unbind(0)
        searched = torch.where(early, first, torch.where(late, second, third))
        known = last <= self.known
        self.sampled, self.known = torch.where(known, self.sampled, searched), torch.where(known, self.known, searched)
        within_reach = known | early | late
        return torch.where(within_reach, start, NOT_FOUND), torch.where(within_reach, end, NOT_FOUND)


def _crossing(depth: Tensor, row: Tensor, sample: Tensor) -> Tensor:
    """Return where the depth of rows [m] is zero between two samples, as a fraction of the step behind the first, [m].

    The cubic polynomial through four samples of the same hour is used, so that it does not matter how many hours are searched.
    """
    hour = sample // SAMPLES_PER_SEGMENT * SAMPLES_PER_SEGMENT
    first = torch.minimum(torch.maximum(sample - 1, hour), hour + SAMPLES_PER_SEGMENT - 3)
    a, b, c, d = (depth[row, first + k] for k in range(4))
    p, q = c - 2.0 * b + a, d - 3.0 * c + 3.0 * b - a
    before = (sample - first).to(depth.dtype)

    def polynomial(fraction: Tensor) -> Tensor:  # by Newton's forward differences
        s = before + fraction
        return a + s * (b - a + (s - 1.0) * (0.5 * p + (s - 2.0) * q / 6.0))

    zero, one = torch.zeros_like(before), torch.ones_like(before)
    root = find_root(polynomial, zero, one, depth[row, sample], depth[row, sample + 1], ITERATIONS)
    return root.clamp(INSIDE, 1.0 - INSIDE)
