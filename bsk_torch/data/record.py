"""What a rewarder of one episode keeps of its environment, and how that is saved."""

from __future__ import annotations

import copy
import io
import sys
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from types import BuiltinFunctionType, FunctionType
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from bsk_torch.data.pickled import Pickler, Unpickler
from bsk_torch.sats.one import OneSatellite, OneScenario, OneView
from bsk_torch.sats.one_access import OneAccessSatellite
from bsk_torch.scene.target import Target
from bsk_torch.sim.places import is_target

Filter = Callable[[Mapping[str, Any]], Any]

SHARED: tuple[type, ...] = (FunctionType, BuiltinFunctionType, np.ufunc, type)
"""What copies of a rewarder share with it: functions and classes among its attributes are found again by these."""


class OneReward(Protocol):
    """A rewarder of one episode: its hooks are those of ``bsk_torch.bsk_rl.data.GlobalReward``."""

    data: Any
    data_type: Any
    data_store_type: Any

    def link_scenario(self, scenario: Any) -> None:
        """Keep the scenario."""

    def reset_overwrite_previous(self) -> None:
        """Forget the last episode."""

    def reset_pre_sim_init(self) -> None:
        """Prepare for the episode."""

    def reset_during_sim_init(self) -> None:
        """Prepare for the episode, once satellites have their stores."""

    def reset_post_sim_init(self) -> None:
        """Prepare for the episode, last."""

    def create_data_store(self, satellite: Any) -> None:
        """Give a satellite its store."""

    def reward(self, new_data_dict: dict[str, Any]) -> dict[str, float]:
        """Return the reward of a step by name of satellite."""

    def is_terminated(self, satellite: Any) -> bool:
        """Return whether the episode terminates for a satellite."""

    def is_truncated(self, satellite: Any) -> bool:
        """Return whether the episode is truncated for a satellite."""


class HideImaged:
    """Access filter that hides the targets that a store has imaged."""

    def __init__(self, store: Any) -> None:
        """Hide the targets in ``store.data.imaged``."""
        self.store = store

    def __call__(self, opportunity: Mapping[str, Any]) -> bool:
        """Return whether an opportunity remains."""
        return not is_target(opportunity["type"]) or opportunity["object"] not in self.store.data.imaged


