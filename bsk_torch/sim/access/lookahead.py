"""What lies ahead of satellites: their arcs, eclipses and access windows, extended as runs and queries need it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.element_sets import ElementSet
from bsk_torch.codegen.kernel import Samples
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.access.light.eclipses import SEARCH_STEP, SEARCHES, EclipseTable, search_range
from bsk_torch.sim.access.visibility.interface import Visibility
from bsk_torch.sim.access.visibility.planned import PlannedOrbits
from bsk_torch.sim.access.windows.search import BEFORE_SEARCH, BEHIND_SEARCH, MAX_SEGMENTS, AccessWindows
from bsk_torch.sim.access.windows.table import Windows
from bsk_torch.sim.orbit.arcs import PLANNED_SEGMENTS, REACH_AROUND, Arcs, segments_for
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, PLAN_STEP
from bsk_torch.sim.orbit.restartable import RestartableArcs
from bsk_torch.sim.orbit.sampled import SampledArcs
from bsk_torch.sim.orbit.solution import Solver
from bsk_torch.sim.places import Places
from bsk_torch.sim.state import StateTable, outside_inference

MARGIN = SEARCH_STEP * (SEARCHES - 1) + 2.0 * PLAN_STEP
"""Seconds that arcs reach beyond the requested time: the range of the search for eclipses."""

KEPT_PAST = ARC_SEGMENT  # seconds of the past that an arc keeps when it moves on

CHUNK, DEVICE_CHUNK = 256, 16384
"""Rows solved at once on the CPU, where they should fit into its cache, and on other devices, where memory bounds them."""

SEARCHED, DEVICE_SEARCHED = 1 << 18, 1 << 24  # pairs of satellite and place whose windows are searched at once, likewise


class LookAhead(StateTable):
    """Arcs, eclipses and windows of the satellites of one type."""

    arcs: Arcs  # where the satellites will be, or, where look-ahead follows no maneuver, would have been without any
    flight: Arcs  # where they will be; the same object unless look-ahead follows no maneuver
    eclipses: EclipseTable  # when they will be in the umbra
    access: AccessWindows | None  # when places will see them; None without places

    def __init__(
        self,
        num_envs: int,
        count: int,
        solver: Solver,
        visibility: Visibility,
        places: Mapping[str, Places],
        *,
        horizon: float,
        segment: float,
        compat: bool,
        maneuvers: bool = False,
        replans: bool = False,
        blind: bool = False,
        sampled: Sequence[ElementSet] = (),
    ) -> None:
        """Make room for ``count`` satellites in each of ``num_envs`` episodes.

        Windows are generated for ``horizon`` s at reset and extended by ``segment`` s. With ``compat``, eclipses are those of
        samples, and windows those of :class:`~bsk_torch.sim.access.windows.search.AccessWindows`. ``blind`` satellites may be
        on no orbit, so that queries raise a RuntimeError. Arcs of ``sampled`` satellites are those of their element sets. Arcs
        that ticks fly on follow ``maneuvers``, those of look-ahead only where it ``replans``.
        """
        super().__init__(num_envs, count, solver.device)
        self.blind, self.compat = blind, compat
        kept = max(PLANNED_SEGMENTS, segments_for(segment) + PLANNED_SEGMENTS - 1)
        spans = max(segments_for(horizon + MARGIN), segments_for(segment + BEFORE_SEARCH + BEHIND_SEARCH) + 1)
        size = num_envs, spans, solver, kept, count
        self.arcs = RestartableArcs(*size) if replans else Arcs(*size)
        if sampled:
            self.arcs = SampledArcs(*size, elements=sampled)
        separate = maneuvers and not replans
        self.flight = RestartableArcs(*size) if separate else self.arcs
        self.eclipses = EclipseTable(self.arcs, visibility)
        self.access = AccessWindows(self.arcs, visibility, places, segment, compat) if places else None
        self.add("arcs", self.arcs)
        self.add("eclipses", self.eclipses)
        if self.access is not None:
            self.add("windows", self.access)
        if separate:
            self.add("flight", self.flight)
        self.live = True
        self.all_offered = False  # whether the latest query saw as many windows in every row as it asked for

    # -- rows ---------------------------------------------------------------------------------------------------------

    def solve(self, rows: Tensor, et: Tensor, r_N: Tensor, v_N: Tensor, duration: Tensor) -> None:
        """Solve new arcs of ``rows`` [n] and search them for eclipses and windows of ``duration`` [n] s.

        ``et`` [n] is ET at time zero, s, ``r_N`` and ``v_N`` [n, 3] are position, m, and velocity, m/s, then.
        """
        if self.blind:
            v_N = _circling(r_N, v_N)
        while self.arcs.length < float(duration.max()) + BEHIND_SEARCH:
            self.grow()
        for part in torch.split(torch.arange(len(rows), device=self.device), self._rows_at_once(rows)):
            fine = self.arcs.solve(rows[part], et[part], r_N[part], v_N[part])
            if self.flight is not self.arcs:
                self.flight.copy_from(self.arcs, rows[part])
            epoch = torch.zeros(len(part), dtype=torch.float64, device=self.device)
            ephemeris = Samples(self.arcs.ephemeris[rows[part]], epoch)
            orbits = PlannedOrbits(Samples(fine, epoch), ephemeris)
            self.eclipses.search(rows[part], orbits, search_range(r_N[part], v_N[part]), duration[part])
            if self.access is not None:
                self.access.generate(rows[part], orbits, duration[part])

    @property
    def _searched(self) -> AccessWindows:
        assert self.access is not None
        return self.access

    def _rows_at_once(self, rows: Tensor) -> int:
        number, pairs = (CHUNK, SEARCHED) if self.device.type == "cpu" else (DEVICE_CHUNK, DEVICE_SEARCHED)
        places = 1 if self.access is None else max(kind.count for kind in self.access.kinds.values())
        return max(1, min(number, pairs // places))

    def check_time(self, path: str, time: Tensor) -> None:
        """Raise ValueError unless arcs, searched for eclipses and windows, cover the ``time`` [rows] s."""
        end, covers = self.arcs.end, "the arcs must reach from before the present to behind it"
        for name, arcs in (("arcs", self.arcs), ("flight", self.flight)):
            self.refuse(f"{path}lookahead.{name}.start", arcs.start, (arcs.start > time) | (arcs.end < time), covers)
        if self.flight.length != self.arcs.length:
            raise ValueError(
                f"'{path}lookahead.flight' of the saved state lasts {self.flight.length:g} s, 'arcs' {self.arcs.length:g} s"
            )
        last = torch.maximum(end, time + MARGIN) if self.arcs.restarts else end  # which are not always solved so far
        searched = [("eclipses", name, self.eclipses[name], last) for name in ("sampled", "known")]
        if self.access is not None:
            searched += [("windows", "ready", self.access.ready, end)]
            searched += [("windows", "until", self.access.until, self.arcs.start + self.arcs.length)]
        for table, name, value, bound in searched:
            self.refuse(f"{path}lookahead.{table}.{name}", value, value > bound, "it must lie before the end of the arcs")

    @override
    def over(self, saved: Mapping[str, object]) -> LookAhead:
        other = super().over(saved)
        tables: Mapping[str, Any] = other.tables
        other.arcs, other.eclipses, other.access = tables["arcs"], tables["eclipses"], tables.get("windows")
        other.flight = tables.get("flight", other.arcs)
        other.eclipses.arcs, other.live = other.arcs, False
        if other.access is not None:
            other.access.arcs = other.arcs
        return other

    def copy_rows(self, envs: Tensor, other: StateTable, source: Tensor) -> None:
        """See :meth:`StateTable.copy_rows`; the shorter arcs of the two are extended first."""
        assert isinstance(other, LookAhead)
        self.grow_to(other.arcs.length)
        other.grow_to(self.arcs.length)
        each = self.arcs, self.flight, other.arcs, other.flight
        most = max(arcs.planned.shape[1] for arcs in each)
        for arcs in each:
            arcs.keep(most)
        super().copy_rows(envs, other, source)

    # -- time ---------------------------------------------------------------------------------------------------------

    @outside_inference
    def reach(self, time: Tensor, now: Tensor) -> None:
        """Make every arc of look-ahead cover ``time`` [N] s; ``now`` [N] s is the present.

        Arcs move on, or all get longer where one would lose the past of the present.
        """
        self._reach(self.arcs, time, now)

    @property
    def _flown(self) -> tuple[Arcs, ...]:
        return (self.arcs,) if self.flight is self.arcs else (self.arcs, self.flight)

    def short_of(self, time: Tensor) -> list[Tensor]:
        """Return whether some arcs end before flights up to ``time`` [N] s do, for the arcs of look-ahead and those of flights.

        Ticks interpolate between nodes on both sides of the time, so arcs reach further.
        """
        return [(time + REACH_AROUND > arcs.end).any() for arcs in self._flown]

    def reach_in_flight(self, time: Tensor, now: Tensor, short: Sequence[object]) -> None:
        """Make the arcs that are ``short_of`` a ``time`` [N] s cover flights up to it; ``now`` [N] s is the present."""
        for arcs, lacks in zip(self._flown, short, strict=True):
            if lacks:
                self._reach(arcs, torch.where(time > now, time + REACH_AROUND, time), now)

    def _reach(self, arcs: Arcs, time: Tensor, now: Tensor) -> None:
        if bool((time <= arcs.end).all()):
            return
        missing = torch.ceil((time - arcs.end) / ARC_SEGMENT).clamp(min=0)
        movable = torch.floor((now - KEPT_PAST - arcs.start) / ARC_SEGMENT).clamp(min=0)
        longer = int((missing - arcs.room - movable).max().clamp(min=0))
        for _ in range(longer):
            self.grow()
        missing = torch.ceil((time - arcs.end) / ARC_SEGMENT).clamp(min=0)
        for spans in range(1, int(missing.max()) + 1):
            rows = torch.nonzero(missing >= spans).squeeze(-1)
            if arcs is not self.arcs:
                arcs.extend(rows)
                continue
            if self.access is not None:
                self.access.catch_up(rows)
            arcs.extend(rows)
            self.eclipses.lengthen(rows)

    @outside_inference
    def grow_to(self, length: float) -> None:
        """Make every arc at least ``length`` s long."""
        while self.arcs.length < length:
            self.grow()

    def grow(self) -> None:
        """Make every arc an hour longer; those that may restart get room only."""
        for arcs in self._flown:
            arcs.grow()
        if not self.arcs.restarts:
            self.eclipses.lengthen(self.all_rows)

    # -- maneuvers ---------------------------------------------------------------------------------------------------

    @property
    def follows(self) -> bool:
        """Whether any arcs follow maneuvers."""
        return self.flight.restarts

    def state_at(self, rows: Tensor, now: Tensor) -> tuple[Tensor, Tensor]:
        """Return position, m, and velocity, m/s, in N, [n, 3], of ``rows`` [n] in flight at the current time ``now`` [N] s."""
        self._reach(self.flight, now + REACH_AROUND, now)
        assert isinstance(self.flight, RestartableArcs)
        return self.flight.state_at(rows, now[rows])

    def restart(self, rows: Tensor, now: Tensor, r_N: Tensor, v_N: Tensor) -> None:
        """Let new orbits of ``rows`` [n] begin at the current time ``now`` [N] s, with r_N, m, and v_N, m/s, [n, 3] in N.

        What lies ahead on the old ones is dropped. Eclipses of the first hour are searched now, windows as queries need them.
        """
        if self.arcs.restarts and self.access is not None:
            self._search_to(rows, now[rows], now)  # which passes are in progress
            self.access.restart(rows, now[rows])
        assert isinstance(self.flight, RestartableArcs)
        for part in torch.split(torch.arange(len(rows), device=self.device), self._rows_at_once(rows)):
            some = rows[part]
            self.flight.restart(some, now[some], r_N[part], v_N[part])
        if self.arcs.restarts:
            self.eclipses.restart(rows, search_range(r_N, v_N))

    def _search_to(self, rows: Tensor, time: Tensor, now: Tensor) -> None:
        """Search windows of ``rows`` [n] up to ``time`` [n] s at least; ``now`` [N] s is the present."""
        access = self._searched
        while bool((behind := access.ready[rows] < time).any()):
            rows, time = rows[behind], time[behind]
            self._search_further(rows, now)

    def _search_further(self, rows: Tensor, now: Tensor) -> None:
        """Search as many segments more of ``rows`` [n] as are searched at once."""
        access = self._searched
        target = torch.zeros_like(now)
        target[rows] = access.ready[rows] + access.ahead * access.segment + BEFORE_SEARCH + BEHIND_SEARCH
        self.reach(target, now)
        for part in torch.split(rows, self._rows_at_once(rows)):
            access.extend(part, now)

    def search_visible(self, now: Tensor) -> None:
        """Search all windows that queries see, after maneuvers, too; ``now`` [N] s is the present."""
        if self.arcs.restarts and self.access is not None:
            self._search_to(self.all_rows, self.access.until, now)

    def insert(self, kind: str, rows: Tensor, place: Tensor, now: Tensor) -> None:
        """Add the windows of places that appear at the current time ``now`` [N] s; see :meth:`AccessWindows.insert`."""
        reach = self._searched.ready[rows] + (BEHIND_SEARCH + REACH_AROUND)
        self.reach(torch.zeros_like(now).index_copy(0, rows, reach), now)
        for part in torch.split(torch.arange(len(rows), device=self.device), CHUNK):
            some = rows[part]
            self._searched.insert(kind, some, place[part], now[some])

    # -- queries ------------------------------------------------------------------------------------------------------

    @outside_inference
    def next_eclipse(self, time: Tensor, sampled: bool = False) -> tuple[Tensor, Tensor]:
        """Return the next start and end of an eclipse after ``time`` [N], [N] s since reset.

        See :meth:`EclipseTable.next`, or, for answers on samples, which depend on what was asked before,
        :meth:`EclipseTable.query`.
        """
        self._check_sight()
        if not (sampled or self.compat):
            start, end = self.eclipses.next(time)
            while bool((short := self.eclipses.missing(time, start, end)).any()):
                self.reach(torch.where(short, self.arcs.end + ARC_SEGMENT, 0.0), time)  # an hour after the other
                start, end = self.eclipses.next(time)
            return start, end
        if not self.arcs.restarts:
            eclipse = self.eclipses.query_if_covered(time)
            if eclipse is not None:
                return eclipse
            self.reach(self.eclipses.needs(time), time)
            return self.eclipses.query(time)
        needs = self.eclipses.needs(time)
        while bool((short := self.eclipses.unknown(time) & (self.arcs.end < needs)).any()):
            # an hour after the other, until both are found
            further = torch.minimum(needs, self.arcs.end + ARC_SEGMENT)
            self.reach(torch.where(short, further, 0.0), time)
        return self.eclipses.query(time)

    @outside_inference
    def next_windows(
        self,
        kind: str,
        time: Tensor,
        width: int,
        allowed: Tensor | None = None,
        count: Tensor | None = None,
        last: Tensor | None = None,
        may_see_nothing: bool = False,
    ) -> tuple[Windows, Tensor]:
        """Return the windows over a kind of places that close next, [N, width], and how many of them there are, [N].

        The last is repeated where there are fewer. Segments are added until ``count`` windows are known.

        Args:
            kind: A key of ``access.kinds``.
            time: Present time, [N] s since reset.
            width: Number of windows.
            allowed: Which places count, [N, P]; all of them by default.
            count: Number of windows that each row needs, [N], at most ``width``, which it is by default.
            last: Time, [N] s, from which on no segments are added; in any case no more than
                :data:`~bsk_torch.sim.access.windows.search.MAX_SEGMENTS` are.
            may_see_nothing: Whether there may be none at all; look-ahead then ends as many segments from now, so that queries in
                vain do not add segments again and again.

        Raises:
            RuntimeError: If a window is needed, there is none within the look-ahead, and there must be one.
        """
        access = self._searched
        self._check_sight()
        if self.arcs.restarts:
            wanted = torch.full(time.shape, width, device=self.device) if count is None else count
            self._search_certain(kind, time, torch.where(wanted > 0, wanted.clamp(min=width), 0), allowed)
        windows, offered = access.next(kind, time, width, allowed)
        few = offered < (width if count is None else count)
        self.all_offered = not bool(few.any())
        if self.all_offered:
            return windows, offered
        short, wanted = torch.nonzero(few).squeeze(-1), torch.full_like(offered, width) if count is None else count
        # a step may have been longer than all searched before it
        begin = time if may_see_nothing else torch.maximum(access.until, time)
        limit = begin + MAX_SEGMENTS * access.segment
        limit = limit if last is None else torch.minimum(limit, last)
        # what the last segment of a query adds is not looked at; the next query does
        looked = limit if may_see_nothing else torch.minimum(limit, begin + (MAX_SEGMENTS - 1) * access.segment)
        self._reveal(kind, short, time, wanted, looked, allowed)
        more, number = access.next(kind, time, width, allowed, short)
        self._reveal(kind, short[number < wanted[short]], time, wanted, limit, allowed)
        self.eclipses.sample_to(access.until)
        windows, offered = windows.put(short, more), offered.index_copy(0, short, number)
        none = [] if may_see_nothing else torch.nonzero((offered == 0) & (wanted > 0)).squeeze(-1).tolist()
        if none:
            envs, seconds = list(dict.fromkeys(row // self.count for row in none))[:5], MAX_SEGMENTS * access.segment
            raise RuntimeError(
                f"no {kind} comes into view of environments {envs} within {seconds:g} s; {access.kinds[kind].advice}, or build "
                "the satellite with may_see_nothing=True"
            )
        return windows, offered

    def _reveal(self, kind: str, rows: Tensor, time: Tensor, wanted: Tensor, last: Tensor, allowed: Tensor | None) -> None:
        """Let ``rows`` [m] see as many windows as are ``wanted`` [N], with segments that begin before ``last`` [N] s."""
        access = self._searched
        while len(rows):
            some = None if allowed is None else allowed[rows]
            rows = access.reveal(kind, rows, time[rows], wanted[rows], last[rows], some)
            if len(rows):
                self._search_further(rows, time)

    def _search_certain(self, kind: str, time: Tensor, wanted: Tensor, allowed: Tensor | None) -> None:
        """Search on, where a maneuver has undone the search, until as many windows as are ``wanted`` [N] are certain.

        Windows that close before the end of the search do so before all that have not been found yet. So queries see the same as
        if all had been searched again at the maneuver.
        """
        access = self._searched
        rows = torch.nonzero(access.ready < access.until).squeeze(-1)
        while len(rows):
            rows = access.uncertain(kind, rows, time[rows], wanted[rows], None if allowed is None else allowed[rows])
            if len(rows):
                self._search_further(rows, time)

    @outside_inference
    def generate_until(self, until: Tensor, now: Tensor) -> bool:
        """Let queries see all windows that open before ``until`` [N] s: whole segments are added, of all kinds of places.

        ``now`` [N] s is the present. Rows that see so far already are left alone. Return whether any sees more than before.
        """
        access = self._searched
        self._check_sight()
        self.search_visible(now)
        steps = torch.ceil((until - access.until) / access.segment).clamp(min=0.0)
        if not bool((steps > 0.0).any()):
            return False
        end = access.until + steps * access.segment
        while len(behind := torch.nonzero(access.ready < end).squeeze(-1)):
            self._search_further(behind, now)
        further = torch.nonzero(steps > 0.0).squeeze(-1)
        access.until = end
        access.drop_short(further)
        self.eclipses.sample_to(end)
        return True

    def _check_sight(self) -> None:
        if self.blind:
            raise RuntimeError("orbit='free' predicts nothing: windows and eclipses need orbit='arc' or orbit='integrated'")


def _circling(r_N: Tensor, v_N: Tensor) -> Tensor:
    """Return velocities, [n, 3] m/s in N, of circular orbits through positions, [n, 3] m, near the directions of ``v_N``.

    Arcs of satellites that may be on no orbit are solved with these: they serve for the Sun and the Earth only.
    """
    along = torch.linalg.cross(torch.linalg.cross(r_N, v_N), r_N)
    axis = torch.eye(3, dtype=r_N.dtype, device=r_N.device)[r_N.abs().argmin(-1)]
    along = torch.where(along.norm(dim=-1, keepdim=True) > 1.0, along, torch.linalg.cross(r_N, axis))
    return along / along.norm(dim=-1, keepdim=True) * torch.sqrt(MU_EARTH / r_N.norm(dim=-1, keepdim=True))
