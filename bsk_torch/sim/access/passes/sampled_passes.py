"""Passes of satellites over places that move, by sampling: each condition of a clear view by itself, then all together.

A coarse screen drops the stretches of two minutes in which some condition cannot hold, whatever satellite and place do within the
distance that they cover. What remains are runs of neighboring stretches, in which every condition is sampled every 30 s.
Crossings of zero are refined by root finding; between three samples whose parabola comes close to zero, the extreme is searched
for, so that neither short passes nor short interruptions are lost. A window is where all conditions hold.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import coefficients, position
from bsk_torch.astro.roots import find_maximum, find_root
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.access.passes.passes import GroundTrack, Passes
from bsk_torch.sim.access.visibility.geometry import ABOVE_LIMIT, RISE, SET, SHORT_PASS, SearchCells, event_code
from bsk_torch.sim.access.visibility.interface import CULMINATION_ITERATIONS, GROUND_TRACK
from bsk_torch.sim.access.visibility.planned import records_around
from bsk_torch.sim.access.windows.padded import argsort_by_group
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.places import Clearance, Places, Sight
from bsk_torch.vec3 import Vec3

CELL_SAMPLES = 4  # samples of a stretch: shorter ones are screened more sharply, longer ones less often

BISECTIONS, ROOT_ITERATIONS = 4, 10
"""Steps of the search for a crossing: bisections until the margin is nearly straight, then regula falsi."""

SCREENED = 1 << 19  # stretches of pairs screened at once, so that memory is bounded


class Runs(NamedTuple):
    """Neighboring stretches of pairs that the screen leaves: row of the search, place, first and last sample, [r] each."""

    row: Tensor
    place: Tensor
    first: Tensor
    last: Tensor


class Edges(NamedTuple):
    """Times, s, at which a condition begins (step 1) or ceases (-1) to hold in a run, [e] each."""

    run: Tensor
    time: Tensor
    step: Tensor


def find_passes(places: Places, rows: Tensor, track: GroundTrack) -> Passes:
    """Return the passes of satellites ``rows`` [n], with their ground track, over their places, in no particular order.

    Passes in progress at either end of the track are cut there. FloatingPointError for positions that are not finite.
    """
    cells = -(-(track.r_BP_P.shape[1] - 1) // CELL_SAMPLES)
    at_once = max(1, SCREENED // (cells * places.count))
    found_passes = []
    for part in torch.arange(len(rows), device=rows.device).split(at_once):
        passes = _Search(places, rows[part], GroundTrack(*(table[part] for table in track))).passes()
        found_passes.append(passes._replace(row=passes.row + part[0]))
    return Passes(*(torch.cat(parts) for parts in zip(*found_passes, strict=True)))


class _Search:
    """Search of a part of the rows."""

    def __init__(self, places: Places, rows: Tensor, track: GroundTrack) -> None:
        self.places, self.rows, self.track = places, rows, track
        self.samples = track.r_BP_P.shape[1]

    def sight(self, row: Tensor, place: Tensor, time: Tensor, r_BP_P: Tensor) -> Sight:
        """Return the sight of places [m, ...] from rows [m] of the search, at positions [m, ..., 3] m."""
        r_LP_P = self.places.position(self.rows[row], place, time)
        return Sight(self.rows[row], place, time, Vec3.of(r_BP_P), Vec3.of(r_LP_P), self.places.tables)

    def margin_near(self, clearance: Clearance, row: Tensor, place: Tensor, middle: Tensor) -> Callable[[Tensor], Tensor]:
        """Return the margin of a condition for pairs [m] as a function of times [m] s.

        The times lie within a step of the ``middle`` [m] s, a sample: positions are on one polynomial there.
        """
        path = Samples(self.track.r_BP_P, self.track.start, row)
        nodes, tau = records_around(GROUND_TRACK, path, middle + 0.5 * PLAN_STEP)  # rounding must not lead to the node before
        around, begin = coefficients([Vec3.of(node) for node in nodes.unbind(-2)]), middle + 0.5 * PLAN_STEP - tau
        rows, places = self.rows[row], place.unsqueeze(-1)

        def margin(time: Tensor) -> Tensor:
            r_BP_P = position(around, (time - begin) * (1.0 / PLAN_STEP)).map(lambda x: x.unsqueeze(-1))
            r_LP_P = Vec3.of(self.places.position(rows, places, time.unsqueeze(-1)))
            return clearance.margin(Sight(rows, places, time.unsqueeze(-1), r_BP_P, r_LP_P, self.places.tables)).squeeze(-1)

        return margin

    def screened(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return row, place and stretch, [m] each and in this order, of all that may hold a window."""
        device, half = self.rows.device, CELL_SAMPLES // 2
        middle = torch.arange(-(-(self.samples - 1) // CELL_SAMPLES), device=device) * CELL_SAMPLES + half
        around = (middle.unsqueeze(-1) + torch.arange(-half - 1, half + 2, device=device)).clamp(0, self.samples - 1)
        middle = middle.clamp(max=self.samples - 1)
        r_BP_P = self.track.r_BP_P[:, middle]
        moved_B = (self.track.r_BP_P[:, around] - r_BP_P.unsqueeze(2)).norm(dim=-1).amax(-1).unsqueeze(1)
        moved_L = (self.places.max_speed(self.rows) * ((half + 1) * PLAN_STEP)).unsqueeze(-1)
        place = torch.arange(self.places.count, device=device).view(1, -1, 1)
        every = torch.arange(len(self.rows), device=device)
        time = self.track.time(every.unsqueeze(-1), middle).unsqueeze(1)
        sight = self.sight(every, place, time, r_BP_P.unsqueeze(1))
        near = self.places.exists(self.rows).unsqueeze(-1).expand(len(self.rows), self.places.count, len(middle))
        for clearance in self.places.clearances:
            near = near & clearance.reachable(sight, moved_B, moved_L)
        row, number, cell = torch.nonzero(near, as_tuple=True)
        return row, number, cell

    def runs(self, row: Tensor, place: Tensor, cell: Tensor) -> tuple[Runs, Tensor]:
        """Return runs of neighboring stretches, and the run of each stretch, [m]."""
        starts = torch.ones_like(row, dtype=torch.bool)
        starts[1:] = (row[1:] != row[:-1]) | (place[1:] != place[:-1]) | (cell[1:] != cell[:-1] + 1)
        run = torch.cumsum(starts, 0) - 1
        begin = torch.nonzero(starts).squeeze(-1)
        end = torch.cat([begin[1:], begin.new_tensor([len(row)])])[: len(begin)] - 1
        last = ((cell[end] + 1) * CELL_SAMPLES).clamp(max=self.samples - 1)
        return Runs(row[begin], place[begin], cell[begin] * CELL_SAMPLES, last), run

    def passes(self) -> Passes:
        """Return the passes of the part."""
        row, place, cell = self.screened()
        runs, run = self.runs(row, place, cell)
        sample = cell.unsqueeze(-1) * CELL_SAMPLES + torch.arange(CELL_SAMPLES + 2, device=row.device)
        nearest = sample.clamp(max=self.samples - 1)
        time = self.track.time(row.unsqueeze(-1), sample)
        sight = self.sight(row, place.unsqueeze(-1), time, self.track.r_BP_P[row.unsqueeze(-1), nearest])
        first, last = (self.track.time(row, part[run]) for part in (runs.first, runs.last))
        begin = self.track.time(row, CELL_SAMPLES * cell)
        cells = SearchCells(begin, torch.minimum(begin + PLAN_STEP * CELL_SAMPLES, last), first, last)
        edges = [self._edges(c, c.margin(sight).expand(time.shape), time, cells, runs, run) for c in self.places.clearances]
        return self._together(Edges(*(torch.cat(parts) for parts in zip(*edges, strict=True))), runs)

    def _edges(self, clearance: Clearance, margin: Tensor, time: Tensor, cells: SearchCells, runs: Runs, run: Tensor) -> Edges:
        """Return where a condition begins and ceases to hold, from its samples [m, k] in each stretch."""
        wide = SearchCells(*(part.unsqueeze(-1) for part in cells))
        padded = torch.nn.functional.pad(margin, (2, 0), value=torch.nan)
        codes, mirrored = (event_code(f[:, :-2], f[:, 1:-1], f[:, 2:], time, wide).to(torch.uint8) for f in (padded, -padded))
        k, j = torch.nonzero(codes & (RISE | SET), as_tuple=True)
        b = time[k, j]
        f = self.margin_near(clearance, runs.row[run[k]], runs.place[run[k]], b)
        root = find_root(f, b - PLAN_STEP, b, margin[k, j - 1], margin[k, j], ROOT_ITERATIONS, BISECTIONS)
        edges = [(run[k], root, _signs((codes[k, j] & RISE) > 0, time))]
        k, j = torch.nonzero(codes & ABOVE_LIMIT, as_tuple=True)
        at_start = time[k, j] < cells.search_begin[k] + 0.5 * PLAN_STEP
        edges.append((run[k], time[k, j], _signs(at_start, time)))
        both = torch.cat([codes & SHORT_PASS, mirrored & SHORT_PASS])
        k, j = torch.nonzero(both, as_tuple=True)
        sign = _signs(k < len(codes), time)
        k = torch.where(k < len(codes), k, k - len(codes))
        edges.append(self._short(clearance, runs, run[k], time[k, j] - PLAN_STEP, sign))
        return Edges(*(torch.cat(columns) for columns in zip(*edges, strict=True)))

    def _short(
        self, clearance: Clearance, runs: Runs, run: Tensor, middle: Tensor, sign: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return run, time and step of short passes around samples ``middle`` [m] s (sign 1), and of interruptions (-1)."""
        if not len(run):
            return run, middle, sign
        f = self.margin_near(clearance, runs.row[run], runs.place[run], middle)
        extreme = find_maximum(lambda time: sign * f(time), middle - PLAN_STEP, middle + PLAN_STEP, CULMINATION_ITERATIONS)
        top = f(extreme)
        crosses = torch.nonzero(sign * top > 0.0).squeeze(-1)
        run, middle, sign, extreme, top = (part[crosses] for part in (run, middle, sign, extreme, top))
        f = self.margin_near(clearance, runs.row[run], runs.place[run], middle)
        outer = (middle - PLAN_STEP, middle + PLAN_STEP)
        opens, closes = (find_root(f, end, extreme, f(end), top, ROOT_ITERATIONS, BISECTIONS) for end in outer)
        return torch.cat([run, run]), torch.cat([opens, closes]), torch.cat([sign, -sign])

    def _together(self, edges: Edges, runs: Runs) -> Passes:
        """Return where all conditions hold: after so many beginnings more than ends as there are conditions."""
        order = argsort_by_group(edges.run, edges.time)
        run, time, step = (part[order] for part in edges)
        level = torch.cumsum(step, 0)  # each run begins and ends with none, so the sum need not start again
        if len(level) and (not bool(torch.isfinite(time).all()) or float(level[-1]) != 0.0):
            raise FloatingPointError("conditions begin to hold more often than they cease to: positions are not finite")
        wanted = float(len(self.places.clearances))
        opens = torch.nonzero((level == wanted) & (step > 0.0)).squeeze(-1)
        closes = torch.nonzero((level == wanted - 1.0) & (step < 0.0)).squeeze(-1)
        long = torch.nonzero(time[closes] > time[opens]).squeeze(-1)
        run_of = run[opens[long]]
        return Passes(runs.row[run_of], runs.place[run_of], time[opens[long]], time[closes[long]])


def _signs(positive: Tensor, like: Tensor) -> Tensor:
    return 2.0 * positive.to(like.dtype) - 1.0
