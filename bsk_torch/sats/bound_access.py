"""Queries for the access windows of satellites in an environment."""

from __future__ import annotations

from collections.abc import Collection
from typing import cast

import torch
from torch import Tensor

from bsk_torch.sats.access import AccessSatellite
from bsk_torch.sats.access_filter import Filter, make_filter
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.sats.opportunities import Opportunities, TargetObjects, place_names
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.access.links.relative_geometry import SATELLITE_PROPERTIES, relative_geometries
from bsk_torch.sim.access.windows.search import MAX_SEGMENTS, AccessWindows
from bsk_torch.sim.access.windows.table import Windows, candidates
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.sim.dyn.axes import unit_rows
from bsk_torch.sim.places import TARGET_KIND, is_target
from bsk_torch.sim.readout.observables import Function, observable


class BoundAccessSatellite(BoundSatellite, AccessSatellite):
    """The access satellites of one type in an environment, with their current and future windows.

    Attributes:
        access_windows: Windows of their places; None without ``opportunity_types``.
    """

    access_windows: AccessWindows

    def _join(self, fleet: SatelliteFleet, type_index: int) -> None:
        super()._join(fleet, type_index)
        self.access_windows = cast(AccessWindows, self.simulator.access)
        self.access_filters = [access_filter.bound(self.opportunity_types) for access_filter in self.access_filters]
        self._cache: dict[tuple[str, int], tuple[tuple[int, int], Opportunities, bool]] = {}
        self._lists: dict[tuple[str, bool], tuple[tuple[int, int], Windows]] = {}
        models = self.dynamics, self.fsw
        self._geometry = [[model for model in models if hasattr(type(model), name)][:1] for name in SATELLITE_PROPERTIES]
        pairs = zip(self._geometry, SATELLITE_PROPERTIES, strict=True)
        members = [getattr(type(owner), name) for owners, name in pairs for owner in owners]
        observed = tuple(member.function for member in members if isinstance(member, observable))
        self._observed_geometry: tuple[Function, ...] = observed if len(observed) == len(SATELLITE_PROPERTIES) else ()
        self._aims: tuple[Opportunities, tuple[int, int | None], Tensor] | None = None

    @property
    def opportunity_types(self) -> tuple[str, ...]:
        """Kinds of opportunities that the satellites have."""
        access = self.simulator.lookahead.access
        return () if access is None else tuple(access.kinds)

    def add_access_filter(
        self, access_filter_fn: Filter, types: str | Collection[str] | None = None, prepend: bool = False, type: str | None = None
    ) -> None:
        """See :meth:`AccessSatellite.add_access_filter`; queries of the current time are asked again."""
        super().add_access_filter(access_filter_fn, types, prepend, type)
        self.memory.touch()

    def allowed(self, type: str) -> Tensor | None:
        """Return a mask of the places of a type that pass all filters, [N, P]; None for all."""
        parts = [access_filter(self, type) for access_filter in self.access_filters if access_filter.concerns(type)]
        for part in parts[1:]:
            parts[0] = parts[0] & part
        return parts[0] if parts else None

    def default_access_filter(self, opportunity: Opportunities) -> Tensor:
        """Return which opportunities [N, n] pass all filters."""
        allowed = self.allowed(opportunity.type)
        return torch.ones_like(opportunity.place, dtype=torch.bool) if allowed is None else allowed.gather(1, opportunity.place)

    @property
    def functions(self) -> list[UserFunction]:
        """See :attr:`BoundSatellite.functions`; those of filters."""
        return [
            *super().functions,
            *(function for access_filter in self.access_filters for function in access_filter.functions.values()),
        ]

    def find_next_opportunities(
        self,
        n: int,
        type: str | None = None,
        count: Tensor | None = None,
        *,
        pad: bool = True,
        max_lookahead: int = MAX_SEGMENTS,
        types: str | Collection[str] | None = None,
        filter: Filter | Collection[int] | None = None,
        may_see_nothing: bool | None = None,
    ) -> Opportunities:
        """Return the ``n`` opportunities that close next, including those in progress; the last repeated if fewer.

        If fewer than ``count`` [N] are known, look-ahead is extended. With ``may_see_nothing``, place 0 opens and closes now if
        none is found within a hundred segments.

        Args:
            n: Number of opportunities.
            type: Type of the opportunities (default: ``"target"``).
            count: Number of opportunities needed in each row, [N] (default: ``n``).
            pad: Whether to repeat the last opportunity if there are fewer.
            max_lookahead: Maximum number of segments by which look-ahead is extended, up to 100.
            types: The same as ``type``; one type at a time.
            filter: Filter to use instead of the satellite's, as for :meth:`add_access_filter`; or indices of excluded places.
            may_see_nothing: Whether there may be none (default: as for the satellite).

        Raises:
            RuntimeError: If none is found within a hundred segments, without ``may_see_nothing``; or fewer than ``n``, without
                ``pad``.
            ValueError: For an unknown type or several, a number of opportunities below 1, or a ``max_lookahead`` above 100.
        """
        kind = self._kind(type, types)
        if n < 1:
            raise ValueError(f"n={n} opportunities: there must be at least 1")
        plain = filter is None and max_lookahead == MAX_SEGMENTS
        may_see_nothing = self.may_see_nothing if may_see_nothing is None else may_see_nothing
        now = self.simulator.state.version, self.memory.version
        entry = self._cache.get((kind, n)) if plain else None
        if entry is not None and entry[0] == now and (count is None or entry[2] or bool((entry[1].found >= count).all())):
            return entry[1] if pad else self._complete(entry[1])
        wanted, simulator = count, self.simulator
        if self.fleet.state.some_removed:
            wanted = torch.where(self.rows_of(self.fleet.state.removed), 0, n if count is None else count)
        windows, counts = simulator.lookahead.next_windows(
            kind,
            simulator.state.sim_time,
            n,
            self.allowed(kind) if filter is None else self._accepted(filter, kind),
            wanted,
            self._last_generation(max_lookahead),
            may_see_nothing,
        )
        complete = wanted is None and simulator.lookahead.all_offered
        if may_see_nothing and not complete:  # then place 0 opens and closes now
            none, instant = (counts == 0).unsqueeze(-1), simulator.state.sim_time.unsqueeze(-1)
            opens, close = torch.where(none, instant, windows.open), torch.where(none, instant, windows.close)
            windows = Windows(opens, close, windows.place.masked_fill(none, 0))
        opportunities = Opportunities(*windows, self.positions(kind, windows.place), counts).of(self, kind)
        if count is None and plain and may_see_nothing == self.may_see_nothing:
            self._cache[(kind, n)] = now, opportunities, complete
        return opportunities if pad else self._complete(opportunities)

    def _accepted(self, filter: object, kind: str) -> Tensor:
        """Return the places [N, P] that pass a filter of a query, or are not among the indices that it excludes."""
        if callable(filter):
            return make_filter(filter, kind)(self, kind)
        if not isinstance(filter, Collection) or not all(isinstance(place, int) for place in filter):
            raise TypeError(f"filter={filter!r} must be a function, or indices of places such as opportunity['object'].id")
        accepted = torch.ones(len(self.simulator.ticks), self.places(kind), dtype=torch.bool, device=self.simulator.device)
        accepted[:, list(filter)] = False
        return accepted

    def _complete(self, opportunities: Opportunities) -> Opportunities:
        n = opportunities.place.shape[1]
        if bool((opportunities.found < n).any()):
            row = int((opportunities.found < n).nonzero()[0])
            raise RuntimeError(f"{int(opportunities.found[row])} of {n} opportunities found for {self.title(row)}, and pad=False")
        return opportunities

    def positions(self, type: str, place: Tensor) -> Tensor:
        """Return the current Earth-fixed positions, [N, n, 3] m, of places [N, n] of a type."""
        state = self.simulator.state
        return self.access_windows.kinds[type].position(state.all_rows, place, state.sim_time.unsqueeze(-1))

    def objects(self, type: str, place: Tensor) -> object:
        """Return the objects of places [N, n]: :class:`~bsk_torch.sats.opportunities.TargetObjects`, else names [N, n]."""
        return TargetObjects(self, place) if is_target(type) else place_names(self, type, place)

    def _last_generation(self, max_lookahead: int) -> Tensor | None:
        """Return the time, [N] s, from which on queries generate no more windows."""
        if not 0 < max_lookahead <= MAX_SEGMENTS:
            raise ValueError(f"max_lookahead={max_lookahead} must be from 1 to {MAX_SEGMENTS}")
        last = None
        if self.max_generation_duration_beyond_initial != float("inf"):
            limit, seconds = self.time_limit, self.initial_generation_duration
            initial = torch.where(torch.isfinite(limit), limit, 0.0) if seconds is None else torch.full_like(limit, seconds)
            last = initial + self.max_generation_duration_beyond_initial
        if max_lookahead == MAX_SEGMENTS:
            return last
        reach = self.access_windows.until + max_lookahead * self.segment
        return reach if last is None else torch.minimum(reach, last)

    def look_further(self, row: int) -> bool:
        """Extend the look-ahead of one row by a segment; return whether there was any left."""
        access, lookahead = self.simulator.access, self.simulator.lookahead
        last = self._last_generation(MAX_SEGMENTS)
        if access is None or (last is not None and bool(access.until[row] >= last[row])):
            return False
        only = torch.zeros_like(self.simulator.ticks)
        only[row] = torch.iinfo(torch.int32).max  # more than there can be
        end = access.until + self.segment
        lookahead.next_windows(self.opportunity_types[0], self.simulator.sim_time, 1, None, only, end, True)
        self._lists = {}
        return bool(access.until[row] >= end[row])

    def _kind(self, type: str | None, types: str | Collection[str] | None = None) -> str:
        """Return the type that ``type``, or ``types``, means; ValueError for none, several, or an unknown one."""
        if type is not None and not isinstance(type, str):
            raise ValueError(f"type={type!r} must be one type of opportunity; write pad= and the like with their names")
        kinds = [type or TARGET_KIND] if types is None else [types] if isinstance(types, str) else list(types)
        if type is not None and kinds != [type]:
            raise ValueError(f"type={type!r} and types={types!r} contradict each other")
        if len(kinds) != 1:
            raise ValueError(f"types={types!r}: tensors hold one type of opportunities; ask for each")
        if kinds[0] not in self.opportunity_types:
            raise ValueError(f"type={kinds[0]!r} is not a type of opportunity; {nearest(kinds[0], self.opportunity_types)}")
        return kinds[0]

    def aims(self, opportunities: Opportunities, instrument: int | None = None) -> Tensor:
        """Return the geometry of places relative to the satellite now, [N, n, 5].

        See :mod:`bsk_torch.sim.access.links.relative_geometry` for the five numbers and their units. Angles are those of the
        instrument with a number, or of the one chosen last.
        """
        observer, asked = self.simulator.observer, (self.simulator.state.version, instrument)
        if self._aims is None or self._aims[0] is not opportunities or self._aims[1] != asked:
            satellite = observer.read_together(self._observed_geometry)
            if satellite is None:
                none = torch.zeros_like(self.dynamics.r_BN_P)
                pairs = zip(self._geometry, SATELLITE_PROPERTIES, strict=True)
                satellite = torch.cat([getattr(owners[0], name) if owners else none for owners, name in pairs], 1)
            if instrument is not None:
                k, listed = SATELLITE_PROPERTIES.index("c_hat_P"), self.simulator.type.instruments
                name = listed[instrument].argument("inst_pHat_B")
                c_hat_P = self.dynamics.BP.mT @ unit_rows(self.simulator.argument(name)).unsqueeze(-1)
                satellite = torch.cat([satellite[:, : 3 * k], c_hat_P.squeeze(-1), satellite[:, 3 * k + 3 :]], 1)
            geometry = relative_geometries(satellite, opportunities.r_LP_P, observer.kernels)
            self._aims = opportunities, asked, geometry
        return self._aims[2]

    def opportunities(self, type: str | None = None, *, types: str | Collection[str] | None = None) -> Windows:
        """Return all computed windows of a type, sorted by closing time, [N, W]; missing ones close at infinity.

        Windows of past intervals are dropped as look-ahead advances. ``types`` is the same as ``type``.
        """
        return self._known(self._kind(type, types), torch.full_like(self.simulator.sim_time, -1.0), None)

    def upcoming_opportunities(self, type: str | None = None, *, types: str | Collection[str] | None = None) -> Windows:
        """Return the windows that have not closed and pass the filters, in the form of :meth:`opportunities`."""
        kind = self._kind(type, types)
        return self._known(kind, self.simulator.sim_time, self.allowed(kind))

    def listed(self, type: str, upcoming: bool) -> Windows:
        """Return the windows as :meth:`opportunities` does, or those that have not closed, without filters; views read them."""
        now = self.simulator.state.version, self.simulator.memory.version
        entry = self._lists.get((type, upcoming))
        if entry is None or entry[0] != now:
            time = self.simulator.sim_time
            entry = now, self._known(type, time if upcoming else torch.full_like(time, -1.0), None)
            self._lists[(type, upcoming)] = entry
        return entry[1]

    def _known(self, type: str, time: Tensor, allowed: Tensor | None, before: Tensor | None = None) -> Windows:
        """Return the windows that have not closed at ``time`` and, if given, that open ``before`` [N] s."""
        access = self.access_windows
        self.simulator.lookahead.search_visible(self.simulator.sim_time)
        windows = candidates(access.windows[type], time, access.until, allowed)
        if before is not None:
            windows = windows._replace(valid=windows.valid & (windows.windows.open < before.unsqueeze(-1)))
        key, order = torch.sort(windows.sort_key, dim=1, stable=True)
        there = torch.isfinite(key)
        opens, close, place = (table.gather(1, order) for table in windows.windows)
        opens, close = (torch.where(there, table, torch.inf) for table in (opens, close))
        return Windows(opens, close, torch.where(there, place, 0))

    def find_windows(self, until: float | Tensor, type: str = "target") -> Windows:
        """Return all windows of ``type`` that have not closed, open before ``until``, and pass the filters.

        Look-ahead is first extended to ``until`` by whole segments, also beyond the time limit. Later queries also see these
        windows.

        Args:
            until: Time, s since reset: one for all, or [N].
            type: Type of opportunity.

        Returns:
            Windows sorted by closing time, [N, W]; missing ones open and close at infinity. Windows in progress at the end of
            look-ahead close there.

        Raises:
            ValueError: For an unknown type, or an ``until`` of another shape or that is not finite.
        """
        kind, now = self._kind(type), self.simulator.sim_time
        times = torch.as_tensor(until, dtype=torch.float64, device=now.device)
        if times.shape not in ((), now.shape) or not bool(torch.isfinite(times).all()):
            raise ValueError(
                f"until={until!r} must be finite seconds since reset: one number, or a tensor of shape {list(now.shape)}"
            )
        if self.simulator.lookahead.generate_until(times.expand_as(now), now):
            self._cache.clear()
            self._lists.clear()
        return self._known(kind, now, self.allowed(kind), times.expand_as(now))

    @property
    def window_calculation_time(self) -> Tensor:
        """End of look-ahead, [N] s since reset."""
        return self.access_windows.until

    def calculate_additional_windows(self, duration: float | Tensor) -> None:
        """Extend look-ahead by ``duration`` s, one for all or [N], to whole segments and at least one.

        Non-positive durations have no effect. :meth:`find_windows` extends look-ahead to a given time instead.
        """
        seconds = torch.as_tensor(duration, dtype=torch.float64, device=self.simulator.device)
        more = torch.where(seconds > 0.0, seconds.clamp(min=self.segment), 0.0)
        self.find_windows(self.window_calculation_time + more, self.opportunity_types[0])

    def look_up(self, table: Tensor, place: Tensor) -> Tensor:
        """Return the entries [N, n, ...] of a table [num_envs, P, ...], such as ``scenario.priority``, for places [N, n]."""
        return self.simulator.look_up(table, place)

    def next_opportunities(
        self, type: str | None = None, until: float | Tensor | None = None, *, types: str | Collection[str] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return opening and closing time of the next window of every place of a type, [N, P] s each; infinity if there is none.

        Look-ahead is extended to ``until`` (s since reset, one for all or [N]) first; see :meth:`find_windows`.
        """
        kind = self._kind(type, types)
        windows = self.upcoming_opportunities(kind) if until is None else self.find_windows(until, kind)
        none = torch.full((len(windows.place), self.places(kind)), torch.inf, dtype=torch.float64, device=windows.open.device)
        # windows of a place do not overlap, so the first to close is the first to open
        return none.scatter_reduce(1, windows.place, windows.open, "amin"), none.scatter_reduce(
            1, windows.place, windows.close, "amin"
        )

    def places(self, type: str) -> int:
        """Return the number of places of a type, P."""
        return self.access_windows.kinds[type].count

    def opportunities_dict(
        self,
        env: int,
        type: str | None = None,
        upcoming: bool = False,
        *,
        types: str | Collection[str] | None = None,
    ) -> dict[int, list[tuple[float, float]]]:
        """Return the windows (opening and closing time, s) of environment ``env`` by place, for reading."""
        kind = self._kind(type, types)
        windows = self.upcoming_opportunities(kind) if upcoming else self.opportunities(kind)
        by_place: dict[int, list[tuple[float, float]]] = {}
        for place, opens, closes in zip(*(table[env].tolist() for table in (windows.place, *windows[:2])), strict=True):
            if closes < float("inf"):
                by_place.setdefault(place, []).append((opens, closes))
        return by_place


AccessSatellite.bound_type = BoundAccessSatellite
