"""Opportunities of one satellite of one environment, as lists and dictionaries of bsk_rl."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, NoReturn

import torch
from numpy.typing import NDArray

from bsk_torch.sats.objects import OneTarget, names_of
from bsk_torch.sats.one import OneSatellite, of_row
from bsk_torch.sim.access.windows import MAX_SEGMENTS
from bsk_torch.sim.names import nearest
from bsk_torch.sim.places import is_target

Types = str | Collection[str] | None
"""Type of opportunities, several types, or None for all."""

Window = tuple[float, float]
"""Opening and closing time, s since reset."""


class OneOpportunity(dict[str, Any]):
    """An opportunity: ``object`` (a :class:`OneTarget`, or the name of a station), ``window`` (s), ``type``, ``r_LP_P`` (m)."""

    place: int
    """Index among the places of its type."""


Filter = Callable[[OneOpportunity], Any] | list[Any] | None
"""Function that selects opportunities, list of excluded objects, or None for the filters of the satellite."""


class OneAccessSatellite(OneSatellite):
    """An access satellite of one environment, with bsk_rl's queries: opportunities are dictionaries, sorted by closing time."""

    def _make(self, kind: str, place: int, r_LP_P: object, **window: Window) -> OneOpportunity:
        if is_target(kind):
            thing: Any = OneTarget(self._whole, self._env, place)
        else:
            thing = names_of(self._whole, kind)[place]
        made = OneOpportunity(object=thing, type=kind, r_LP_P=r_LP_P, **window)
        made.place = place
        return made

    def _positions(self, kind: str) -> NDArray[Any]:
        """Return the Earth-fixed positions of all places of a type, [P, 3] m."""
        if is_target(kind):
            return self._whole.scenario.r_LP_P[self._env].cpu().numpy()
        row, places = torch.tensor([self._row]), self._whole.simulator.access.kinds[kind]
        place, now = torch.arange(places.count).unsqueeze(0), self._whole.simulator.sim_time[row].unsqueeze(-1)
        return places.position(row.to(now.device), place.to(now.device), now)[0].cpu().numpy()

    def of_windows(self, kind: str, windows: Any, padding: bool = False) -> list[OneOpportunity]:
        """Return windows [N, W] of a type, with or without their ``padding``, as opportunities of this row."""
        found, r_LP_P = [], self._positions(kind)
        columns = (table[self._row].tolist() for table in (windows.place, windows.open, windows.close))
        for place, opens, closes in zip(*columns, strict=True):
            if padding or closes < float("inf"):
                found.append(self._make(kind, place, r_LP_P[place].copy(), window=(opens, closes)))
        return found

    def all_places(self, kind: str) -> list[OneOpportunity]:
        """Return all places of a type as opportunities without a window."""
        return [self._make(kind, place, r_LP_P.copy()) for place, r_LP_P in enumerate(self._positions(kind))]

    def _listed(self, upcoming: bool) -> list[OneOpportunity]:
        kinds = self._whole.opportunity_types
        found = [one for kind in kinds for one in self.of_windows(kind, self._whole.listed(kind, upcoming))]
        return sorted(found, key=lambda opportunity: opportunity["window"][1])

    @property
    def opportunities(self) -> list[OneOpportunity]:
        """All computed opportunities; those of past intervals are dropped as look-ahead advances."""
        return self._listed(False)

    @property
    def upcoming_opportunities(self) -> list[OneOpportunity]:
        """Opportunities that have not closed, whatever the filters say."""
        return self._listed(True)

    def default_access_filter(self, opportunity: OneOpportunity) -> bool:
        """Return whether an opportunity passes all filters of the satellite."""
        allowed = self._whole.allowed(opportunity["type"])
        return allowed is None or bool(allowed[self._row, opportunity.place])

    def _passes(self, types: Types, filter: Filter) -> Callable[[OneOpportunity], Any]:
        kinds = self._kinds(types)
        if isinstance(filter, list):
            return lambda opportunity: opportunity["type"] in kinds and opportunity["object"] not in filter
        accepts = self.default_access_filter if filter is None else filter
        return lambda opportunity: opportunity["type"] in kinds and accepts(opportunity)

    def _kinds(self, types: Types) -> tuple[str, ...]:
        known = self._whole.opportunity_types
        kinds = known if types is None else (types,) if isinstance(types, str) else tuple(types)
        for kind in kinds:
            if kind not in known:
                raise ValueError(f"types={types!r}: {kind!r} is not a type of opportunity; {nearest(kind, known)}")
        return kinds

    def opportunities_dict(self, types: Types = None, filter: Filter = None) -> dict[Any, list[Window]]:
        """Return all windows by object."""
        return _by_object(self.opportunities, self._passes(types, filter))

    def upcoming_opportunities_dict(self, types: Types = None, filter: Filter = None) -> dict[Any, list[Window]]:
        """Return the windows that have not closed by object."""
        return _by_object(self.upcoming_opportunities, self._passes(types, filter))

    def next_opportunities_dict(
        self, types: Types = None, filter: Filter = None, min_needed: int | None = None
    ) -> dict[Any, Window]:
        """Return the next window of each object, of at most ``min_needed`` objects if that is given."""
        found: dict[Any, Window] = {}
        for thing, windows in self.upcoming_opportunities_dict(types, filter).items():
            if min_needed is not None and len(found) >= max(1, min_needed):
                break
            found[thing] = windows[0]
        return found

    def find_next_opportunities(
        self, n: int, pad: bool = True, max_lookahead: int = MAX_SEGMENTS, types: Types = None, filter: Filter = None
    ) -> list[OneOpportunity]:
        """Return the ``n`` opportunities that close next; look-ahead is extended where fewer are known.

        Args:
            n: Number of opportunities.
            pad: Whether to repeat the last one where there are fewer.
            max_lookahead: Number of times that look-ahead is extended at most.
            types: Type or types; all unless given.
            filter: See :data:`Filter`.

        Raises:
            RuntimeError: If there is none, or fewer than ``n`` without ``pad``.
            ValueError: For an unknown type.
        """
        passes, whole, found = self._passes(types, filter), self._whole, list[OneOpportunity]()
        if n == 0:
            return found
        kinds = self._kinds(types)
        if len(kinds) == 1 and filter is None and max_lookahead == MAX_SEGMENTS:
            return self.of_windows(kinds[0], whole.find_next_opportunities(n, kinds[0], pad=pad))
        for _ in range(max_lookahead):
            found = [opportunity for opportunity in self.upcoming_opportunities if passes(opportunity)][:n]
            if len(found) == n:
                return found
            if not whole.look_further(self._row):
                break
        if not pad or not found:
            raise RuntimeError(f"{len(found)} of {n} opportunities of type {types or 'any'} found for {whole.title(self._row)}")
        return found + [found[-1]] * (n - len(found))

    def calculate_additional_windows(self, duration: float) -> None:
        """Extend look-ahead of this satellite; see :meth:`bsk_torch.sats.BoundAccessSatellite.calculate_additional_windows`."""
        seconds = torch.zeros_like(self._whole.simulator.sim_time)
        seconds[self._row] = duration
        self._whole.calculate_additional_windows(seconds)

    def add_access_filter(self, *_: object, **__: object) -> NoReturn:
        """Raise AttributeError: filters belong to the satellites of all environments."""
        raise AttributeError("add_access_filter() belongs to all environments: call it before the environment is built")


class OneImagingSatellite(OneAccessSatellite):
    """An imaging satellite of one environment."""

    @property
    def latest_target(self) -> OneTarget | None:
        """Target that was chosen last; None before the first."""
        index = of_row(self._whole.latest_target, self._row)
        return OneTarget(self._whole, self._env, index) if index >= 0 else None

    @property
    def known_targets(self) -> list[OneTarget]:
        """All targets of the environment."""
        exists = self._whole.simulator.scenario_state["target_exists"][self._env]
        return [OneTarget(self._whole, self._env, index) for index, there in enumerate(exists.tolist()) if there]


def _by_object(opportunities: list[OneOpportunity], passes: Callable[[OneOpportunity], object]) -> dict[Any, list[Window]]:
    found: dict[Any, list[Window]] = {}
    for opportunity in opportunities:
        if passes(opportunity):
            found.setdefault(opportunity["object"], []).append(opportunity["window"])
    return found
