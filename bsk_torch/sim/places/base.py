"""Interface of kinds of places: points that satellites may see, on the ground or in orbit.

A kind defines the positions of its places over time and the conditions for a clear view. Models declare kinds: a component by its
``places``, a scenario by its method ``place_kinds``; both are called with :class:`PlaceTables` when a simulation is built. The
name of a kind is a type of opportunities.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.earth_rotation import IAU_EARTH, Earth
from bsk_torch.astro.geodetic import Vertical, axis_shift
from bsk_torch.rand import first_key
from bsk_torch.sim.arguments.values import Arguments
from bsk_torch.sim.component import Component
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.instruments import Instrument
from bsk_torch.sim.places.clearance import Clearance, PlaceTables, SunElevation
from bsk_torch.sim.state import StateTable, entries
from bsk_torch.vec3 import Vec3

STATION_KIND, TARGET_KIND = "ground_station", "target"
"""Names of the kinds that components and scenarios of the package declare."""


def instrument_kind(instrument: Instrument) -> str:
    """Return the kind of places that the targets of one of several instruments are."""
    return f"{TARGET_KIND}@{instrument.name}" if instrument.has_own_windows else TARGET_KIND


def is_target(kind: str) -> bool:
    """Return whether places of a kind are the targets of the scenario, for one instrument or another."""
    return kind.partition("@")[0] == TARGET_KIND


TARGETS = "target_r_LP_P"
"""Name under which scenarios draw the positions of targets."""


class Places(ABC):
    """A kind of places, P in every environment."""

    tables: PlaceTables
    clearances: Sequence[Clearance] = ()  # conditions of a clear view, all of which must hold
    # what a user can do if none of the places comes into view, as the end of an error message
    advice: str = "lengthen the orbits' look-ahead, or ask for more places"
    names: Sequence[str] = ()

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of places P in every environment, those that do not exist included."""

    @abstractmethod
    def position(self, rows: Tensor, place: Tensor, time: Tensor) -> Tensor:
        """Return Earth-fixed positions, [n, ..., 3] m.

        Args:
            rows: Rows of satellites, [n], which say in which environment the places are; they may repeat.
            place: Numbers of places, which broadcast with the times to [n, ...].
            time: Times, s since reset.
        """

    def exists(self, rows: Tensor) -> Tensor:
        """Return which places exist in the environments of ``rows`` [n], [n or 1, P] bool; all, unless overridden."""
        return torch.ones(1, self.count, dtype=torch.bool, device=rows.device)

    @abstractmethod
    def max_speed(self, rows: Tensor) -> Tensor:
        """Return a bound of the speed of places relative to the Earth, [n or 1, P or 1] m/s; the coarse screen uses it."""


class DrawnPlaces(Places):
    """Places of which a scenario draws what they are and which of them exist."""

    def __init__(
        self,
        tables: PlaceTables,
        clearances: Sequence[Clearance],
        *,
        exists: str | None = None,
        advice: str = Places.advice,
        names: Sequence[str] = (),
    ) -> None:
        """Describe places.

        Args:
            tables: Tables of the simulation.
            clearances: Conditions of a clear view, such as ``AboveElevation`` or ``WithinRange``.
            exists: Name of the draw that marks existing places, [num_envs, P], 1 or 0 (default: all exist).
            advice: See :class:`Places`.
            names: See :class:`Places`.
        """
        self.tables, self.clearances, self.advice, self.names = tables, tuple(clearances), advice, tuple(names)
        self._exists = exists

    @override
    def exists(self, rows: Tensor) -> Tensor:
        return super().exists(rows) if self._exists is None else self.tables.of_envs(self._exists, rows) > 0.5


class Sites(NamedTuple):
    """Places on the ground; n is the number of satellites, or 1 if all have the same places."""

    r_LP_P: Tensor  # Earth-fixed positions, [n, P, 3] m; NaN for the padding of satellites that have fewer places than others
    sin_min_elevation: Tensor  # sines of the minimum elevation, [n, P]
    shift: Tensor | None = None  # axis_shift of each place, [n, P] m; None for elevations from the radius


