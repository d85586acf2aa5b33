"""When places on the ground see the satellite: access windows, as bsk_rl finds them on its planned trajectory.

Windows are generated for an interval at a time: once at reset for the whole episode, later in segments of ten minutes when a
query runs out of them. A window that is open at the end of an interval is closed there, and joined when the next one is made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import COUNT
from bsk_torch.sim.orbit import Arcs
from bsk_torch.sim.ragged import stored, tabulate
from bsk_torch.sim.search import Ground, Intervals, Passes, Places, Search, generated
from bsk_torch.sim.sight import Sight, View
from bsk_torch.sim.span import PLAN_STEP, SPAN

LOOKAHEAD = 100
"""Segments that a query may add before it gives up."""

AHEAD = 10800.0
"""Seconds that are searched at once beyond what has been asked for, unless :meth:`Access.expect` finds less to be enough."""

SEEN_PER_SECOND = 1.2e-5
"""About how often a low orbit passes a place: what :meth:`Access.expect` reckons with."""

TIE = 1e-7
"""Windows cut at the same time are sorted by place, as if each closed so much later, s, than the one before."""

FEW, SPARE = 48, 16
"""Tables of so many windows more than twice those that a query wants are looked at as a whole; of longer ones, those that it
wants and so many more are looked at first."""

LONGER = 4
"""How much longer the next block is, where one was not enough."""

PlacesOf = Callable[[Tensor], Places]
"""Places of rows [n]."""


class Windows(NamedTuple):
    """Windows [n, W], sorted by closing time: opening and closing time, s, and place; missing ones close at infinity."""

    open: Tensor
    close: Tensor
    place: Tensor


def first_after(windows: Windows, time: Tensor) -> Tensor:
    """Number of the first window that closes after ``time`` [n], [n]; W where none does."""
    return torch.searchsorted(windows.close, (time + 1e-12).unsqueeze(-1)).squeeze(-1)


def taken(windows: Windows, index: Tensor) -> Windows:
    """The windows with numbers ``index`` [n, K]."""
    return Windows(*(table.gather(1, index) for table in windows))


class Seen(NamedTuple):
    """Some windows of each row [n, K] as a query sees them, cut at the end of what is known, and which of them count."""

    windows: Windows
    ahead: Tensor
    rank: Tensor

    @property
    def key(self) -> Tensor:
        """What the windows that count are sorted by; infinity for the others."""
        return torch.where(self.ahead, self.windows.close + self.rank, torch.inf)


def seen(windows: Windows, time: Tensor, until: Tensor, allowed: Tensor | None) -> Seen:
    """How a query at ``time`` [n] sees windows [n, K]; ``allowed`` [n, P] says which places count."""
    end = until.unsqueeze(-1)
    now = (time + 1e-12).unsqueeze(-1)
    ahead = (windows.open < end) & (windows.close >= now) & (end >= now) & torch.isfinite(windows.close)
    if allowed is not None:
        ahead = ahead & allowed.gather(1, windows.place)
    cut = windows.close > end
    rank = torch.where(cut, windows.place * TIE, 0.0)
    return Seen(Windows(windows.open, torch.minimum(windows.close, end), windows.place), ahead, rank)


def next_of(
    windows: Windows, time: Tensor, until: Tensor, width: int, allowed: Tensor | None, block: int | None = None
) -> tuple[Windows, Tensor]:
    """The ``width`` next windows to close at ``time`` [n], [n, width] each, and how many of them there are, [n].

    The last is repeated where there are fewer. ``until`` [n] is the end of what is known, ``allowed`` [n, P] says which places
    count. Of long tables a ``block`` of windows is looked at first, which is enough for most rows, then longer ones.
    """
    total, block = windows.close.shape[1], block or width + SPARE
    if total <= 2 * width + FEW:
        return _soonest(seen(windows, time, until, allowed), width)
    first = first_after(windows, time)
    some, fresh = _from(windows, first, block, time, until, allowed)
    ahead = some.ahead & fresh
    slot = torch.where(ahead, (torch.cumsum(ahead, 1) - 1).clamp(max=width), width)
    number = torch.arange(block, device=time.device).expand_as(slot)
    column = torch.zeros(len(time), width + 1, dtype=torch.long, device=time.device).scatter(1, slot, number)[:, :width]
    found = ahead.sum(1).clamp(max=width)
    result = taken(some.windows, _padded(column, found, width))
    # windows that are cut are sorted by place, so those beyond the block may come first
    rest = torch.nonzero((ahead & (some.windows.close < until.unsqueeze(-1))).sum(1) < width).squeeze(-1)
    if not len(rest):
        return result, found
    few, mine = Windows(*(part[rest] for part in windows)), None if allowed is None else allowed[rest]
    longest = max(1, total - int(first[rest].min()))
    if longest > LONGER * block:
        late, number = next_of(few, time[rest], until[rest], width, mine, LONGER * block)
    else:
        every, fresh = _from(few, first[rest], longest, time[rest], until[rest], mine)
        late, number = _soonest(every._replace(ahead=every.ahead & fresh), width)
    result = Windows(*(a.index_copy(0, rest, b) for a, b in zip(result, late, strict=True)))
    return result, found.index_copy(0, rest, number)


def _from(
    windows: Windows, first: Tensor, count: int, time: Tensor, until: Tensor, allowed: Tensor | None
) -> tuple[Seen, Tensor]:
    """``count`` windows from the ``first`` [n] on, and which of them do not repeat the table's last one, [n, count]."""
    index = first.unsqueeze(-1) + torch.arange(count, device=time.device)
    last = windows.close.shape[1] - 1
    return seen(taken(windows, index.clamp(max=last)), time, until, allowed), index <= last


