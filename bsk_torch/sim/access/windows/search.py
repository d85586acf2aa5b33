"""Access windows, kept up to date: generated at reset, extended when a query runs out of them.

Windows are found on the planned trajectory, and queries see them for an interval at a time: once at reset for the
whole episode, later in segments of ten minutes. A window that is open at the end of what is seen is closed there, until more is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import BEFORE, COUNT
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.access.light.light import in_light
from bsk_torch.sim.access.passes.passes import GroundTrack, Passes, PassSearch
from bsk_torch.sim.access.passes.requested import long_enough, request_passes
from bsk_torch.sim.access.passes.sampled_passes import find_passes
from bsk_torch.sim.access.visibility.interface import Visibility
from bsk_torch.sim.access.visibility.planned import PlannedOrbits, halved, take_rows
from bsk_torch.sim.access.windows.generation import GenerationIntervals, true_windows, windows_by_interval
from bsk_torch.sim.access.windows.next_windows import next_windows
from bsk_torch.sim.access.windows.padded import tabulate
from bsk_torch.sim.access.windows.table import Windows, candidates, join_at, next_to_close
from bsk_torch.sim.hooks import check_tensor
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, PLAN_STEP
from bsk_torch.sim.places import FixedPlaces, Places
from bsk_torch.sim.places.requested import RequestPlaces
from bsk_torch.sim.state import StateTable

MAX_SEGMENTS = 100  # segments that a query may add before it gives up
SEARCH_AHEAD = 10800.0  # maximum time, s, searched at once beyond the range of queries; see AccessWindows.expect

BEFORE_SEARCH, BEHIND_SEARCH = (BEFORE + 2) * PLAN_STEP, (COUNT - BEFORE) * PLAN_STEP
"""Seconds of the ground track around an interval of the search: with them, what is found in it does not depend on its ends.