class StoringSatellite:
    """One satellite of one environment, read as :class:`~bsk_torch.sats.one.OneSatellite`, to which attributes can be added.

    ``data_store`` is one of them. Filters that are added hide opportunities of this satellite in this episode.
    """

    def __init__(self, one: OneSatellite) -> None:
        """Add attributes to a view."""
        own = self.__dict__
        own["_one"], own["_filters"] = one, []

    _one: OneSatellite
    _filters: list[Filter]

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the view."""
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.__dict__["_one"], name)

    def __repr__(self) -> str:
        """Return the name and the environment."""
        return f"<{self._one.name} of environment {self._one.env}>"

    def add_access_filter(self, access_filter: Filter, types: Any = None) -> None:
        """Hide opportunities of this satellite for which ``access_filter(opportunity)`` is false."""
        kinds = (types,) if isinstance(types, str) else types
        keep = access_filter if kinds is None else Only(access_filter, tuple(kinds))
        self._filters.append(keep)

    def hide(self, kind: str, allowed: Tensor) -> None:
        """Set the places of a type that a filter hides to False in ``allowed`` [P]."""
        others = [keep for keep in self._filters if not isinstance(keep, HideImaged)]
        if is_target(kind):
            for keep in self._filters:
                if isinstance(keep, HideImaged):
                    for target in keep.store.data.imaged:
                        allowed[target._place[1]] = False
        if others:
            assert isinstance(self._one, OneAccessSatellite)
            for place, opportunity in enumerate(self._one.all_places(kind)):
                if not all(keep(opportunity) for keep in others):
                    allowed[place] = False


class Only:
    """A filter of some types of opportunities."""

    def __init__(self, keep: Filter, kinds: tuple[str, ...]) -> None:
        """Filter ``kinds`` by ``keep``."""
        self.keep, self.kinds = keep, kinds

    def __call__(self, opportunity: Mapping[str, object]) -> Any:
        """Return whether an opportunity remains."""
        return opportunity["type"] not in self.kinds or self.keep(opportunity)


class SingleScenario(OneScenario):
    """The scenario in one environment, as rewarders of one episode read it."""

    def __init__(self, whole: object, env: int, num_envs: int, satellites: list[StoringSatellite]) -> None:
        """View environment ``env`` of a scenario."""
        super().__init__(whole, env, num_envs)
        self.__dict__["satellites"] = satellites

    satellites: list[StoringSatellite]

    @property
    def targets(self) -> list[Any]:
        """The targets."""
        return self._whole.target_objects(self._row)


class Record:
    """A rewarder of one episode, and the satellites with their stores, of one environment.

    Attributes:
        rewarder: Copy of the user's rewarder.
        satellites: Satellites by their number in the episode.
        scenario: View of the scenario.
        steps: Steps that have been scored.
    """

    def __init__(self, rewarder: OneReward, satellites: list[StoringSatellite], scenario: SingleScenario) -> None:
        """Put the parts together; see :meth:`begin`."""
        self.rewarder, self.satellites, self.scenario, self.steps = rewarder, satellites, scenario, 0

    def begin(self) -> None:
        """Start the episode, in bsk_rl's order."""
        rewarder = self.rewarder
        rewarder.link_scenario(self.scenario)
        rewarder.reset_overwrite_previous()
        rewarder.reset_pre_sim_init()
        for satellite in self.satellites:
            rewarder.create_data_store(satellite)
            rewarder.data += satellite.data_store.data
        rewarder.reset_during_sim_init()
        rewarder.reset_post_sim_init()
        for satellite in self.satellites:
            satellite.data_store.update_from_logs()

    def step(self, collecting: Sequence[int]) -> dict[str, float]:
        """Let the stores of the satellites of some numbers read their logs; return the rewards by name."""
        self.steps += 1
        some = [self.satellites[k] for k in collecting]
        return self.rewarder.reward({satellite.name: satellite.data_store.update_from_logs() for satellite in some})

    def share(self, links: list[list[bool]]) -> None:
        """Spread data along ``links`` by sender and receiver; where all are linked with all, they get the sum, as in bsk_rl."""
        stores = [satellite.data_store for satellite in self.satellites]
        pairs = [(a, b) for a in range(len(stores)) for b in range(len(stores)) if a != b and links[a][b]]
        if len(pairs) == len(stores) * (len(stores) - 1):
            whole = type(stores[0].data)()
            for store in stores:
                whole += store.data
            for store in stores:
                store.data = copy.copy(whole)
            return
        for sender, receiver in pairs:
            stores[receiver].stage_communicated_data(stores[sender].data)
        for store in stores:
            store.update_with_communicated_data()

    # -- saving -------------------------------------------------------------------------------------------------------

    def dump(self, given: OneReward, classes: Collection[type]) -> bytes:
        """Return all that may have changed since :meth:`begin`, as bytes; none before the first step.

        Args:
            given: The user's rewarder.
            classes: Classes of objects that are saved; see :func:`classes_of`.

        Raises:
            TypeError: For values that are not plain data.
        """
        if not self.steps:
            return b""
        file = io.BytesIO()
        own = [{name: value for name, value in vars(satellite).items() if name != "_one"} for satellite in self.satellites]
        try:
            Pickler(file, classes, self._name_of(given)).dump((vars(self.rewarder), own, self.steps))
        except (TypeError, RecursionError) as error:
            raise TypeError(
                f"{type(self.rewarder).__name__} or its stores keep values that cannot be saved or copied with an episode: "
                f"{error}. Keep numbers, texts, arrays, targets, satellites and containers of these, in objects of classes of "
                "the rewarder's module; filters may be objects of such a class, not functions"
            ) from error
        return file.getvalue()

    def load(self, saved: bytes, given: OneReward, classes: Collection[type]) -> None:
        """Take over what :meth:`dump` returned; ValueError for bytes that hold more than plain data and own classes."""
        objects = {name: value for value, name in self._named(given)}

        def find(name: Any) -> Any:
            if isinstance(name, int):
                return self.scenario._whole.target_object(self.scenario._row, name)
            return objects[name]

        match Unpickler(io.BytesIO(saved), classes, find).load():
            case dict() as rewarder, list() as own, int() as steps if steps > 0 and len(own) == len(self.satellites):
                parts = [rewarder, *own]
            case _:
                parts = []
        if not parts or not all(isinstance(part, dict) and all(isinstance(name, str) for name in part) for part in parts):
            raise ValueError(f"the state holds no {type(given).__name__} with stores of {len(self.satellites)} satellites")
        self.rewarder.__dict__, self.steps = rewarder, steps
        for satellite, attributes in zip(self.satellites, own, strict=True):
            satellite.__dict__.update(attributes | {"_one": satellite._one})

    def _named(self, given: OneReward) -> list[tuple[Any, str]]:
        """Return the objects that are not saved but found again, with their names."""
        named: list[tuple[Any, str]] = [(self.rewarder, "rewarder"), (self.scenario, "scenario")]
        named += [(satellite, f"satellite {k}") for k, satellite in enumerate(self.satellites)]
        return named + [(value, f"argument {name}") for name, value in vars(given).items() if isinstance(value, SHARED)]

    def _name_of(self, given: OneReward) -> Callable[[Any], Any]:
        """Return the function that names objects which are not saved; targets have their numbers."""
        names = {id(value): name for value, name in self._named(given)}

        def name_of(value: Any) -> Any:
            if (name := names.get(id(value))) is not None:
                return name
            if hasattr(type(value), "_place") and value._place is not None:
                return value._place[1]
            if isinstance(value, OneView):
                raise TypeError(f"{value!r} is a view of the simulation")
            return None

        return name_of


