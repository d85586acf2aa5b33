"""One satellite of a batch, as a function for one episode reads it.

In an environment of the core, a satellite stands for all satellites of its type in all episodes, and its properties are tensors
[N, ...]. A :class:`OneSatellite` is a read-only view of one of those rows: properties of the package are NumPy arrays and Python
numbers of that row, and properties and methods of a user's models run with the view as ``self``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from operator import attrgetter
from types import SimpleNamespace
from typing import Any, NoReturn

import torch
from numpy.typing import NDArray
from typing_extensions import override

from bsk_torch.bsk_rl.data.unique_image_data import UniqueImageData
from bsk_torch.bsk_rl.sats.access_satellite import OpportunityQueries, Types, Window
from bsk_torch.bsk_rl.sim.commands import module_of
from bsk_torch.bsk_rl.sim.views import of_row
from bsk_torch.sats.access import AccessSatellite
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.imaging import ImagingSatellite
from bsk_torch.sats.opportunities import Opportunities, names_of, target_names
from bsk_torch.sim.access.windows.search import MAX_SEGMENTS
from bsk_torch.sim.hooks import is_of_package
from bsk_torch.sim.names import nearest
from bsk_torch.sim.places import is_target
from bsk_torch.sim.readout.observables import observable

READ_ONLY = "the view of one episode of a batch is read-only; vectorize='episodes' makes environments whose satellites are not"


class OneView:
    """Read-only view of what one row has of an object that stands for all rows.

    Attributes of the package's classes are evaluated for all rows, and read at the row. Properties and methods of a user's class
    run with the view as ``self``.
    """

    def __init__(self, whole: object, row: int) -> None:
        self.__dict__.update(_whole=whole, _row=row)

    _whole: Any
    _row: int

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{name!r} cannot be set: {READ_ONLY}")

    def __repr__(self) -> str:
        return f"<{type(self._whole).__name__} of row {self._row}>"

    def __getattr__(self, name: str) -> Any:
        whole = self.__dict__["_whole"]
        if name.startswith("__"):
            raise AttributeError(name)
        for owner in type(whole).__mro__:
            if name in vars(owner):
                return self._of_class(name, vars(owner)[name], owner)
        if name in vars(whole):
            return vars(whole)[name]
        raise AttributeError(f"{type(whole).__name__} has no attribute {name!r}; {nearest(name, dir(whole))}")

    def _of_class(self, name: str, member: Any, owner: type) -> object:
        batched = is_of_package(owner) or isinstance(member, observable)
        if not batched and isinstance(member, property | cached_property):
            return (member.fget if isinstance(member, property) else member.func)(self)  # type: ignore[misc]
        if not batched and callable(member) and not isinstance(member, staticmethod | classmethod | type):
            return member.__get__(self)
        value = getattr(self._whole, name)
        if callable(value) and not isinstance(value, type):  # methods of the package, and aliveness checks
            return lambda *args, **options: of_row(value(*args, **options), self._row)
        return of_row(value, self._row)


class OneArguments(Mapping[str, Any]):
    """Arguments of the current episode by name: numbers, NumPy arrays, and what is neither."""

    def __init__(self, whole: Mapping[str, object], row: int) -> None:
        self._whole, self._row = whole, row

    def __getitem__(self, name: str) -> Any:
        return of_row(self._whole[name], self._row)

    def __iter__(self) -> Iterator[str]:
        return iter(self._whole)

    def __len__(self) -> int:
        return len(self._whole)


class OneSimulator(OneView):
    """The simulation at one row: time, world, and declared memory."""

    def __init__(self, satellite: BoundSatellite, row: int) -> None:
        super().__init__(satellite.simulator, row)
        self.__dict__["_satellite"] = satellite

    _satellite: BoundSatellite
    sim_rate = property(attrgetter("_whole.h"), doc="Length of a tick, s.")
    time_limit = property(lambda view: of_row(view._satellite.time_limit, view._row), doc="Time limit of the episode, s.")
    sim_time_ns = property(lambda view: of_row(view._whole.state.sim_time_ns, view._row), doc="Time since reset, ns.")
    world = property(lambda view: OneView(view._whole.world, view._row), doc="Sun, Earth and ground stations.")
    memory = property(lambda view: OneArguments(view._whole.memory, view._row), doc="Declared values of the row by name.")

    def get_satellite(self, name: str) -> OneSatellite:
        """Return a satellite of the episode; KeyError for an unknown name."""
        return OneOthers(self._satellite.fleet, self._row // self._satellite.simulator.count)[name]


class OneModel(OneView):
    """A dynamics or flight-software model at one row; Basilisk's usual modules of dynamics are attributes."""

    @property
    def satellite(self) -> OneSatellite:
        """The satellite."""
        return view_of(self._whole.satellite, self._row)

    def __getattr__(self, name: str) -> Any:
        return module_of(self, name, lambda: None) or super().__getattr__(name)

    dynamics = property(attrgetter("satellite.dynamics"), doc="The dynamics model of the satellite.")
    fsw = property(attrgetter("satellite.fsw"), doc="The flight-software model of the satellite.")
    simulator = property(attrgetter("satellite.simulator"), doc="The simulation.")
    world = property(attrgetter("simulator.world"), doc="Sun, Earth and ground stations.")