A crossing is interpolated between :data:`~bsk_torch.astro.interpolate.COUNT` samples, and a short pass is searched for between a
sample's two neighbors.
"""

PASSES_PER_SECOND = 1.2e-5  # typical rate of passes of a low orbit over one place, 1/s


class WindowState(StateTable):
    """Windows [N, W] over the places of one kind, see :class:`~bsk_torch.sim.access.windows.table.Windows`."""

    open: Tensor
    close: Tensor
    place: Tensor

    def __init__(self, num_envs: int, count: int, device: torch.device) -> None:
        super().__init__(num_envs, count, device)
        self.declare("open", math.inf, 1, grows=True, low=0.0)
        self.declare("close", math.inf, 1, grows=True, low=0.0)
        self.declare("place", 0, 1, grows=True, low=0)

    def check_relations(self, path: str) -> None:
        """See :meth:`StateTable.check_relations`: columns of windows sorted by closing time."""
        widths = {name: self[name].shape[1] for name in self}
        if len({*widths.values()}) > 1 or self.close.shape[1] < 1:
            raise ValueError(f"'{path}*' of the saved state have {widths} columns; they must have equally many, at least one")
        self.refuse(f"{path}close", self.close[:, 1:], self.close[:, 1:] < self.close[:, :-1], "they must be sorted")
        self.refuse(f"{path}open", self.open, self.open > self.close, "a window must open before it closes")


class AccessWindows(StateTable):
    """Windows of N satellites over several kinds of places.

    Searching is batched: windows are searched far ahead, up to ``ready`` [N] s, but queries see only those up to ``until`` [N] s,
    with windows in progress cut there, as if they had been generated only so far. Queries add ``segment`` s, of which ``ahead``
    are searched at once. With ``compat``, windows are those of a search by intervals, with its errors.
    """

    until: Tensor  # end of what queries see, [N] s
    ready: Tensor  # end of what has been searched, [N] s

    def __init__(
        self, arcs: Arcs, visibility: Visibility, kinds: Mapping[str, Places], segment: float, compat: bool = False
    ) -> None:
        super().__init__(arcs.num_envs, arcs.count, arcs.device)
        self.arcs, self.visibility, self.kinds, self.segment = arcs, visibility, dict(kinds), segment
        self.compat = compat
        self.declare("until", 0.0, low=0.0)
        self.declare("ready", 0.0, low=0.0)
        for kind in kinds:
            self.add(kind, WindowState(self.num_envs, self.count, self.device))
        self.ahead, self._expected = max(1, round(SEARCH_AHEAD / segment)), 0.0

    def check_relations(self, path: str) -> None:
        """See :meth:`StateTable.check_relations`: windows over places that exist."""
        for kind, places in self.kinds.items():
            count, place = places.count, self.tables[kind]["place"]
            self.refuse(f"{path}{kind}.place", place, place >= count, f"there are {count} places")
            close = self.tables[kind]["close"]
            late = torch.isfinite(close) & (close > self.ready.unsqueeze(-1))
            self.refuse(f"{path}{kind}.close", close, late, "it must lie before 'ready', the end of what has been searched")

    @property
    def windows(self) -> dict[str, Windows]:
        """Tables of windows by kind."""
        return {kind: self._windows_of(kind) for kind in self.kinds}

    def _windows_of(self, kind: str) -> Windows:
        table = self.tables[kind]
        return Windows(table.open, table.close, table.place)

    def expect(self, count: int, places: int) -> None:
        """Announce queries for ``count`` windows over ``places`` places, which sets how far ahead is searched.

        One and a half times the mean time in which so many passes occur, and at least three segments, is searched at once:
        farther than most queries need, but not much farther. One segment is enough for orbits that maneuvers may change, after
        which all is searched again.
        """
        least = self.segment if self.arcs.restarts else 3.0 * self.segment
        self._expected = max(self._expected, least, 1.5 * count / (PASSES_PER_SECOND * places))
        self.ahead = max(1, round(min(SEARCH_AHEAD, self._expected) / self.segment))

    def generate(self, rows: Tensor, orbits: PlannedOrbits, duration: Tensor) -> None:
        """Generate windows of ``rows`` [n], which were reset, on new planned orbits from time zero on.

        They are generated for ``duration`` [n] s, whole segments; 0 for none. Segments beyond are searched as far as the arcs
        reach: queries will ask for them.
        """
        longest = min(self.arcs.length - BEHIND_SEARCH, float(duration.max()) + self.ahead * self.segment)
        longest = max(longest, float(self.arcs.planned_from[rows].max()) + self.segment + BEFORE_SEARCH)
        start = torch.zeros_like(duration)
        samples = math.ceil((longest + BEHIND_SEARCH) / PLAN_STEP) + 1
        track = GroundTrack(self.visibility.ground_track(orbits, start, samples), start)
        end = duration + torch.floor((longest - duration) / self.segment).clamp(min=0.0) * self.segment
        intervals = GenerationIntervals(start, torch.where(duration > 0.0, duration, self.segment), end, self.segment)
        for kind in self.kinds:
            self._store_windows(kind, rows, self._generate(kind, rows, track, intervals, duration), duration)
        self.until[rows], self.ready[rows] = duration, end

    def next(
        self, kind: str, time: Tensor, width: int, allowed: Tensor | None = None, rows: Tensor | None = None
    ) -> tuple[Windows, Tensor]:
        """Return the windows that close next; see :func:`~bsk_torch.sim.access.windows.table.next_to_close`.

        ``time`` [N] and ``allowed`` [N, P] belong to all rows; the answer is that of ``rows`` [m], or of all. TypeError for an
        ``allowed`` of another shape or type: the kernel does not look for places beyond it.
        """
        if allowed is not None:
            check_tensor(f"what filters allow of {kind!r}", allowed, (len(time), self.kinds[kind].count), torch.bool)
        if self.visibility.kernels:
            return next_windows(self._windows_of(kind), time, self.until, width, allowed, rows)
        if rows is None:
            return next_to_close(self._windows_of(kind), time, self.until, width, allowed)
        windows = self._windows_of(kind).take(rows)
        return next_to_close(windows, time[rows], self.until[rows], width, None if allowed is None else allowed[rows])

    def reveal(
        self, kind: str, rows: Tensor, time: Tensor, count: Tensor, last: Tensor | None = None, allowed: Tensor | None = None
    ) -> Tensor:
        """Extend what queries see by as many searched segments as needed to see ``count`` [m] windows.

        ``rows`` [m] see too few at the ``time`` [m] s of a query; places that are ``allowed`` [m, P] count (default: all). No
        segment may begin from ``last`` [m] s on. Return the rows for which the searched segments are not enough though more may
        be added.
        """
        windows = self._windows_of(kind).take(rows)
        valid = candidates(windows, time, torch.full_like(time, torch.inf), allowed).valid
        enough, until = valid.sum(1) >= count, self.until[rows]
        opens = torch.where(valid, windows.open, torch.inf).sort(1).values
        opening = opens.gather(1, (count - 1).clamp(0, opens.shape[1] - 1).unsqueeze(-1)).squeeze(-1)
        # both the opening and the present must lie before the new end
        steps = torch.floor((torch.maximum(opening, time) - until) / self.segment) + 1.0
        most = torch.full_like(until, torch.inf) if last is None else torch.ceil((last - until) / self.segment).clamp(min=0.0)
        wanted = torch.where(enough, until + torch.minimum(steps.clamp(min=0.0), most) * self.segment, self.ready[rows])
        self.until[rows] = torch.minimum(wanted, until + most * self.segment)
        self.drop_short(rows[self.until[rows] > until])
        return rows[~enough & (self.until[rows] < until + most * self.segment)]

    def restart(self, rows: Tensor, time: Tensor) -> None:
        """Drop the windows of ``rows`` [n] that lie ahead of ``time`` [n] s, a maneuver, up to which all has been searched.

        Of windows that are open then the beginning is kept: the search from there on joins it to what follows.
        """
        for kind in self.kinds:
            old = self._windows_of(kind).take(rows)
            now = time.unsqueeze(-1)
            row, k = torch.nonzero((old.open < now) & (old.close >= now) & torch.isfinite(old.close), as_tuple=True)
            self._store_passes(kind, rows, Passes(row, old.place[row, k], old.open[row, k], time[row]))
        self.ready[rows] = time

    def uncertain(self, kind: str, rows: Tensor, time: Tensor, count: Tensor, allowed: Tensor | None = None) -> Tensor:
        """Return those of ``rows`` [m] in which fewer than ``count`` [m] of the windows that queries see are certain.

        Certain are windows that close before the end of the search. Rows ascend; ``time`` [m] s is that of the query, and
        places that are ``allowed`` [m, P] count (default: all).
        """
        until, ready = self.until[rows], self.ready[rows]
        windows = self._windows_of(kind)
        if len(rows) < len(windows.close):  # rows ascend
            windows = windows.take(rows)
        certain = candidates(windows, time, until, allowed).valid & (windows.close < ready.unsqueeze(-1))
        return rows[(certain.sum(1) < count) & (ready < until)]

    def extend(self, rows: Tensor, time: Tensor) -> None:
        """Search more segments of ``rows``, as far as their arcs reach; drop windows that closed before ``time`` [N] s."""
        self._search_on(rows, self.ahead, time[rows])

    def catch_up(self, rows: Tensor) -> None:
        """Search all that the planned arcs of ``rows`` hold, before their first hour is dropped; forget what closed before."""
        started = self.arcs.et[rows] != 0.0
        behind = rows[started & (self.ready[rows] - BEFORE_SEARCH < self.arcs.planned_from[rows] + ARC_SEGMENT)]
        if len(behind):
            self._search_on(behind, 10**9, self.arcs.start[behind])

    def _search_on(self, rows: Tensor, segments: int, time: Tensor) -> None:
        """Search at most so many segments of ``rows`` [n]; drop windows that closed before ``time`` [n] s."""
        begin, begun = self.ready[rows], self.arcs.begun
        room = int((float((self.arcs.end[rows] - begin).min()) - BEFORE_SEARCH - BEHIND_SEARCH) / self.segment)
        segments = min(segments, room)
        if segments <= 0:
            return
        orbits = PlannedOrbits(self.arcs.planned_samples, self.arcs.ephemeris_samples).take(rows)
        start = torch.maximum(begin - BEFORE_SEARCH, begun[rows] if isinstance(begun, Tensor) else torch.zeros_like(begin))
        samples = round((segments * self.segment + BEFORE_SEARCH + BEHIND_SEARCH) / PLAN_STEP) + 1
        track = GroundTrack(self.visibility.ground_track(orbits, start, samples), start)
        end = begin + segments * self.segment
        intervals = GenerationIntervals(begin, begin + self.segment, end, self.segment)
        until = torch.minimum(self.until[rows], end)
        for kind in self.kinds:
            new = self._generate(kind, rows, track, intervals, until)
            old = self._windows_of(kind).take(rows)
            past = old.close < torch.minimum(time, begin).unsqueeze(-1)  # one that closes at the beginning may be joined
            row, k = torch.nonzero(torch.isfinite(old.close) & ~past, as_tuple=True)
            kept = Passes(row, old.place[row, k], old.open[row, k], old.close[row, k])
            self._store_windows(kind, rows, join_at(kept, new, begin), until)
        self.ready[rows] = end

    def insert(self, kind: str, rows: Tensor, place: Tensor, time: Tensor) -> None:
        """Add the windows of requests that appear at ``time`` [n] s: of ``rows`` [n], over places [n, K] without windows yet.

        They are searched on the flown arcs, up to where those of all other places are. Planned arcs, meters away, are kept for
        the last hours only. Windows in progress begin at the release of the request, which is not before ``time``. Arcs reach
        beyond the search as far as interpolation does.
        """
        origin, end = self.arcs.start[rows], self.ready[rows]
        first = origin + (torch.floor((time - BEFORE_SEARCH - origin) / PLAN_STEP) * PLAN_STEP).clamp(min=0.0)
        samples = torch.ceil((end - first + BEHIND_SEARCH) / PLAN_STEP).long() + 1
        ahead = end > time
        if self.arcs.restarts:  # they end at different times: tracks of equal length are searched together
            parts = [(samples == count) & ahead for count in samples[ahead].unique().tolist()]
        else:
            parts = [ahead] if bool(ahead.any()) else []
        for some in parts:
            count, part = int(samples[some].max()), rows[some]
            # all tracks are as long, and none reaches beyond its arc
            start = torch.minimum(first[some], self.arcs.end[part] - PLAN_STEP * (count - 1))
            flown = Samples(halved(self.arcs.flown[part]), self.arcs.start[part] - 0.5 * PLAN_STEP)
            orbits = PlannedOrbits(flown, take_rows(self.arcs.ephemeris_samples, part))
            self._insert(kind, part, place[some], GroundTrack(self.visibility.ground_track(orbits, start, count), start))

    def _insert(self, kind: str, rows: Tensor, place: Tensor, track: GroundTrack) -> None:
        places, end = self.kinds[kind], self.ready[rows]
        assert isinstance(places, RequestPlaces)
        span = track.start, self.until[rows]
        found = in_light(places, rows, request_passes(places, rows, track, self.visibility, span, place))
        new = true_windows(track, found, GenerationIntervals(track.start, end, end, self.segment))
        found = Passes(*(torch.cat(parts) for parts in zip(self._passes_of(kind, rows), new, strict=True)))
        self._store_windows(kind, rows, found, self.until[rows])

    def _generate(self, kind: str, rows: Tensor, track: GroundTrack, intervals: GenerationIntervals, until: Tensor) -> Passes:
        """Return the windows of ``rows`` [n] over one kind of places; searches by intervals know fixed ones only.

        Short windows that close before ``until`` [n] s may lack.
        """
        places = self.kinds[kind]
        if not isinstance(places, FixedPlaces):
            return true_windows(track, find_passes(places, rows, track), intervals)
        if isinstance(places, RequestPlaces):
            found = request_passes(places, rows, track, self.visibility, (intervals.begin, until))
            return true_windows(track, in_light(places, rows, found), intervals)
        if places.clearances:
            return true_windows(track, in_light(places, rows, find_passes(places, rows, track)), intervals)
        search = PassSearch(self.visibility, track, places.sites(rows))
        passes = search.passes()
        if self.compat and not places.light:
            return windows_by_interval(search, passes, intervals)
        return true_windows(track, in_light(places, rows, passes), intervals)

    def drop_short(self, rows: Tensor) -> None:
        """Drop windows of ``rows`` [n] that are shorter than the looks of their requests, once queries see them whole.

        Before, they are kept: how much more of them has been searched depends on other rows.
        """
        for kind, places in self.kinds.items():
            if isinstance(places, RequestPlaces) and len(rows):
                self._store_windows(kind, rows, self._passes_of(kind, rows), self.until[rows])

    def _passes_of(self, kind: str, rows: Tensor) -> Passes:
        table = self._windows_of(kind).take(rows)
        row, k = torch.nonzero(torch.isfinite(table.close), as_tuple=True)
        return Passes(row, table.place[row, k], table.open[row, k], table.close[row, k])

    def _store_windows(self, kind: str, rows: Tensor, found: Passes, until: Tensor) -> None:
        """Store windows of ``rows`` [n], but short ones that close before ``until`` [n] s, up to which queries see."""
        places = self.kinds[kind]
        self._store_passes(kind, rows, long_enough(places, rows, found, until) if isinstance(places, RequestPlaces) else found)

    def _store_passes(self, kind: str, rows: Tensor, found: Passes) -> None:
        close, opens, place = tabulate(found.row, found.close, len(rows), found.open, found.place)
        for name, new in {"open": opens, "close": close, "place": place}.items():
            self.tables[kind].write_rows(name, rows, new)
