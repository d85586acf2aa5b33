"""When places on the ground see the satellite: access windows, as bsk_rl finds them on its planned trajectory.

Windows are generated for an interval at a time: once at reset for the whole episode, later in segments of ten minutes when a
query runs out of them. A window that is open at the end of an interval is closed there, and joined when the next one is made.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import earth_angles
from bsk_torch.astro.frames import rotate_z, sin_elevation
from bsk_torch.astro.roots import find_maximum, find_root
from bsk_torch.sim.orbit import Arcs
from bsk_torch.sim.span import PLAN_STEP, pole_matrix
from bsk_torch.vec3 import Vec3

SHORTEST = 0.1
"""Windows that rise and set inside an interval and last no longer than this, s, are dropped."""

LOOKAHEAD = 100
"""Segments that a query may add before it gives up."""

CHUNK = 256
"""Rows searched at once, which bounds memory."""


class Places(NamedTuple):
    """Places on the ground: Earth-fixed positions [S, 3], m, and sines of the least elevation [S]."""

    r_P: Tensor
    sin_min_elevation: Tensor


class Events(NamedTuple):
    """Rises or sets: row and place of each, and its time, s."""

    row: Tensor
    place: Tensor
    time: Tensor


class Windows(NamedTuple):
    """Windows [n, W], sorted by closing time: opening and closing time, s, and place; missing ones close at infinity."""

    open: Tensor
    close: Tensor
    place: Tensor


def _fixed_position(arcs: Arcs, rows: Tensor, time: Tensor) -> Vec3:
    """Planned Earth-fixed position at time [m] of ``rows`` [m]."""
    et = arcs.et[rows] + time
    angle = earth_angles(et)[2]
    return rotate_z(pole_matrix(et) @ arcs.planned_position(rows, time), torch.cos(angle), torch.sin(angle))


class Search:
    """Elevations of one batch of intervals, sampled every 30 s, and what can be read off them."""

    def __init__(self, arcs: Arcs, places: Places, rows: Tensor, start: Tensor, samples: int) -> None:
        """Sample the intervals that begin at ``start`` [n] of ``rows`` [n] at ``samples`` times each."""
        self.arcs, self.places, self.rows, self.start, self.samples = arcs, places, rows, start, samples
        time = start.unsqueeze(-1) + PLAN_STEP * torch.arange(samples, device=start.device)
        flat = _fixed_position(arcs, rows.repeat_interleave(samples), time.flatten())
        self.r = Vec3(*(x.view(len(rows), 1, samples) for x in flat))
        self.sites = Vec3.of(places.r_P.unsqueeze(1))
        self.height = sin_elevation(self.r, self.sites) - places.sin_min_elevation.unsqueeze(-1)
        self.up = self.height > 0.0

    def _at(self, row: Tensor, place: Tensor, time: Tensor) -> Tensor:
        r = _fixed_position(self.arcs, self.rows[row], time)
        return sin_elevation(r, Vec3.of(self.places.r_P[place])) - self.places.sin_min_elevation[place]

    def _crossings(self, index: tuple[Tensor, ...], step: int) -> Events:
        """Times at which the place crosses the limit between sample k and k + step."""
        row, place, k = index
        a, b = (self.start[row] + PLAN_STEP * j for j in (k, k + step))
        ends = self.height[row, place, k], self.height[row, place, k + step]
        time = find_root(lambda t: self._at(row, place, t), a, b, *ends)
        return Events(row, place, time)

    def rises(self) -> Events:
        """Rises between samples."""
        return self._crossings(torch.nonzero(~self.up[..., :-1] & self.up[..., 1:], as_tuple=True), 1)

    def sets(self) -> Events:
        """Sets between samples."""
        return self._crossings(torch.nonzero(self.up[..., :-1] & ~self.up[..., 1:], as_tuple=True), 1)

    def glimpses(self) -> tuple[Events, Events]:
        """Rises and sets of passes that fall between two samples."""
        before, here, after = self.height[..., :-2], self.height[..., 1:-1], self.height[..., 2:]
        bend = torch.clamp(2.0 * here - before - after, min=1e-12)
        possible = (here >= before) & (here >= after) & (here <= 0.0) & (here + 0.5 * (before - after) ** 2 / bend > -0.01)
        row, place, k = torch.nonzero(possible, as_tuple=True)
        if not len(row):
            none = Events(row, place, torch.zeros_like(self.start[row]))
            return none, none
        a, b = (self.start[row] + PLAN_STEP * j for j in (k, k + 2))
        peak = find_maximum(lambda t: self._at(row, place, t), a, b)
        top = self._at(row, place, peak)
        keep = top > 0.0
        row, place, a, b, peak, top = (x[keep] for x in (row, place, a, b, peak, top))

        def crossing(outer: Tensor) -> Events:
            f = lambda t: self._at(row, place, t)  # noqa: E731
            return Events(row, place, find_root(f, outer, peak, f(outer), top, iterations=20))

        return crossing(a), crossing(b)

    def near(self) -> Tensor:
        """Samples that bsk_rl looks at closely, [n, S, K]: those within 1.1 times the slant range of the least elevation."""
        highest = self.r.norm().amax(-1, keepdim=True)
        reach = 1.1 * (highest - self.sites.norm()) / self.places.sin_min_elevation.unsqueeze(-1)
        return (self.r - self.sites).norm() < reach


def _whole(search: Search, end: Tensor) -> tuple[Events, Tensor]:
    """All passes of long intervals, those in progress at either end cut there: rises, and the times of the sets."""
    first, last = (torch.nonzero(search.up[..., k], as_tuple=True) for k in (0, -1))
    starts = [Events(first[0], first[1], search.start[first[0]]), search.rises()]
    stops = [search.sets(), Events(last[0], last[1], end[last[0]])]
    rise, fall = _ordered(starts), _ordered(stops)
    brief = search.glimpses()
    keep = brief[1].time - brief[0].time > SHORTEST
    rise = Events(*(torch.cat([a, b[keep]]) for a, b in zip(rise, brief[0], strict=True)))
    return rise, torch.cat([fall.time, brief[1].time[keep]])


def _ordered(parts: list[Events]) -> Events:
    """Events by row, then place, then time."""
    row, place, time = (torch.cat(columns) for columns in zip(*parts, strict=True))
    order = torch.argsort(time, stable=True)
    order = order[torch.argsort(place[order], stable=True)]
    order = order[torch.argsort(row[order], stable=True)]
    return Events(row[order], place[order], time[order])


def _segment(search: Search, end: Tensor) -> tuple[Tensor, Tensor]:
    """Opening and closing time [n, S] of the window of each place in a short interval; NaN where there is none.

    bsk_rl tests the two ends of the close samples only. With one end up there is one root; where the close samples begin
    with the interval the window is taken to reach back to its start, be the place rising or setting.
    """
    near, shape = search.near(), search.up.shape[:2]
    nan = torch.full(shape, torch.nan, dtype=torch.float64, device=end.device)
    rise, fall = nan.clone(), nan.clone()
    for table, parts in ((rise, (search.rises(), search.glimpses()[0])), (fall, (search.sets(), search.glimpses()[1]))):
        for events in parts:
            table[events.row, events.place] = events.time
    index = torch.arange(search.samples, device=end.device)
    first = torch.where(near, index, search.samples).amin(-1)
    last = torch.where(near, index, -1).amax(-1)
    a, b = (first - 1).clamp(0, search.samples - 1), (last + 1).clamp(0, search.samples - 1)
    up_a, up_b = (search.up.gather(-1, k.unsqueeze(-1)).squeeze(-1) for k in (a, b))
    root = torch.where(up_a, fall, rise)
    start, stop = search.start.unsqueeze(-1).expand(shape), end.unsqueeze(-1).expand(shape)
    from_start, to_end = (up_a ^ up_b) & (a == 0), (up_a ^ up_b) & (a > 0) & (b == search.samples - 1)
    inside = ~up_a & ~up_b & (fall - rise > SHORTEST)
    opens = torch.where(from_start, start, torch.where(to_end | inside, torch.where(inside, rise, root), nan))
    closes = torch.where(from_start, root, torch.where(to_end, stop, torch.where(inside, fall, nan)))
    return opens, closes


class AccessTable:
    """Windows of N satellites, and the time [N] up to which they have been generated."""

    def __init__(self, arcs: Arcs, places: Places, segment: float) -> None:
        """Prepare for ``places``; ``segment`` is the length, s, of the intervals that queries add."""
        self.arcs, self.places, self.segment = arcs, places, segment
        n = len(arcs.start)
        self.until = torch.zeros_like(arcs.start)
        empty = torch.full((n, 1), torch.inf, dtype=torch.float64, device=arcs.device)
        self.windows = Windows(empty, empty.clone(), torch.zeros(n, 1, dtype=torch.long, device=arcs.device))

    def reset(self, rows: Tensor, duration: Tensor) -> None:
        """Generate the windows of ``rows`` from time zero for ``duration`` [n] (multiples of the segment; none where zero)."""
        self.until[rows] = duration
        longest = float(duration.max())
        for part in torch.split(torch.arange(len(rows), device=rows.device), CHUNK):
            found = self._generate(rows[part], duration[part], longest)
            self.store(rows[part], found)

    def _generate(self, rows: Tensor, duration: Tensor, longest: float) -> Windows:
        start = torch.zeros_like(duration)
        search = Search(self.arcs, self.places, rows, start, round(longest / PLAN_STEP) + 1)
        rise, close = _whole(search, torch.full_like(duration, longest))
        begun = rise.time < duration[rise.row]
        rise, close = Events(*(part[begun] for part in rise)), close[begun]
        return _tabulate(rise, torch.minimum(close, duration[rise.row]), len(rows))

    def store(self, rows: Tensor, found: Windows) -> None:
        """Replace the windows of ``rows``."""
        width = max(self.windows.close.shape[1], found.close.shape[1])
        self.windows = _widened(self.windows, width)
        for table, new in zip(self.windows, _widened(found, width), strict=True):
            table[rows] = new

    def next(self, rows: Tensor, time: Tensor, count: int) -> Windows:
        """The ``count`` next windows to close, [n, count] each, of ``rows`` at ``time`` [n]; extends the table as needed.

        The last is repeated where there are fewer. Arcs must reach as far as :meth:`extend` asks.
        """
        index = torch.searchsorted(self.windows.close[rows].contiguous(), (time + 1e-12).unsqueeze(-1))
        index = index + torch.arange(count, device=rows.device)
        found = torch.isfinite(self.windows.close[rows]).sum(-1, keepdim=True)
        index = torch.minimum(index, found - 1).clamp(min=0)
        return Windows(*(table[rows].gather(1, index) for table in self.windows))

    def short(self, rows: Tensor, time: Tensor, count: int) -> Tensor:
        """Whether fewer than ``count`` windows of ``rows`` are still to close, [n]."""
        close = self.windows.close[rows]
        return ((close >= (time + 1e-12).unsqueeze(-1)) & torch.isfinite(close)).sum(-1) < count

    def extend(self, rows: Tensor, time: Tensor) -> None:
        """Add one segment to ``rows``; their arcs must cover it. Windows that closed before ``time`` are forgotten."""
        start, end = self.until[rows], self.until[rows] + self.segment
        search = Search(self.arcs, self.places, rows, start, round(self.segment / PLAN_STEP) + 1)
        opens, closes = _segment(search, end)
        old = Windows(*(table[rows] for table in self.windows))
        place = torch.arange(opens.shape[1], device=rows.device).expand(opens.shape)
        joins = (old.close.unsqueeze(-1) == start.view(-1, 1, 1)) & (old.place.unsqueeze(-1) == place.unsqueeze(1))
        joins = joins & (opens == start.unsqueeze(-1)).unsqueeze(1)
        earlier = torch.where(joins, old.open.unsqueeze(-1), torch.inf).amin(1)
        opens = torch.where(torch.isfinite(earlier), earlier, opens)
        gone = joins.any(-1) | (old.close < time.unsqueeze(-1))
        close = torch.cat([torch.where(gone, torch.inf, old.close), torch.nan_to_num(closes, nan=torch.inf)], 1)
        self.store(rows, _sorted(torch.cat([old.open, opens], 1), close, torch.cat([old.place, place], 1)))
        self.until[rows] = end


def _sorted(opens: Tensor, close: Tensor, place: Tensor) -> Windows:
    close, order = torch.sort(close, dim=1, stable=True)
    width = max(1, int(torch.isfinite(close).sum(1).max()))
    return Windows(opens.gather(1, order)[:, :width], close[:, :width], place.gather(1, order)[:, :width])


def _widened(windows: Windows, width: int) -> Windows:
    extra = width - windows.close.shape[1]
    if extra <= 0:
        return windows
    pad = torch.nn.functional.pad
    opens, close = (pad(t, (0, extra), value=math.inf) for t in windows[:2])
    return Windows(opens, close, pad(windows.place, (0, extra)))


def _tabulate(rise: Events, close: Tensor, n: int) -> Windows:
    """Windows [n, W] of rows 0 to n - 1 from lists in any order."""
    order = torch.argsort(close)
    order = order[torch.argsort(rise.row[order], stable=True)]
    row, counts = rise.row[order], torch.bincount(rise.row, minlength=n)
    rank = torch.arange(len(row), device=row.device) - (torch.cumsum(counts, 0) - counts)[row]
    width = max(1, int(counts.max()) if len(row) else 1)
    opens = torch.full((n, width), math.inf, dtype=torch.float64, device=row.device)
    closes, places = opens.clone(), torch.zeros(n, width, dtype=torch.long, device=row.device)
    opens[row, rank], closes[row, rank], places[row, rank] = rise.time[order], close[order], rise.place[order]
    return Windows(opens, closes, places)