class OneSatellite(OneView):
    """One satellite of one episode; :func:`~bsk_torch.bsk_rl.per_episode.views.view_of` makes it.

    ``satellite.dynamics.r_BN_N`` is an array [3], ``satellite.simulator.sim_time`` a number of seconds and
    ``satellite.sat_args[name]`` the drawn argument.
    """

    def __init__(self, satellite: BoundSatellite, row: int) -> None:
        """View the satellite of row ``row`` of all N of its type: number ``row % count`` of episode ``row // count``."""
        super().__init__(satellite, row)
        self.__dict__["env"], self.__dict__["_number"] = divmod(row, satellite.simulator.state.count)

    env: int
    """Number of the environment."""
    _number: int

    name = id = property(lambda view: view._whole.names[view._number], doc="Name of the satellite.")
    simulator = property(lambda view: OneSimulator(view._whole, view._row), doc="The simulation of the satellite.")
    dynamics = property(lambda view: OneModel(view._whole.dynamics, view._row), doc="The dynamics model.")
    fsw = property(lambda view: OneModel(view._whole.fsw, view._row), doc="The flight-software model.")
    sat_args = model_args = property(lambda view: OneArguments(view._whole.sat_args, view._row), doc="Arguments of the episode.")
    others = property(
        lambda view: OneOthers(view._whole.fleet, view.env), doc="All satellites of the episode by name, as such views."
    )
    scenario = property(lambda view: OneView(view._whole.scenario, view.env), doc="The scenario in the episode.")

    @property
    def data_store(self) -> object:
        """Store of the satellite in the rewarder: ``data_store.data``; AttributeError for rewarders without stores."""
        store = self._whole.data_store
        if isinstance(store, list):
            return store[self._row]
        scenario, images = self._whole.scenario, store.data
        imaged = [scenario.target_object(self.env, k) for k in torch.nonzero(images.imaged[self._row]).squeeze(-1).tolist()]
        duplicates = int(images.duplicates[self._row])
        return SimpleNamespace(data=UniqueImageData(imaged, duplicates, scenario.target_objects(self.env)))


class OneOthers(Mapping[str, OneSatellite]):
    """The satellites of one episode by name, each as a view of one row."""

    def __init__(self, fleet: SatelliteFleet, env: int) -> None:
        self._fleet, self._env = fleet, env

    def __getitem__(self, name: str) -> OneSatellite:
        whole, number = self._fleet.find(name)
        return view_of(whole, self._env * whole.simulator.count + number)

    def __iter__(self) -> Iterator[str]:
        return iter(self._fleet.places)

    def __len__(self) -> int:
        return len(self._fleet.places)


class OneTarget:
    """A target of one environment; equal to others of the same environment and index.

    Attributes:
        id: Index among the targets of the environment; ``act.image_target(id)`` is the action that images it.
    """

    def __init__(self, satellite: BoundAccessSatellite, env: int, index: int) -> None:
        self._satellite, self._env, self.id = satellite, env, index

    @property
    def name(self) -> str:
        """Name of the target."""
        return target_names(self._satellite, self._env)[self.id]

    def __getattr__(self, name: str) -> Any:
        """Return a value of the target, a number or a NumPy array, or an attribute of the object that the scenario made for it.

        AttributeError for an unknown name.
        """
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return of_row(self._satellite.scenario.target_attribute(name)[self._env], self.id)
        except AttributeError:
            made = getattr(self._satellite.scenario, "target_object", None)
            if made is None or not hasattr(target := made(self._env, self.id), name):
                raise
            return getattr(target, name)

    @property
    def _place(self) -> tuple[int, int]:
        return self._env, self.id

    def __eq__(self, other: object) -> bool:
        return getattr(other, "_place", None) == self._place

    def __hash__(self) -> int:
        return hash(self._place)

    def __repr__(self) -> str:
        return f"Target({self.name})"


class OneOpportunity(dict[str, Any]):
    """An opportunity: ``object`` (a :class:`OneTarget`, or the name of a station), ``window`` (s), ``type``, ``r_LP_P`` (m)."""

    place: int
    """Index among the places of its type."""


Filter = Callable[[OneOpportunity], object] | list[object] | None
"""Function that selects opportunities, list of excluded objects, or None for the filters of the satellite."""