def _soonest(some: Seen, width: int) -> tuple[Windows, Tensor]:
    """The ``width`` windows that close first, the last repeated where there are fewer, and how many count, [n]."""
    key = some.key
    found = some.ahead.sum(1).clamp(max=width)
    if width == 1:
        order = key.argmin(1, keepdim=True)
    else:
        order = torch.sort(key, dim=1, stable=True).indices[:, :width]
        order = torch.nn.functional.pad(order, (0, width - order.shape[1]))
    return taken(some.windows, _padded(order, found, width)), found


def _padded(column: Tensor, found: Tensor, width: int) -> Tensor:
    """Columns [n, width] of which the first ``found`` [n] count, the last of these repeated."""
    slot = torch.minimum(torch.arange(width, device=column.device), (found - 1).clamp(min=0).unsqueeze(-1))
    return column.gather(1, slot)


class Access:
    """Windows of N satellites over several kinds of places.

    They have been searched for up to ``ready`` [N] s; what a query sees of them ends at ``until`` [N], as if they had been
    generated only so far: windows in progress then are cut there.
    """

    def __init__(self, arcs: Arcs, sight: Sight, kinds: Mapping[str, PlacesOf], segment: float) -> None:
        """Prepare for the ``kinds`` of places; ``segment`` is the length, s, of the intervals that queries add."""
        self.arcs, self.sight, self.kinds, self.segment = arcs, sight, dict(kinds), segment
        n = len(arcs.start)
        self.until, self.ready = torch.zeros_like(arcs.start), torch.zeros_like(arcs.start)
        self.windows: dict[str, Windows] = {}
        for kind in kinds:
            empty = torch.full((n, 1), torch.inf, dtype=torch.float64, device=arcs.device)
            self.windows[kind] = Windows(empty, empty.clone(), torch.zeros(n, 1, dtype=torch.long, device=arcs.device))
        self.ahead, self._expected = max(1, round(AHEAD / segment)), 0.0

    def expect(self, count: int, places: int) -> None:
        """Search so far ahead that queries for ``count`` of ``places`` places will mostly find enough."""
        self._expected = max(self._expected, 3.0 * self.segment, 1.5 * count / (SEEN_PER_SECOND * places))
        self.ahead = max(1, round(min(AHEAD, self._expected) / self.segment))

    def reset(self, rows: Tensor, view: View, duration: Tensor) -> None:
        """Generate the windows of ``rows`` on new arcs from time zero for ``duration`` [n] (whole segments; none where zero).

        Segments beyond it, which a query will ask for, are searched as far as the arcs reach.
        """
        longest = min(self.arcs.length, max(float(duration.max()) + self.ahead * self.segment, PLAN_STEP * COUNT))
        longest = max(longest, float(self.arcs.planned_from[rows].max()) + self.segment)
        start = torch.zeros_like(duration)
        ground = Ground(self.sight.ground(view, start, round(longest / PLAN_STEP) + 1), start)
        end = duration + torch.floor((longest - duration) / self.segment) * self.segment
        intervals = Intervals(start, torch.where(duration > 0.0, duration, self.segment), end, self.segment)
        for kind, places_of in self.kinds.items():
            search = Search(self.sight, ground, places_of(rows))
            found = generated(search, search.passes(), intervals)
            close, opens, place = tabulate(found.row, found.close, len(rows), found.open, found.place)
            self.store(kind, rows, Windows(opens, close, place))
        self.until[rows], self.ready[rows] = duration, end

    def store(self, kind: str, rows: Tensor, found: Windows) -> None:
        """Replace the windows of ``rows``."""
        self.windows[kind] = Windows(*(stored(table, rows, new) for table, new in zip(self.windows[kind], found, strict=True)))

    def next(
        self, kind: str, time: Tensor, width: int, allowed: Tensor | None = None, rows: Tensor | None = None
    ) -> tuple[Windows, Tensor]:
        """See :func:`next_of`; of all rows, ``time`` [N] and ``allowed`` [N, P], or of some ``rows`` [m] of them."""
        if rows is None:
            return next_of(self.windows[kind], time, self.until, width, allowed)
        windows = Windows(*(table[rows] for table in self.windows[kind]))
        return next_of(windows, time[rows], self.until[rows], width, None if allowed is None else allowed[rows])

    def reveal(
        self, kind: str, rows: Tensor, time: Tensor, count: Tensor, last: Tensor | None = None, allowed: Tensor | None = None
    ) -> Tensor:
        """Add as many segments as ``rows`` [m], which see too few, need to see ``count`` [m] windows ahead at ``time`` [m].

        No segment is added that would begin at ``last`` [m] s or later; ``allowed`` [m, P] says which places count.

        Returns:
            Those for which too few are ready, though more may be added.
        """
        windows = Windows(*(table[rows] for table in self.windows[kind]))
        all_ready = torch.full_like(time, torch.inf)
        ahead = seen(windows, time, all_ready, allowed).ahead
        enough, until = ahead.sum(1) >= count, self.until[rows]
        opens = torch.where(ahead, windows.open, torch.inf).sort(1).values
        opening = opens.gather(1, (count - 1).clamp(0, opens.shape[1] - 1).unsqueeze(-1)).squeeze(-1)
        # both the opening and the present must lie before the new end
        steps = torch.floor((torch.maximum(opening, time) - until) / self.segment) + 1.0
        most = torch.full_like(until, torch.inf) if last is None else torch.ceil((last - until) / self.segment).clamp(min=0.0)
        wanted = torch.where(enough, until + torch.minimum(steps.clamp(min=0.0), most) * self.segment, self.ready[rows])
        self.until[rows] = torch.minimum(wanted, until + most * self.segment)
        return rows[~enough & (self.until[rows] < until + most * self.segment)]

    def extend(self, rows: Tensor, time: Tensor) -> None:
        """Search more segments for ``rows``, as far as their arcs reach; windows that closed before ``time`` are forgotten."""
        self._search_on(rows, self.ahead, time[rows])

    def catch_up(self, rows: Tensor) -> None:
        """Search what the planned arcs of ``rows`` hold, before their first hour is forgotten."""
        started = self.arcs.et[rows] != 0.0
        behind = rows[started & (self.ready[rows] < self.arcs.planned_from[rows] + SPAN)]
        if len(behind):
            self._search_on(behind, 10**9, torch.zeros_like(self.ready[behind]))

    def _search_on(self, rows: Tensor, segments: int, time: Tensor) -> None:
        """Search at most so many segments of ``rows`` [n] on the planned arcs; windows that closed before ``time`` [n] go."""
        room = int(float((self.arcs.end[rows] - self.ready[rows]).min()) / self.segment)
        segments = min(segments, room)
        if segments <= 0:
            return
        view = View(self.arcs.planned_samples, self.arcs.sky_samples).of(rows)
        begin, samples = self.ready[rows], max(round(segments * self.segment / PLAN_STEP) + 1, COUNT)
        ground = Ground(self.sight.ground(view, begin, samples), begin)
        end = begin + segments * self.segment
        intervals = Intervals(begin, begin + self.segment, end, self.segment)
        for kind, places_of in self.kinds.items():
            search = Search(self.sight, ground, places_of(rows))
            new = generated(search, search.passes(), intervals)
            old = Windows(*(table[rows] for table in self.windows[kind]))
            past = old.close < torch.minimum(time, begin).unsqueeze(-1)  # one that closes at the beginning may be joined
            row, k = torch.nonzero(torch.isfinite(old.close) & ~past, as_tuple=True)
            kept = Passes(row, old.place[row, k], old.open[row, k], old.close[row, k])
            row, place, opens, closes = _joined(kept, new, begin)
            close, opens, place = tabulate(row, closes, len(rows), opens, place)
            self.store(kind, rows, Windows(opens, close, place))
        self.ready[rows] = end


def _joined(old: Passes, new: Passes, begin: Tensor) -> Passes:
    """Old and new windows, joined where an old one closes at ``begin`` [n] of its row and a new one of its place opens there."""
    ends = torch.nonzero(old.close == begin[old.row]).squeeze(-1)
    starts = torch.nonzero(new.open == begin[new.row]).squeeze(-1)
    most = 1 + int(torch.cat([old.place, new.place]).max()) if len(old.place) + len(new.place) else 1
    keys = [part.row[index] * most + part.place[index] for part, index in ((old, ends), (new, starts))]
    order = torch.argsort(keys[0])
    ends, key = ends[order], keys[0][order]
    at = torch.searchsorted(key, keys[1]).clamp(max=max(0, len(key) - 1))
    pairs = torch.nonzero(key[at] == keys[1]).squeeze(-1) if len(key) else at[:0]
    opens = new.open.index_copy(0, starts[pairs], old.open[ends[at[pairs]]])
    stays = torch.ones(len(old.row), dtype=torch.bool, device=begin.device)
    stays[ends[at[pairs]]] = False
    kept, new = Passes(*(part[stays] for part in old)), new._replace(open=opens)
    return Passes(*(torch.cat(parts) for parts in zip(kept, new, strict=True)))
