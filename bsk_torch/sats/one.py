"""One satellite of one environment, as seen by a function written for bsk_rl.

In an environment, a satellite stands for all satellites of its type in all episodes, and its properties are tensors [N, ...]. A
:class:`OneSatellite` is a read-only view of one of those rows: properties of the package are NumPy arrays and Python numbers of
that row, and properties and methods that a user has added run with the view as ``self``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from numpy.typing import NDArray
from torch import Tensor

from bsk_torch.sats.others import OneOthers
from bsk_torch.sim.names import nearest
from bsk_torch.sim.readout.observables import observable

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite

Numbers: TypeAlias = "Tensor | NDArray[Any] | float"
"""Numbers of all satellites, a tensor, or of the one of a row, an array or a number."""

OWN_PACKAGE = __name__.partition(".")[0] + "."

READ_ONLY = (
    "the view of one environment is read-only; set sat_args, or keep values that are reset with every episode "
    "in satellite.simulator.memory: memory.declare(name, initial_value)"
)


def is_ours(owner: type) -> bool:
    """Return whether a class belongs to this package."""
    return owner.__module__.startswith(OWN_PACKAGE)


def of_row(value: object, row: int) -> Any:
    """Return one row of a tensor [N, ...] as a Python number or a new NumPy array; likewise in tuples and dictionaries.

    Anything else is the same for all rows.
    """
    if isinstance(value, Tensor):
        mine = value[row]
        return mine.item() if mine.ndim == 0 else mine.detach().cpu().numpy().copy()
    if isinstance(value, tuple) and any(isinstance(part, Tensor) for part in value):
        return tuple(of_row(part, row) for part in value)
    if isinstance(value, dict):
        return {name: of_row(part, row) for name, part in value.items()}
    return value


class OneView:
    """Read-only view of what one row has of an object that stands for all rows.

    Attributes of the package's classes are evaluated for all rows, and read at the row. Properties and methods of a user's class
    run with the view as ``self``; a property for which that fails is one for all rows, and read at the row.
    """

    def __init__(self, whole: object, row: int, rows: int) -> None:
        """View row number ``row`` of ``rows``."""
        own = self.__dict__
        own["_whole"], own["_row"], own["_rows"] = whole, row, rows

    _whole: Any
    _row: int
    _rows: int

    def __setattr__(self, name: str, value: object) -> None:
        """Raise AttributeError: views are read-only."""
        raise AttributeError(f"{name!r} cannot be set: {READ_ONLY}")

    def __repr__(self) -> str:
        """Name the class and the row."""
        return f"<{type(self._whole).__name__} of row {self._row}>"

    def __getattr__(self, name: str) -> Any:
        """Return an attribute as the row has it; AttributeError if there is none, or none for a single row."""
        whole = self._whole
        if name.startswith("__"):
            raise AttributeError(name)
        for owner in type(whole).__mro__:
            if name in vars(owner):
                return self._of_class(name, vars(owner)[name], owner)
        if name in vars(whole):
            return vars(whole)[name]
        raise AttributeError(f"{type(whole).__name__} has no attribute {name!r}; {nearest(name, dir(whole))}")

    def _of_class(self, name: str, member: Any, owner: type) -> Any:
        if isinstance(member, property | cached_property):
            batched = is_ours(owner) or isinstance(member, observable)
            return self._of_all(name) if batched else self._of_user(name, member)
        if not callable(member) or isinstance(member, staticmethod | classmethod | type):
            return getattr(self._whole, name)
        return self._call(name) if is_ours(owner) else member.__get__(self)

    def _of_all(self, name: str) -> Any:
        value = getattr(self._whole, name)
        return (lambda: of_row(value(), self._row)) if callable(value) else of_row(value, self._row)  # aliveness checks

    def _of_user(self, name: str, member: property | cached_property[Any]) -> Any:
        function: Any = member.fget if isinstance(member, property) else member.func
        try:
            return function(self)
        except Exception as error:
            try:
                value = getattr(self._whole, name)
            except Exception:
                raise error from None
            if not isinstance(value, Tensor) or value.shape[:1] != (self._rows,):
                raise
            return of_row(value, self._row)

    def _call(self, name: str) -> Callable[..., Any]:
        """Return a method of the package, called for all rows and read at this one."""

        def call(*args: object, **options: object) -> Any:
            return of_row(getattr(self._whole, name)(*args, **options), self._row)

        return call


class OneArguments(Mapping[str, Any]):
    """Arguments of the current episode by name: numbers, NumPy arrays, and what is neither."""

    def __init__(self, whole: Mapping[str, object], row: int) -> None:
        """View row number ``row`` of the arguments [N, ...] of all rows."""
        self._whole, self._row = whole, row

    def __getitem__(self, name: str) -> Any:
        """Return an argument of the row; KeyError for an unknown name."""
        return of_row(self._whole[name], self._row)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self._whole)

    def __len__(self) -> int:
        """Number of arguments."""
        return len(self._whole)


class OneSimulator(OneView):
    """The simulation at one row: time, world, and declared memory."""

    def __init__(self, satellite: BoundSatellite, row: int, rows: int) -> None:
        """View the simulation of a satellite."""
        super().__init__(satellite.simulator, row, rows)
        self.__dict__["_satellite"] = satellite

    _satellite: BoundSatellite

    @property
    def time_limit(self) -> float:
        """Time limit of the episode, s."""
        return of_row(self._satellite.time_limit, self._row)

    @property
    def sim_time_ns(self) -> int:
        """Time since reset, ns."""
        return of_row(self._whole.state.sim_time_ns, self._row)

    @property
    def sim_rate(self) -> float:
        """Length of a tick, s."""
        return self._whole.h

    @property
    def world(self) -> OneView:
        """Sun, Earth and ground stations."""
        return OneView(self._whole.world, self._row, self._rows)

    def get_satellite(self, name: str) -> OneSatellite:
        """Return a satellite of the episode; KeyError for an unknown name."""
        return self._satellite.one(self._row).others[name]

    @property
    def memory(self) -> OneArguments:
        """Declared values of the row by name."""
        return OneArguments(self._whole.memory, self._row)


class OneModel(OneView):
    """A dynamics or flight-software model at one row."""

    @property
    def satellite(self) -> OneSatellite:
        """The satellite."""
        return self._whole.satellite.one(self._row)

    @property
    def storageUnit(self) -> StorageUnit:
        """The store, with ``storageUnitDataOutMsg.read()``; AttributeError for models without one."""
        return StorageUnit(self)

    @property
    def instrument(self) -> StorageUnit:
        """The instrument, with ``nodeBaudRate``, bit/s; AttributeError for models without one."""
        return StorageUnit(self)

    @property
    def dynamics(self) -> OneModel:
        """The dynamics model of the satellite."""
        return self.satellite.dynamics

    @property
    def fsw(self) -> OneModel:
        """The flight-software model of the satellite."""
        return self.satellite.fsw

    @property
    def simulator(self) -> OneSimulator:
        """The simulation."""
        return self.satellite.simulator

    @property
    def world(self) -> OneView:
        """Sun, Earth and ground stations."""
        return self.simulator.world


class StorageMessage(NamedTuple):
    """What Basilisk's store reports: data and capacity, bit, and data of each partition, bit, with their names."""

    storageLevel: float
    storageCapacity: float
    storedData: Any
    storedDataName: list[str]


