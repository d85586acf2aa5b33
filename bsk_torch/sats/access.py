"""Satellites with access windows of places on the ground."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.sats.satellite import Satellite
from bsk_torch.sim.access.places import place_positions
from bsk_torch.sim.access.relative_geometry import SATELLITE_PROPERTIES, relative_geometries
from bsk_torch.sim.access.window_table import Windows, candidates
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.params import nearest

AccessFilter = Callable[[], Tensor]
"""Function that returns the places of a type that remain visible to an agent now, [N, P] booleans."""


class Opportunities(NamedTuple):
    """The next opportunities, sorted by closing time: opening and closing time, s since reset, and place; [N, n] each.

    Where there are fewer than n, the last one is repeated; ``found`` [N] is their number.
    """

    open: Tensor
    close: Tensor
    place: Tensor
    r_LP_P: Tensor
    """Earth-fixed positions, [N, n, 3] m."""
    found: Tensor

    @property
    def mid(self) -> Tensor:
        """Middle of the window, [N, n] s since reset."""
        return 0.5 * (self.open + self.close)

    @property
    def mask(self) -> Tensor:
        """True for those that do not repeat the last one, [N, n]."""
        return torch.arange(self.place.shape[1], device=self.place.device) < self.found.unsqueeze(-1)


class AccessSatellite(Satellite):
    """Adds access windows; see :mod:`bsk_torch.sim.access.windows`."""

    def __init__(
        self,
        name: str,
        sat_args: Mapping[str, Any] | None = None,
        *,
        generation_duration: float = 600.0,
        initial_generation_duration: float | None = None,
        max_generation_duration_beyond_initial: float = float("inf"),
        may_see_nothing: bool = False,
        **options: Any,
    ) -> None:
        """See :class:`~bsk_torch.sats.satellite.Satellite` for the other arguments.

        Args:
            name: A Python identifier.
            sat_args: Arguments of the models.
            generation_duration: Seconds by which windows are extended when a query runs out of them, a multiple of 30.
            initial_generation_duration: Seconds for which windows are generated at reset; None for the time limit (nothing
                where that is infinite).
            max_generation_duration_beyond_initial: Seconds beyond that after which queries end; they then repeat the last window.
            may_see_nothing: Whether queries without a window within a hundred segments yield observations of zeros, and images
                that only wait for a segment; otherwise they raise as in bsk_rl.
            **options: Passed on.
        """
        super().__init__(name, sat_args, **options)
        whole = generation_duration / PLAN_STEP
        if generation_duration <= 0.0 or whole != round(whole):
            raise ValueError(f"generation_duration={generation_duration:g} s must be a positive multiple of {PLAN_STEP:g} s")
        if not max_generation_duration_beyond_initial >= 0.0:
            raise ValueError(
                f"max_generation_duration_beyond_initial={max_generation_duration_beyond_initial:g} s must not be negative"
            )
        self.generation_duration = generation_duration
        self.initial_generation_duration = initial_generation_duration
        self.max_generation_duration_beyond_initial = max_generation_duration_beyond_initial
        self.may_see_nothing = may_see_nothing

    @property
    def segment(self) -> float:
        """See :attr:`Satellite.segment`."""
        return self.generation_duration

    def on_bind(self) -> None:
        """See :meth:`Satellite.on_bind`."""
        super().on_bind()
        self._filters: dict[str, list[AccessFilter]] = {}
        self._cache: dict[tuple[str, int], tuple[tuple[int, int], Opportunities]] = {}
        self._aims: tuple[Opportunities, int, Tensor] | None = None

    @property
    def opportunity_types(self) -> tuple[str, ...]:  # type: ignore[override]
        """Kinds of opportunities that this satellite has."""
        return tuple(self.simulator.access.kinds) if self.simulator.access is not None else ()

    def generation(self, limit: Tensor) -> Tensor:
        """See :meth:`Satellite.generation`."""
        wanted = limit if self.initial_generation_duration is None else torch.full_like(limit, self.initial_generation_duration)
        wanted = torch.where(torch.isfinite(wanted), wanted, torch.zeros_like(wanted))
        least = max(2.0 * PLAN_STEP, self.generation_duration)
        whole = torch.ceil(torch.clamp(wanted, min=least) / self.generation_duration) * self.generation_duration
        return torch.where(wanted > 0.0, whole, torch.zeros_like(wanted))

    # -- filters -----------------------------------------------------------------------------------------------------

    def add_access_filter(self, access_filter: AccessFilter, type: str = "target") -> None:
        """Exclude places from all queries: ``access_filter()`` returns which ones of ``type`` remain, [N, P] booleans."""
        self._filters.setdefault(type, []).append(access_filter)

    def allowed(self, type: str) -> Tensor | None:
        """Return a mask of the places of a type that pass all filters, [N, P]; None for all."""
        parts = [access_filter() for access_filter in self._filters.get(type, ())]
        for part in parts[1:]:
            parts[0] = parts[0] & part
        return parts[0] if parts else None

    # -- queries ------------------------------------------------------------------------------------------------------

    def find_next_opportunities(self, n: int, type: str = "target", count: Tensor | None = None) -> Opportunities:
        """Return the ``n`` opportunities of ``type`` that close next, including those in progress; the last repeated if fewer.

        Look-ahead is extended where fewer than ``count`` [N] (n unless given) are known. Where none is found within a
        hundred segments, place 0 opens and closes now with ``may_see_nothing``.

        Raises:
            RuntimeError: If none is found within a hundred segments, without ``may_see_nothing``.
            ValueError: For an unknown type.
        """
        self._check_type(type)
        now = self.simulator.state.version, self.simulator.memory.version
        known = self._cache.get((type, n))
        if known is not None and known[0] == now and (count is None or bool((known[1].found >= count).all())):
            return known[1]
        wanted = count
        if self.removed is not None:
            wanted = torch.where(self.removed, 0, n if count is None else count)
        simulator = self.simulator
        windows, found = simulator.lookahead.next_windows(
            type, simulator.sim_time, n, self.allowed(type), wanted, self._last_generation(), self.may_see_nothing
        )
        if self.may_see_nothing:
            windows = self._or_nothing(windows, found)
        r_LP_P = place_positions(simulator.access, simulator.scenario_state, type, windows.place)  # type: ignore[arg-type]
        opportunities = Opportunities(*windows, r_LP_P, found)
        if count is None:
            self._cache[(type, n)] = now, opportunities
        return opportunities

    def _or_nothing(self, windows: Windows, found: Tensor) -> Windows:
        """Return the windows [N, n], those of place 0 that open and close now where none was ``found`` [N]."""
        there, now = (found > 0).unsqueeze(-1), self.simulator.sim_time.unsqueeze(-1)
        opens, close = (torch.where(there, time, now) for time in windows[:2])
        return Windows(opens, close, torch.where(there, windows.place, 0))

    def _last_generation(self) -> Tensor | None:
        """Return the time, [N] s, from which on queries generate no more windows."""
        if self.max_generation_duration_beyond_initial == float("inf"):
            return None
        limit, given = self.time_limit, self.initial_generation_duration
        initial = torch.where(torch.isfinite(limit), limit, 0.0) if given is None else torch.full_like(limit, given)
        return initial + self.max_generation_duration_beyond_initial

    def _check_type(self, type: str) -> None:
        if type not in self.opportunity_types:
            raise ValueError(f"type={type!r} is not a type of opportunity; {nearest(type, self.opportunity_types)}")

    def aims(self, opportunities: Opportunities) -> Tensor:
        """Return the geometry of places relative to the satellite now, [N, n, 5].

        See :mod:`bsk_torch.sim.access.relative_geometry` for the five numbers and their units.
        """
        observer = self.simulator.observer
        if self._aims is None or self._aims[0] is not opportunities or self._aims[1] != self.simulator.state.version:
            models, zero = (self.dynamics, self.fsw), torch.zeros_like(self.dynamics.r_BN_P)
            found = (
                [getattr(model, name) for model in models if hasattr(model.__class__, name)] for name in SATELLITE_PROPERTIES
            )
            satellite = tuple(values[0] if values else zero for values in found)
            found_now = relative_geometries(satellite, opportunities.r_LP_P, observer.kernels)
            self._aims = opportunities, self.simulator.state.version, found_now
        return self._aims[2]

    def opportunities(self, type: str) -> Windows:
        """Return all windows of a type that have been computed, sorted by closing time, [N, W]; missing ones close at infinity.

        Those of past intervals are dropped as look-ahead goes on.
        """
        self._check_type(type)
        return self._known(type, torch.full_like(self.simulator.sim_time, -1.0), None)

    def upcoming_opportunities(self, type: str) -> Windows:
        """Return the windows as :meth:`opportunities` does, of those that have not closed and that pass the filters."""
        self._check_type(type)
        return self._known(type, self.simulator.sim_time, self.allowed(type))

    def _known(self, type: str, time: Tensor, allowed: Tensor | None, before: Tensor | None = None) -> Windows:
        """Return the windows that have not closed at ``time`` and, if given, that open ``before`` [N] s."""
        access = self.simulator.access
        known = candidates(access.windows[type], time, access.until, allowed)  # type: ignore[union-attr]
        if before is not None:
            known = known._replace(valid=known.valid & (known.windows.open < before.unsqueeze(-1)))
        key, order = torch.sort(known.sort_key, dim=1, stable=True)
        there = torch.isfinite(key)
        opens, close, place = (table.gather(1, order) for table in known.windows)
        opens, close = (torch.where(there, table, torch.inf) for table in (opens, close))
        return Windows(opens, close, torch.where(there, place, 0))

    def find_windows(self, until: float | Tensor, type: str = "target") -> Windows:
        """Return all windows of ``type`` that have not closed, that open before ``until`` and that pass the filters.

        Look-ahead is extended to ``until`` first, by whole segments as bsk_rl's ``calculate_additional_windows`` does, also
        beyond the time limit. Later queries see as far.

        Args:
            until: Time, s since reset: one for all, or [N].
            type: Type of opportunity.

        Returns:
            Windows sorted by closing time, [N, W]; missing ones open and close at infinity. Windows in progress at the end of
            look-ahead close there.

        Raises:
            ValueError: For an unknown type, or an ``until`` of another shape or that is not finite.
        """
        self._check_type(type)
        now = self.simulator.sim_time
        times = torch.as_tensor(until, dtype=torch.float64, device=now.device)
        if times.shape not in ((), now.shape) or not bool(torch.isfinite(times).all()):
            raise ValueError(
                f"until={until!r} must be finite seconds since reset: one number, or a tensor of shape {list(now.shape)}"
            )
        self.simulator.lookahead.generate_until(times.expand_as(now), now)
        return self._known(type, now, self.allowed(type), times.expand_as(now))

    def look_up(self, table: Tensor, place: Tensor) -> Tensor:
        """Return the entries [N, n, ...] of a table [num_envs, P, ...], such as ``scenario.priority``, for places [N, n]."""
        return self.simulator.look_up(table, place)

    def next_opportunities(self, type: str, until: float | Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return opening and closing time of the next window of every place of a type, [N, P] s each; infinity where none.

        Look-ahead is extended to ``until`` (s since reset, one for all or [N]) first; see :meth:`find_windows`.
        """
        windows = self.upcoming_opportunities(type) if until is None else self.find_windows(until, type)
        places = self.simulator.access.kinds[type](self.simulator.state.all_rows).r_LP_P.shape[1]  # type: ignore[union-attr]
        none = torch.full((len(windows.place), places), torch.inf, dtype=torch.float64, device=windows.open.device)
        # windows of a place do not overlap, so the first to close is the first to open
        return none.scatter_reduce(1, windows.place, windows.open, "amin"), none.scatter_reduce(
            1, windows.place, windows.close, "amin"
        )

    def opportunities_dict(self, env: int, type: str = "target", upcoming: bool = False) -> dict[int, list[tuple[float, float]]]:
        """Return the windows (opening and closing time, s) of environment ``env`` by place, for people to read."""
        windows = self.upcoming_opportunities(type) if upcoming else self.opportunities(type)
        found: dict[int, list[tuple[float, float]]] = {}
        for place, opens, closes in zip(*(table[env].tolist() for table in (windows.place, *windows[:2])), strict=True):
            if closes < float("inf"):
                found.setdefault(place, []).append((opens, closes))
        return found
