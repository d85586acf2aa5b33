"""Passes of satellites over places on the ground, of all satellites and places at once.

A coarse screen compares every place with one sample in sixteen, as a matrix product. What it leaves is looked at every 30 s, and
only crossings of the limit are refined.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.lanes.loop import Samples
from bsk_torch.sim.ragged import sorted_by
from bsk_torch.sim.sight import CELL, GLIMPSED, RISES, SETS, UP, Brackets, Cells, Pairs, Sight
from bsk_torch.sim.span import PLAN_STEP

SHORTEST = 0.1
"""Passes that rise and set between two boundaries and last no longer than this, s, are dropped."""

SCREENED, DEVICE_SCREENED = 1 << 20, 1 << 26
"""Products of the coarse screen that are made at once on the CPU, where they should fit into its cache, and on other devices."""

SLACK = 1e-5
"""Angle, rad, by which the coarse screen looks farther than it must: its products are float32."""


class Places(NamedTuple):
    """Places on the ground: Earth-fixed positions [n, P, 3], m, and sines of the least elevation [n, P]; n may be 1.

    Where a satellite has fewer places than others, the positions of the rest are NaN.
    """

    r_P: Tensor
    sin_min_elevation: Tensor

    def of(self, rows: Tensor) -> Places:
        """The places of rows [n]."""
        return self if len(self.r_P) == 1 else Places(self.r_P[rows], self.sin_min_elevation[rows])


class Ground(NamedTuple):
    """Earth-fixed positions [n, K, 3], m, every 30 s from ``start`` [n] s on."""

    r_P: Tensor
    start: Tensor

    @property
    def end(self) -> Tensor:
        """Time of the last sample, [n] s."""
        return self.start + PLAN_STEP * (self.r_P.shape[1] - 1)


class Events(NamedTuple):
    """Rises or sets: row and place of each, and its time, s."""

    row: Tensor
    place: Tensor
    time: Tensor


class Passes(NamedTuple):
    """Passes of row ``row`` over place ``place``, each [m]; those in progress at either end of the search are cut there."""

    row: Tensor
    place: Tensor
    open: Tensor
    close: Tensor


def limit_angle(ratio: Tensor, sin_elevation: Tensor) -> Tensor:
    """Angle at the Earth's centre, rad, at which an elevation is seen, of the place's over the satellite's distance from it."""
    cosine = torch.sqrt(1.0 - sin_elevation * sin_elevation)
    return torch.acos(torch.clamp(ratio * cosine, -1.0, 1.0)) - torch.asin(sin_elevation)