class StorageUnit:
    """Store and instrument of one satellite under the names of Basilisk that bsk_rl's data stores read."""

    def __init__(self, model: OneModel) -> None:
        """Read a dynamics model; AttributeError for one that stores nothing."""
        self._model = model
        _ = model.storage_level

    @property
    def storageUnitDataOutMsg(self) -> StorageUnit:
        """The message, which :meth:`read` reads."""
        return self

    @property
    def nodeBaudRate(self) -> float:
        """Rate of the instrument, bit/s, or data of an image, bit."""
        return self._model.instrument_baud

    def read(self) -> StorageMessage:
        """Return what is stored now."""
        model = self._model
        levels, names = model.partition_levels, model.satellite.sat_args.get("bufferNames")
        named = [str(k) for k in range(len(levels))] if names is None else list(names)
        return StorageMessage(model.storage_level, model.satellite.sat_args["dataStorageCapacity"], levels, named)


class OneScenario(OneView):
    """The scenario in one environment."""


class OneSatellite(OneView):
    """One satellite of one environment; :meth:`bsk_torch.sats.BoundSatellite.one` makes it.

    As in bsk_rl, ``satellite.dynamics.r_BN_N`` is an array [3], ``satellite.simulator.sim_time`` a number of seconds and
    ``satellite.sat_args[name]`` the drawn argument.
    """

    def __init__(self, satellite: BoundSatellite, row: int) -> None:
        """View the satellite of row ``row`` of all N of its type: number ``row % count`` of environment ``row // count``."""
        state = satellite.simulator.state
        if not 0 <= row < state.rows:
            raise IndexError(f"row={row} must be from 0 to {state.rows - 1}, one for each satellite of the type")
        super().__init__(satellite, row, state.rows)
        self.__dict__["_env"], self.__dict__["_number"] = divmod(row, state.count)

    _env: int
    _number: int

    @property
    def name(self) -> str:
        """Name of the satellite."""
        return self._whole.names[self._number]

    @property
    def id(self) -> str:
        """The name, as in bsk_rl."""
        return self.name

    @property
    def env(self) -> int:
        """Number of the environment."""
        return self._env

    @property
    def simulator(self) -> OneSimulator:
        """The simulation of the satellite."""
        return OneSimulator(self._whole, self._row, self._rows)

    @property
    def dynamics(self) -> OneModel:
        """The dynamics model."""
        return OneModel(self._whole.dynamics, self._row, self._rows)

    @property
    def fsw(self) -> OneModel:
        """The flight-software model."""
        return OneModel(self._whole.fsw, self._row, self._rows)

    @property
    def sat_args(self) -> OneArguments:
        """Arguments of the current episode."""
        return OneArguments(self._whole.sat_args, self._row)

    @property
    def others(self) -> OneOthers:
        """The satellites of the episode by name, itself included, as such views."""
        return OneOthers(self._whole, self._env)

    @property
    def data_store(self) -> Any:
        """Store of the satellite in the rewarder: ``data_store.data``; AttributeError for rewarders without stores."""
        whole = self._whole
        return whole.rewarder.store_of_one(whole.type_index, self._row) if whole.data_store is not None else None

    @property
    def scenario(self) -> OneScenario:
        """The scenario in the environment of the satellite."""
        return OneScenario(self._whole.scenario, self._env, self._whole.simulator.num_envs)
