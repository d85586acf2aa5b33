"""When places on the ground see the satellite: access windows, as bsk_rl finds them on its planned trajectory.

Windows are generated for an interval at a time: once at reset for the whole episode, later in segments of ten minutes when a
query runs out of them. A window that is open at the end of an interval is closed there, and joined when the next one is made.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.sim.orbit import Arcs
from bsk_torch.sim.ragged import stored, tabulate
from bsk_torch.sim.sight import GLIMPSED, MOST_PLACES, PER_PLACE, RISES, SETS, Brackets, Places, Sight, View
from bsk_torch.sim.span import PLAN_STEP, SPAN

SHORTEST = 0.1
"""Windows that rise and set inside an interval and last no longer than this, s, are dropped."""

LOOKAHEAD = 100
"""Segments that a query may add before it gives up."""

AHEAD = 10800.0
"""Seconds that are searched at once beyond what has been asked for."""

TIE = 1e-7
"""Windows cut at the same time are sorted by place, as if each closed so much later, s, than the one before."""


class Events(NamedTuple):
    """Rises or sets: row and place of each, and its time, s."""

    row: Tensor
    place: Tensor
    time: Tensor


class Column(NamedTuple):
    """One of the next windows of every row: closing time and place in the table, [N] each."""

    values: Tensor
    indices: Tensor


class Windows(NamedTuple):
    """Windows [n, W], sorted by closing time: opening and closing time, s, and place; missing ones close at infinity."""

    open: Tensor
    close: Tensor
    place: Tensor


class Search:
    """Elevations of one batch of intervals, sampled every 30 s, and what can be read off them."""

    def __init__(self, sight: Sight, view: View, places: Places, start: Tensor, samples: int, whole: bool) -> None:
        """Sample the intervals that begin at ``start`` [n] on the arcs of a view at ``samples`` times; see :class:`Heights`."""
        self.sight, self.view, self.places, self.start, self.samples = sight, view, places, start, samples
        codes, self.above, self.radius = sight.heights(view, start, samples, places, whole)
        row, sample = torch.nonzero(codes, as_tuple=True)
        codes = codes[row, sample].long().unsqueeze(-1) >> (3 * torch.arange(len(places.r_P), device=start.device))
        which, place = torch.nonzero(codes & (PER_PLACE - 1), as_tuple=True)
        self._index = row[which], place, sample[which]
        self._code = codes[which, place]

    def _places(self, place: Tensor) -> Places:
        return Places(*(part[place] for part in self.places))

    def _happened(self, code: int) -> tuple[Tensor, ...]:
        """Row, place and sample of what has a code."""
        return tuple(part[(self._code & code) > 0] for part in self._index)

    def _crossings(self, code: int) -> Events:
        """Times at which the place crosses the limit, before the samples where that has been noticed."""
        row, place, k = self._happened(code)
        a, b = (self.start[row] + PLAN_STEP * j for j in (k - 1, k))
        view, places = self.view.of(row), self._places(place)
        brackets = Brackets(a, b, *(self.sight.height(view, places, time) for time in (a, b)))
        return Events(row, place, self.sight.crossings(view, places, brackets))

    def up(self, sample: int) -> tuple[Tensor, Tensor]:
        """Rows and places that see each other at a sample."""
        n, s = len(self.start), len(self.places.r_P)
        row = torch.arange(n, device=self.start.device).repeat_interleave(s)
        place = torch.arange(s, device=self.start.device).repeat(n)
        above = self.sight.height(self.view.of(row), self._places(place), self.start[row] + PLAN_STEP * sample) > 0.0
        return row[above], place[above]

    def rises(self) -> Events:
        """Rises between samples."""
        return self._crossings(RISES)

    def sets(self) -> Events:
        """Sets between samples."""
        return self._crossings(SETS)

    def glimpses(self) -> tuple[Events, Events]:
        """Rises and sets of passes that fall between two samples."""
        row, place, k = self._happened(GLIMPSED)
        if not len(row):
            none = Events(row, place, torch.zeros_like(self.start[row]))
            return none, none
        a, b = (self.start[row] + PLAN_STEP * j for j in (k - 2, k))
        view, places = self.view.of(row), self._places(place)
        peak = self.sight.peaks(view, places, a, b)
        top = self.sight.height(view, places, peak)
        keep = top > 0.0
        row, place, a, b, peak, top = (x[keep] for x in (row, place, a, b, peak, top))

        view, places = self.view.of(row), self._places(place)

        def crossing(outer: Tensor) -> Events:
            brackets = Brackets(outer, peak, self.sight.height(view, places, outer), top)
            return Events(row, place, self.sight.crossings(view, places, brackets))

        return crossing(a), crossing(b)

    def pairs(self) -> tuple[Tensor, Tensor]:
        """Rows and places of which something happens, each pair once."""
        both = torch.unique(self._index[0] * len(self.places.r_P) + self._index[1])
        return both // len(self.places.r_P), both % len(self.places.r_P)

    def near(self, row: Tensor, place: Tensor) -> Tensor:
        """Samples that bsk_rl looks at closely, [m, K]: those within 1.1 times the slant range of the least elevation."""
        radius, least = self.radius[row], self.places.sin_min_elevation[place].unsqueeze(-1)
        site = self.places.r_P[place].norm(dim=-1, keepdim=True)
        sine = self.above[row, :, place] + least
        distance = torch.sqrt(radius * radius - site * site * (1.0 - sine * sine)) - site * sine
        return distance < 1.1 * (radius.amax(1, keepdim=True) - site) / least


def _whole(search: Search, end: Tensor) -> tuple[Events, Tensor]:
    """All passes of long intervals, those in progress at either end cut there: rises, and the times of the sets."""
    first, last = search.up(0), search.up(search.samples - 1)
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
    row, place = search.pairs()
    near, up = search.near(row, place), search.above[row, :, place] > 0.0
    opens, closes = (
        torch.full((len(end), len(search.places.r_P)), torch.nan, dtype=torch.float64, device=end.device) for _ in "ab"
    )
    brief = search.glimpses()
    # the tables hold rises and sets at first
    for table, parts in ((opens, (search.rises(), brief[0])), (closes, (search.sets(), brief[1]))):
        for events in parts:
            table[events.row, events.place] = events.time
    rise, fall = opens[row, place], closes[row, place]
    index = torch.arange(search.samples, device=end.device)
    first = torch.where(near, index, search.samples).amin(-1)
    last = torch.where(near, index, -1).amax(-1)
    a, b = (first - 1).clamp(0, search.samples - 1), (last + 1).clamp(0, search.samples - 1)
    up_a, up_b = (up.gather(-1, k.unsqueeze(-1)).squeeze(-1) for k in (a, b))
    root = torch.where(up_a, fall, rise)
    from_start, to_end = (up_a ^ up_b) & (a == 0), (up_a ^ up_b) & (a > 0) & (b == search.samples - 1)
    inside = ~up_a & ~up_b & (fall - rise > SHORTEST)
    begins = torch.where(inside, rise, torch.where(to_end, root, torch.nan))
    stops = torch.where(inside, fall, torch.where(from_start, root, torch.nan))
    opens[row, place] = torch.where(from_start, search.start[row], begins)
    closes[row, place] = torch.where(to_end, end[row], stops)
    return opens, closes


class AccessTable:
    """Windows of N satellites, sorted by closing time.

    They have been searched for up to ``ready`` [N] s; what a query sees of them ends at ``until`` [N], as if they had been
    generated only so far: windows in progress then are cut there.
    """

    def __init__(self, arcs: Arcs, sight: Sight, places: Places, segment: float) -> None:
        """Prepare for ``places``; ``segment`` is the length, s, of the intervals that queries add."""
        if len(places.r_P) > MOST_PLACES:
            raise ValueError(f"groundStationsData has {len(places.r_P)} stations; at most {MOST_PLACES} are possible")
        self.arcs, self.sight, self.places, self.segment = arcs, sight, places, segment
        n = len(arcs.start)
        self.until, self.ready = torch.zeros_like(arcs.start), torch.zeros_like(arcs.start)
        empty = torch.full((n, 1), torch.inf, dtype=torch.float64, device=arcs.device)
        self.windows = Windows(empty, empty.clone(), torch.zeros(n, 1, dtype=torch.long, device=arcs.device))
        self.rank = self.windows.place * TIE
        self.ahead = max(1, round(AHEAD / segment))

    def reset(self, rows: Tensor, view: View, duration: Tensor) -> None:
        """Generate the windows of ``rows`` on new arcs from time zero for ``duration`` [n] (whole segments; none where zero).

        Segments beyond it, which a query will ask for, are searched as far as the arcs reach.
        """
        longest, start = float(duration.max()), torch.zeros_like(duration)
        search = Search(self.sight, view, self.places, start, round(longest / PLAN_STEP) + 1, whole=True)
        rise, close = _whole(search, torch.full_like(duration, longest))
        begun = rise.time < duration[rise.row]
        rise, close = Events(*(part[begun] for part in rise)), close[begun]
        closes, opens, place = tabulate(rise.row, torch.minimum(close, duration[rise.row]), len(rows), rise.time, rise.place)
        self.store(rows, Windows(opens, closes, place))
        self.until[rows] = self.ready[rows] = duration
        segments = min(self.ahead, int((self.arcs.length - longest) / self.segment))
        if segments:
            self._search(rows, view, segments, start)
        while len(behind := torch.nonzero(self.ready[rows] < self.arcs.planned_from[rows]).squeeze(-1)):
            segments = int((self.arcs.length - float(self.ready[rows[behind]].max())) / self.segment)
            self._search(rows[behind], view.of(behind), segments, start[behind])

    def store(self, rows: Tensor, found: Windows) -> None:
        """Replace the windows of ``rows``."""
        self.windows = Windows(*(stored(table, rows, new) for table, new in zip(self.windows, found, strict=True)))
        self.rank = self.windows.place * TIE

    def next(self, time: Tensor, count: int) -> tuple[Windows, Tensor]:
        """The ``count`` next windows to close at ``time`` [N], [N, count] each, and how many of them there are, [N].

        The last is repeated where there are fewer.
        """
        until = self.until.unsqueeze(-1)
        close = torch.minimum(self.windows.close, until + self.rank)
        ahead = (self.windows.open < until) & (close >= (time + 1e-12).unsqueeze(-1))
        left = torch.where(ahead, close, torch.inf)
        columns = [Column(*torch.min(left, 1))]
        if count == 1:
            index = columns[0].indices.unsqueeze(-1)
            opens, place = (table.gather(1, index) for table in (self.windows.open, self.windows.place))
            close = torch.minimum(columns[0].values.unsqueeze(-1), until)
            return Windows(opens, close, place), torch.isfinite(columns[0].values).long()
        for _ in range(count - 1):
            left = left.scatter(1, columns[-1].indices.unsqueeze(-1), torch.inf)
            later = Column(*torch.min(left, 1))
            none = torch.isinf(later.values)
            last = columns[-1]
            columns.append(Column(*(torch.where(none, a, b) for a, b in zip(last, later, strict=True))))
        index = torch.stack([column.indices for column in columns], -1)
        opens, place = (table.gather(1, index) for table in (self.windows.open, self.windows.place))
        close = torch.minimum(torch.stack([column.values for column in columns], -1), until)
        return Windows(opens, close, place), ahead.sum(1).clamp(max=count)

    def reveal(self, rows: Tensor, time: Tensor, count: int) -> Tensor:
        """Add as many segments as ``rows`` [m], which see too few, need to see ``count`` windows ahead at ``time`` [m].

        Returns:
            Those for which too few are ready.
        """
        opens, close, _ = (table[rows] for table in self.windows)
        ahead = torch.isfinite(close) & (close >= (time + 1e-12).unsqueeze(-1))
        enough, until = ahead.sum(1) >= count, self.until[rows]
        last = torch.where(ahead, opens, torch.inf).sort(1).values[:, min(count, opens.shape[1]) - 1]
        # both the opening and the present must lie before the new end
        steps = torch.floor((torch.maximum(last, time) - until) / self.segment) + 1.0
        self.until[rows] = torch.where(enough, until + steps.clamp(min=0.0) * self.segment, self.ready[rows])
        return rows[~enough]

    def extend(self, rows: Tensor, time: Tensor) -> None:
        """Search more segments for ``rows``, as far as their arcs reach; windows that closed before ``time`` are forgotten."""
        self._search_on(rows, self.ahead, time[rows])
        self.until[rows] = self.until[rows] + self.segment

    def catch_up(self, rows: Tensor) -> None:
        """Search what the planned arcs of ``rows`` hold, before their first hour is forgotten."""
        started = self.arcs.et[rows] != 0.0
        behind = rows[started & (self.ready[rows] < self.arcs.planned_from[rows] + SPAN)]
        if len(behind):
            self._search_on(behind, 10**9, torch.zeros_like(self.ready[behind]))

    def _search_on(self, rows: Tensor, segments: int, time: Tensor) -> None:
        """Search at most so many segments of ``rows`` [n] on the planned arcs that are kept."""
        view = View(self.arcs.planned_samples, self.arcs.sky_samples).of(rows)
        room = int(float((self.arcs.end[rows] - self.ready[rows]).min()) / self.segment)
        if min(segments, room) > 0:
            self._search(rows, view, min(segments, room), time)

    def _search(self, rows: Tensor, view: View, segments: int, time: Tensor) -> None:
        """Search ``segments`` more segments of ``rows`` [n]; windows that closed before ``time`` [n] go."""
        n, s, device = len(rows), len(self.places.r_P), rows.device
        begin = self.ready[rows].unsqueeze(-1) + self.segment * torch.arange(segments + 1, device=device)
        start, end = begin[:, :-1].flatten(), begin[:, 1:].flatten()
        owner = torch.arange(n, device=device).repeat_interleave(segments)
        search = Search(self.sight, view.of(owner), self.places, start, round(self.segment / PLAN_STEP) + 1, whole=False)
        opens, closes = (part.view(n, segments, s) for part in _segment(search, end))
        old = Windows(*(table[rows] for table in self.windows))
        opens, final, joined = _joined(opens, closes, begin, old)
        old_row, k = torch.nonzero(torch.isfinite(old.close) & ~joined & (old.close >= time.unsqueeze(-1)), as_tuple=True)
        new_row, segment, place = torch.nonzero(final, as_tuple=True)
        close = torch.cat([old.close[old_row, k], closes[new_row, segment, place]])
        rise = torch.cat([old.open[old_row, k], opens[new_row, segment, place]])
        where = torch.cat([old.place[old_row, k], place])
        close, rise, where = tabulate(torch.cat([old_row, new_row]), close, n, rise, where)
        self.store(rows, Windows(rise, close, where))
        self.ready[rows] = end.view(n, segments)[:, -1]


def _joined(opens: Tensor, closes: Tensor, begin: Tensor, old: Windows) -> tuple[Tensor, Tensor, Tensor]:
    """Join windows [n, K, S] of consecutive segments where one closes as the next opens, and with the ``old`` ones [n, W].

    Returns:
        Opening times with those of the windows joined to them; which windows nothing follows; which old ones have been joined.
    """
    _, segments, places = opens.shape
    place = torch.arange(places, device=opens.device)
    follows = opens == begin[:, :-1].unsqueeze(-1)
    mine = (old.close == begin[:, :1]).unsqueeze(-1) & (old.place.unsqueeze(-1) == place) & follows[:, :1]
    carried = torch.where(mine, old.open.unsqueeze(-1), torch.inf).amin(1)
    begun, last = [torch.where(torch.isfinite(carried), carried, opens[:, 0])], torch.isfinite(closes)
    for k in range(1, segments):
        joins = follows[:, k] & (closes[:, k - 1] == begin[:, k : k + 1])
        begun.append(torch.where(joins, begun[-1], opens[:, k]))
        last[:, k - 1] &= ~joins
    return torch.stack(begun, 1), last, mine.any(-1)