def check_record(saved: bytes, classes: Collection[type]) -> None:
    """Raise ValueError for bytes that :meth:`Record.load` would not read, before anything changes."""
    if saved:
        Unpickler(io.BytesIO(saved), classes, str).check()


def classes_of(given: OneReward) -> set[type]:
    """Return the classes whose objects a rewarder's data may be: those that it consists of.

    They are the classes of the rewarder, of rewarders that it combines, of their stores and data, and the bases of these; what is
    defined in the modules of all of these, and dataclasses that are imported there; and what this package adds to satellites.
    Nothing is imported.
    """
    kinds = set[Any]()
    for part in _rewarders(given):
        store = getattr(part, "data_store_type", None)
        kinds |= {type(part), store, getattr(part, "data_type", None), getattr(store, "data_type", None)} - {None}
    bases = {base for kind in kinds for base in kind.__mro__}
    for module in {base.__module__ for base in bases} - {"builtins", "abc", "typing"}:
        members = vars(sys.modules[module]).values() if module in sys.modules else ()
        bases |= {kind for kind in members if isinstance(kind, type) and (kind.__module__ == module or is_dataclass(kind))}
    return {kind for kind in bases | {HideImaged, Only, Target} if _is_plain(kind)}


def _is_plain(kind: type) -> bool:
    """Whether objects of a class may be made of data: nothing runs when they are made or dropped."""
    return kind.__module__ != "builtins" and not hasattr(kind, "__del__") and not issubclass(kind, defaultdict | type)


def _rewarders(given: OneReward) -> Iterator[Any]:
    """Yield a rewarder, and those that it combines, which it keeps as attributes or in containers."""
    waiting: list[Any] = [given]
    walked = set[int]()
    while waiting:
        part = waiting.pop()
        if id(part) in walked:
            continue
        walked.add(id(part))
        if isinstance(part, Mapping):
            waiting += part.values()
        elif isinstance(part, list | tuple):
            waiting += part
        elif hasattr(part, "data_store_type") and not isinstance(part, type):
            yield part
            waiting += vars(part).values()