def screen(ground: Ground, places: Places) -> tuple[Tensor, Tensor, Tensor]:
    """Row, place and cell of what the coarse screen leaves, [m] each: a cell may see what lies within its reach of its middle."""
    samples = ground.r_P.shape[1]
    index = torch.arange(-(-(samples - 1) // CELL), device=ground.r_P.device).unsqueeze(-1) * CELL + CELL // 2
    around = (index + torch.arange(-CELL // 2 - 1, CELL // 2 + 2, device=index.device)).clamp(0, samples - 1)
    distance = ground.r_P.norm(dim=-1)
    unit = ground.r_P / distance.unsqueeze(-1)
    middle = unit[:, around[:, CELL // 2 + 1]]
    turn = (unit[:, around] * middle.unsqueeze(2)).sum(-1).amin(-1)
    radius = places.r_P.norm(dim=-1)
    ratio = radius.nan_to_num(nan=torch.inf).amin(-1, keepdim=True) / distance[:, around].amax(-1)
    reach = torch.acos(turn.clamp(max=1.0)) + limit_angle(ratio, places.sin_min_elevation.amin(-1, keepdim=True)) + SLACK
    least = torch.cos(reach.clamp(max=torch.pi)).float()
    sites = (places.r_P / radius.unsqueeze(-1)).float()
    return _within(middle.float(), sites, least)


def _within(middle: Tensor, sites: Tensor, least: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Row, place and cell where ``middle`` [n, C, 3] times ``sites`` [n or 1, P, 3] exceeds ``least`` [n, C]."""
    room = SCREENED if middle.device.type == "cpu" else DEVICE_SCREENED
    at_once = max(1, room // (middle.shape[1] * sites.shape[1]))
    found = []
    for first in range(0, len(middle), at_once):
        part = slice(first, first + at_once)
        near = middle[part] @ (sites if len(sites) == 1 else sites[part]).mT > least[part].unsqueeze(-1)
        row, cell, place = torch.nonzero(near, as_tuple=True)
        found.append((row + first, place, cell))
    row, place, cell = (torch.cat(parts) for parts in zip(*found, strict=True))
    return row, place, cell


class Search:
    """What happens between n satellites and their places while the samples of ``ground`` last."""

    def __init__(self, sight: Sight, ground: Ground, places: Places) -> None:
        """Screen and sample all places."""
        self.sight, self.ground, self.places = sight, ground, places
        self.path = Samples(ground.r_P, ground.start)
        row, place, cell = screen(ground, places)
        begin, end = ground.start[row], ground.end[row]
        first = begin + PLAN_STEP * CELL * cell
        cells = Cells(first, torch.minimum(first + PLAN_STEP * CELL, end), begin, end)
        found = sight.happenings(self.pairs(row, place), cells).to(torch.uint8)
        which, look = torch.nonzero(found, as_tuple=True)
        self._index = row[which], place[which], cell[which] * CELL + look
        self._code = found[which, look]

    def pairs(self, row: Tensor, place: Tensor) -> Pairs:
        """Satellites ``row`` [m] over places ``place`` [m]."""
        owner = row if len(self.places.r_P) > 1 else torch.zeros_like(row)
        return Pairs(Samples(*self.path[:2], row), self.places.r_P[owner, place], self.places.sin_min_elevation[owner, place])

    def _happened(self, code: int) -> tuple[Tensor, ...]:
        """Row, place and sample of what has a code."""
        return tuple(part[(self._code & code) > 0] for part in self._index)

    def _times(self, row: Tensor, sample: Tensor) -> Tensor:
        return self.ground.start[row] + PLAN_STEP * sample

    def crossings(self, code: int) -> Events:
        """Rises or sets between samples."""
        row, place, k = self._happened(code)
        a, b = self._times(row, k - 1), self._times(row, k)
        pairs = self.pairs(row, place)
        brackets = Brackets(a, b, *(self.sight.clearance(pairs, time) for time in (a, b)))
        return Events(row, place, self.sight.crossings(pairs, brackets))

    def up(self, sample: int) -> Events:
        """Pairs that see each other at the first or last sample."""
        row, place, k = self._happened(UP)
        mine = k == sample
        return Events(row[mine], place[mine], self._times(row, k)[mine])

    def glimpses(self) -> Passes:
        """Passes that fall between two samples."""
        row, place, k = self._happened(GLIMPSED)
        a, b = self._times(row, k - 2), self._times(row, k)
        pairs = self.pairs(row, place)
        peak = self.sight.peaks(pairs, a, b)
        top = self.sight.clearance(pairs, peak)
        keep = torch.nonzero(top > 0.0).squeeze(-1)
        row, place, a, b, peak, top = (x[keep] for x in (row, place, a, b, peak, top))
        pairs = pairs.of(keep)
        edges = (Brackets(outer, peak, self.sight.clearance(pairs, outer), top) for outer in (a, b))
        opens, closes = (self.sight.crossings(pairs, brackets) for brackets in edges)
        long = closes - opens > SHORTEST
        return Passes(*(x[long] for x in (row, place, opens, closes)))

    def passes(self) -> Passes:
        """All passes, in no particular order."""
        starts = _ordered([self.up(0), self.crossings(RISES)], self.places)
        stops = _ordered([self.crossings(SETS), self.up(self.ground.r_P.shape[1] - 1)], self.places)
        found, brief = Passes(starts.row, starts.place, starts.time, stops.time), self.glimpses()
        return Passes(*(torch.cat(parts) for parts in zip(found, brief, strict=True)))


def _ordered(parts: list[Events], places: Places) -> Events:
    """Events by row, then place, then time."""
    row, place, time = (torch.cat(columns) for columns in zip(*parts, strict=True))
    order = sorted_by(row * places.r_P.shape[1] + place, time)
    return Events(row[order], place[order], time[order])


# -- cut into the intervals that bsk_rl generates windows for -------------------------------------------------------------------


class Intervals(NamedTuple):
    """Intervals of n satellites: the first ends at ``first`` [n] s, the others last ``segment`` s each, up to ``end`` [n] s.

    The first one begins with the search.
    """

    begin: Tensor
    first: Tensor
    end: Tensor
    segment: float

    def number(self, row: Tensor, time: Tensor) -> Tensor:
        """Number of the interval that holds a time [m] of a row [m]."""
        later = torch.floor((time - self.first[row]) / self.segment) + 1.0
        return torch.where(time < self.first[row], torch.zeros_like(later), later)

    def start(self, row: Tensor, index: Tensor) -> Tensor:
        """When an interval begins."""
        return torch.where(index > 0.0, self.first[row] + (index - 1.0) * self.segment, self.begin[row])


def near(search: Search, row: Tensor, place: Tensor, start: Tensor, end: Tensor, rise: Tensor) -> Tensor:
    """Whether bsk_rl looks closely from the ``start`` [m] of an interval until the ``rise`` [m] in it, [m].

    It does where the place is within 1.1 times the slant range of the least elevation, reckoned with the largest radius up to the
    interval's ``end`` [m]; the sample at the start itself does not matter.
    """
    first = ((start - search.ground.start[row]) / PLAN_STEP).round().long().unsqueeze(-1)
    count = ((end - start) / PLAN_STEP).round().long().unsqueeze(-1)
    number = torch.arange(1 + int(count.max()) if len(count) else 1, device=row.device)
    path = search.ground.r_P[row.unsqueeze(-1), (first + number).clamp(max=search.ground.r_P.shape[1] - 1)]
    site, least = search.pairs(row, place)[1:]
    highest = torch.where(number <= count, path.norm(dim=-1), 0.0).amax(-1)
    threshold = 1.1 * (highest - site.norm(dim=-1)) / least
    close = (path - site.unsqueeze(1)).norm(dim=-1) < threshold.unsqueeze(-1)
    before = (number > 0) & (number * PLAN_STEP < (rise - start).unsqueeze(-1))
    return (close | ~before).all(-1)


def generated(search: Search, passes: Passes, intervals: Intervals) -> Passes:
    """The windows that bsk_rl makes of passes, interval after interval, joined where one closes as the next opens.

    It tests the two ends of the close samples of each interval only. An interval that lies within a pass gives no window. Of a
    pass that is in progress at the end of a segment the window is taken to reach back to the segment's start, and to end with the
    rise, where the close samples begin with the segment.
    """
    passes = Passes(*(part[passes.open < intervals.end[passes.row]] for part in passes))
    row, place, opens, closes = passes
    closes = torch.minimum(closes, intervals.end[row])
    first = intervals.number(row, opens)
    last = intervals.number(row, closes)
    begin, boundary = intervals.start(row, first), intervals.start(row, first + 1.0)
    in_progress, goes_on = opens <= intervals.begin[row], last > first
    rising = torch.nonzero(goes_on & ~in_progress).squeeze(-1)
    back = torch.zeros_like(goes_on)
    back[rising] = near(search, *(part[rising] for part in (row, place, begin, boundary, opens)))
    joined = goes_on & (last == first + 1.0) & ~back & ~in_progress
    head_open = torch.where(back, begin, opens)
    head_close = torch.where(back, opens, torch.where(goes_on & ~joined, boundary, closes))
    brief = (opens > begin) & ~goes_on & (closes - opens <= SHORTEST)
    head = ~(in_progress & goes_on) & ~brief
    # the last interval of a pass that outlasts the first; one that the pass fills has none
    tail = goes_on & ~joined & (closes < intervals.end[row])
    return Passes(
        torch.cat([row[head], row[tail]]),
        torch.cat([place[head], place[tail]]),
        torch.cat([head_open[head], intervals.start(row, last)[tail]]),
        torch.cat([head_close[head], closes[tail]]),
    )