class OneAccessSatellite(OneSatellite, OpportunityQueries):
    """An access satellite of one episode: opportunities are dictionaries, sorted by closing time."""

    def _make(self, kind: str, place: int, r_LP_P: object, **window: Window) -> OneOpportunity:
        if is_target(kind):
            thing: object = OneTarget(self._whole, self.env, place)
        else:
            thing = names_of(self._whole, kind)[place]
        made = OneOpportunity(object=thing, type=kind, r_LP_P=r_LP_P, **window)
        made.place = place
        return made

    def _positions(self, kind: str) -> NDArray[Any]:
        """Return the Earth-fixed positions of all places of a type, [P, 3] m."""
        if is_target(kind):
            return self._whole.scenario.r_LP_P[self.env].cpu().numpy()
        row, places = torch.tensor([self._row]), self._whole.simulator.access.kinds[kind]
        place, now = torch.arange(places.count).unsqueeze(0), self._whole.simulator.sim_time[row].unsqueeze(-1)
        return places.position(row.to(now.device), place.to(now.device), now)[0].cpu().numpy()

    def of_windows(self, kind: str, windows: Opportunities, padding: bool = False) -> list[OneOpportunity]:
        """Return windows [N, W] of a type, with or without their ``padding``, as opportunities of this row."""
        opportunities, r_LP_P = [], self._positions(kind)
        columns = (table[self._row].tolist() for table in (windows.place, windows.open, windows.close))
        for place, opens, closes in zip(*columns, strict=True):
            if padding or closes < float("inf"):
                opportunities.append(self._make(kind, place, r_LP_P[place].copy(), window=(opens, closes)))
        return opportunities

    def all_places(self, kind: str) -> list[OneOpportunity]:
        """Return all places of a type as opportunities without a window."""
        return [self._make(kind, place, r_LP_P.copy()) for place, r_LP_P in enumerate(self._positions(kind))]

    def _listed(self, upcoming: bool) -> list[OneOpportunity]:
        kinds = self._whole.opportunity_types
        opportunities = [one for kind in kinds for one in self.of_windows(kind, self._whole.listed(kind, upcoming))]
        return sorted(opportunities, key=lambda opportunity: opportunity["window"][1])

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

    @override
    def _accepts(self, types: Types, filter: Filter) -> Callable[[OneOpportunity], object]:
        kinds = self._kinds(types)
        if isinstance(filter, list):
            return lambda opportunity: opportunity["type"] in kinds and opportunity["object"] not in filter
        accepts = self.default_access_filter if filter is None else filter
        return lambda opportunity: opportunity["type"] in kinds and accepts(opportunity)

    def _kinds(self, types: Types) -> tuple[str, ...]:
        every = self._whole.opportunity_types
        kinds = every if types is None else (types,) if isinstance(types, str) else tuple(types)
        for kind in kinds:
            if kind not in every:
                raise ValueError(f"types={types!r}: {kind!r} is not a type of opportunity; {nearest(kind, every)}")
        return kinds

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
        accepts, whole, chosen = self._accepts(types, filter), self._whole, list[OneOpportunity]()
        if n == 0:
            return chosen
        kinds = self._kinds(types)
        if len(kinds) == 1 and filter is None and max_lookahead == MAX_SEGMENTS:
            return self.of_windows(kinds[0], whole.find_next_opportunities(n, kinds[0], pad=pad))
        for _ in range(max_lookahead):
            chosen = [opportunity for opportunity in self.upcoming_opportunities if accepts(opportunity)][:n]
            if len(chosen) == n:
                return chosen
            if not whole.look_further(self._row):
                break
        if not pad or not chosen:
            raise RuntimeError(f"{len(chosen)} of {n} opportunities of type {types or 'any'} found for {whole.title(self._row)}")
        return chosen + [chosen[-1]] * (n - len(chosen))

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
        return OneTarget(self._whole, self.env, index) if index >= 0 else None

    @property
    def known_targets(self) -> list[OneTarget]:
        """All targets of the environment."""
        exists = self._whole.simulator.scenario_state["target_exists"][self.env]
        return [OneTarget(self._whole, self.env, index) for index, flag in enumerate(exists.tolist()) if flag]


def view_of(satellite: BoundSatellite, row: int) -> OneSatellite:
    """Return a read-only view of the satellite of one row [N]."""
    kinds = ((ImagingSatellite, OneImagingSatellite), (AccessSatellite, OneAccessSatellite), (BoundSatellite, OneSatellite))
    return next(view for kind, view in kinds if isinstance(satellite, kind))(satellite, row)


def satellites_of(fleet: SatelliteFleet, env: int) -> list[OneSatellite]:
    """Return the satellites of an episode, by their number."""
    return list(OneOthers(fleet, env).values())