class FixedPlaces(Places):
    """Places that rest on the Earth, and see satellites above a minimum elevation, in a given light.

    Their windows are found by kernels, which makes them the fastest kind; not those of subclasses with ``clearances``.
    """

    light: Sequence[SunElevation] = ()  # conditions on the elevation of the Sun, all of which must hold
    may_lack = False  # whether places may not exist in some environments

    def __init__(
        self,
        r_LP_P: Tensor | Callable[[], Tensor],
        sin_min_elevation: float | Callable[[Tensor], Tensor],
        *,
        satellites: int = 1,
        light: Sequence[SunElevation] = (),
        tables: PlaceTables | None = None,
        advice: str = Places.advice,
        names: Sequence[str] = (),
        vertical: Vertical = "radius",
    ) -> None:
        """Describe places.

        Args:
            r_LP_P: Earth-fixed positions, [1, P, 3] m for all environments or [num_envs, P, 3]; or a function that returns them,
                such as ``lambda: tables.drawn["buoy_r_LP_P"]`` of what a scenario draws.
            sin_min_elevation: Sine of the minimum elevation: a number, or a function of rows [n] that returns [n or 1, P or 1].
            satellites: Satellites in each environment, ``tables.arguments.count``.
            light: Conditions such as ``[SunElevation(0.1)]``.
            tables: Tables of the simulation; needed with ``light``, which depends on the time.
            advice: See :class:`Places`.
            names: See :class:`Places`.
            vertical: Direction from which elevations are counted: the place's ``"radius"``, or the normal of ``"wgs84"``.

        Raises:
            ValueError: For ``light`` without ``tables``.
        """
        if light and tables is None:
            raise ValueError(f"light={light!r} needs tables=, those that place_kinds(tables) was called with")
        self._table, self._limit, self.light = r_LP_P, sin_min_elevation, tuple(light)
        self.satellites, self.advice, self.names, self.vertical = satellites, advice, tuple(names), vertical
        if tables is not None:
            self.tables = tables

    @property
    def r_LP_P(self) -> Tensor:
        """Earth-fixed positions, [1 or num_envs, P, 3] m."""
        return self._table if isinstance(self._table, Tensor) else self._table()

    @property
    @override
    def count(self) -> int:
        return self._stored()[0].shape[1]

    def _stored(self) -> tuple[Tensor, Tensor | None]:
        """Return positions [K, P, 3] m, and the row of them that belongs to each environment; None if row k belongs to k."""
        return self.r_LP_P, None

    def position(self, rows: Tensor, place: Tensor, time: Tensor) -> Tensor:
        """See :meth:`Places.position`; the same at all times."""
        table, row = self._stored()
        if len(table) == 1:
            return table[0, place]
        envs = rows // self.satellites
        return entries(table, (envs if row is None else row[envs]).view(-1, *[1] * (place.ndim - 1)), place)

    @override
    def max_speed(self, rows: Tensor) -> Tensor:
        return torch.zeros(1, 1, dtype=torch.float64, device=rows.device)

    def sites(self, rows: Tensor) -> Sites:
        """Return the places of satellites ``rows`` [n] as tables."""
        (table, row), given = self._stored(), self._limit(rows) if callable(self._limit) else self._limit
        sines = torch.as_tensor(given, dtype=table.dtype, device=table.device)
        sines = (sines if sines.ndim else sines.view(1, 1)).expand(-1, table.shape[1])
        if len(table) == len(sines) == 1 and not self.may_lack:
            return Sites(table, sines, self._shift(table))
        envs = rows // self.satellites if row is None else row[rows // self.satellites]
        r_LP_P = table[envs] if len(table) > 1 else table.repeat(len(rows), 1, 1)
        if self.may_lack:
            r_LP_P.masked_fill_(~self.exists(rows).unsqueeze(-1), torch.nan)
        return Sites(r_LP_P, sines.expand(r_LP_P.shape[:2]), self._shift(r_LP_P))

    def _shift(self, r_LP_P: Tensor) -> Tensor | None:
        return axis_shift(Vec3.of(r_LP_P)) if self.vertical == "wgs84" else None


class DrawnTargets(FixedPlaces):
    """Targets that a scenario draws, by the names :data:`TARGETS` and ``target_exists``; read as the table stores them."""

    may_lack = True

    def __init__(
        self,
        tables: PlaceTables,
        sin_min_elevation: Callable[[Tensor], Tensor],
        light: Sequence[SunElevation] = (),
        *,
        clearances: Sequence[Clearance] = (),
        advice: str = Places.advice,
    ) -> None:
        """Describe targets.

        Args:
            tables: Tables of the simulation.
            sin_min_elevation: Function of rows [n] that returns the sine of the minimum elevation, [n, 1].
            light: See :class:`FixedPlaces`.
            clearances: All other conditions of a clear view, the elevation included, where there are others.
            advice: See :class:`Places`.
        """
        drawn = tables.drawn
        super().__init__(
            lambda: drawn[TARGETS],
            sin_min_elevation,
            satellites=tables.arguments.count,
            light=light,
            tables=tables,
            advice=advice,
            vertical=tables.vertical,
        )
        self._drawn, self.clearances = drawn, tuple(clearances)

    def _stored(self) -> tuple[Tensor, Tensor | None]:
        return self._drawn.shared(TARGETS)

    @override
    def exists(self, rows: Tensor) -> Tensor:
        return self._drawn.of_envs("target_exists", rows // self.satellites) > 0.5


PlaceKinds = Callable[[PlaceTables], Mapping[str, object]]
"""Function that returns kinds of places, :class:`~bsk_torch.sim.places.Places` by name."""


def place_kinds(
    parts: Sequence[Component],
    world_args: Arguments,
    scenario: DrawTable,
    arguments: StateTable,
    declared: PlaceKinds,
    instruments: Sequence[Instrument] = (),
    vertical: Vertical = "radius",
    earth: Earth = IAU_EARTH,
) -> dict[str, Places]:
    """Return the places that satellites can see, by kind: those of ``parts``, and those ``declared`` by the scenario.

    The draws of the scenario are [num_envs, ...] each, the arguments of the satellites [N, ...]. TypeError for something else
    than places, ValueError for a name already in use, or places without clearances.
    """
    bringing = [part for part in parts if part.places]
    world = world_args.draw(first_key(1)) if bringing else {}
    tables = PlaceTables(scenario, arguments, world, instruments, vertical, earth)
    kinds: dict[str, Places] = {}
    sources = [(f"the component {part.slot!r}", part.places) for part in bringing]
    for owner, source in [*sources, ("the scenario", declared)]:
        for name, places in source(tables).items() if source else ():
            if not isinstance(places, Places):
                raise TypeError(f"{owner} gives places {name!r}: {places!r}; it must be a sim.places.Places")
            if name in kinds:
                raise ValueError(f"{owner} gives places {name!r}, a name already in use; other kinds are {sorted(kinds)}")
            if not places.clearances and not isinstance(places, FixedPlaces):
                raise ValueError(f"{owner} gives places {name!r} without clearances; give at least one: ClearOfEarth()")
            kinds[name] = places
    return kinds
