"""The satellites of an environment: a fleet of several types, the satellites of one type, and views of single ones."""

from __future__ import annotations

import copy
import functools
import operator
from collections.abc import Callable, Iterator, Mapping
from functools import cache, cached_property
from typing import Any, TypeAlias, TypeVar

import numpy as np
import torch
from torch import Tensor

from bsk_torch.sats.satellite import Satellite
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.component import UserArguments
from bsk_torch.sim.fleet import Fleet
from bsk_torch.sim.names import nearest
from bsk_torch.sim.readout.observables import observable
from bsk_torch.sim.run.encounters import NEVER
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.state import StateTable


class SatelliteFleet(Fleet):
    """The satellites of N episodes, S in each."""

    satellites: tuple[BoundSatellite, ...] = ()

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Number of episodes N and of satellites S, of tables [N, S]."""
        return self.num_envs, self.size

    def find(self, name: str) -> tuple[BoundSatellite, int]:
        """Return the satellites of the type of a named one, and its number within the type; KeyError for an unknown name."""
        k, number = self.place_of(name)
        if not self.satellites:
            raise RuntimeError(f"satellite {name!r} is not there yet: others are seen in get_obs(), not in link_satellite()")
        return self.satellites[k], number

    def satellite(self, name: str) -> OtherSatellite:
        """Return a satellite of every episode by its name: its tensors are [N, ...], a row for each episode.

        See :class:`bsk_torch.sats.bound.OtherSatellite`; KeyError for an unknown name, with the nearest one.
        """
        whole, number = self.find(name)
        return OtherSatellite(whole, number, 1)

    def want(self, *names: str) -> None:
        """Let the kernel that reads what is observed compute properties of dynamics models, too, where satellites have them."""
        for part in self.satellites:
            found = [getattr(type(part.dynamics), name, None) for name in names]
            part.simulator.observer.want([each.function for each in found if isinstance(each, observable)])

    def each(self, read: Callable[[Any], Tensor], missing: float = 0.0) -> Tensor:
        """Return ``read`` of every satellite, [N, S, ...]; ``missing`` for types without it, AttributeError if no type has it."""
        if len(self.satellites) == 1:
            return self.joined([read(self.satellites[0])])
        values: list[Tensor | None] = []
        lacking: AttributeError | None = None
        for satellite in self.satellites:
            try:
                values.append(read(satellite))
            except AttributeError as error:
                values.append(None)
                lacking = error
        tables = [value for value in values if value is not None]
        if not tables:
            raise lacking or AttributeError("there are no satellites")
        blank = tables[0].new_full((1, *tables[0].shape[1:]), missing)
        return self.joined(
            [
                blank.expand(simulator.state.rows, *blank.shape[1:]) if value is None else value
                for value, simulator in zip(values, self.simulators, strict=True)
            ]
        )


SatelliteLike: TypeAlias = "BoundSatellite | OtherSatellite"
"""What functions of satellites get: all of a type, or another one of each episode."""

PLAIN = (int, float, str, bytes, type(None), type, np.ndarray, np.generic, torch.dtype, torch.device)
"""Values that are the same for all rows."""

Take = Callable[[Any], Any]


def aligned(value: object, rows: int, take: Take) -> Any:
    """Return a value whose tensors of ``rows`` rows are replaced by what ``take`` makes of them, also within containers.

    Functions give aligned results, and objects show aligned attributes.
    """
    if isinstance(value, Tensor):
        return take(value) if value.ndim and len(value) == rows else value
    if isinstance(value, PLAIN):
        return value
    if isinstance(value, tuple | list):
        parts = [aligned(part, rows, take) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if isinstance(value, dict):
        return {name: aligned(part, rows, take) for name, part in value.items()}
    if callable(value):
        return lambda *args, **options: aligned(value(*args, **options), rows, take)
    return Aligned(value, rows, take)


class Aligned:
    """Read-only view of an object whose tensors have other rows than those of the satellite that looks at it."""

    def __init__(self, whole: object, rows: int, take: Take) -> None:
        """View ``whole``, whose tensors have ``rows`` rows; ``take`` makes a tensor with the rows of the view of one."""
        attributes = self.__dict__
        attributes["_whole"], attributes["_rows"], attributes["_take"] = whole, rows, take

    _whole: Any
    _rows: int
    _take: Take

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return aligned(getattr(self._whole, name), self._rows, self._take)

    def __getitem__(self, name: object) -> Any:
        return aligned(self._whole[name], self._rows, self._take)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{name!r} cannot be set: another satellite is shown to be read")

    def __repr__(self) -> str:
        return f"<{type(self._whole).__name__} of another satellite>"


class OtherSatellite(Aligned):
    """A satellite of the same episodes: ``dynamics``, ``fsw``, ``sat_args`` and the rest, as of a :class:`BoundSatellite`.

    Tensors have the rows of the satellite that asks: ``satellite.others["RSO"].dynamics.r_BN_N`` is [N, 3], alongside
    ``satellite.dynamics.r_BN_N``.
    """

    def __init__(self, whole: BoundSatellite, number: int, times: int) -> None:
        """View satellite ``number`` of those of the type ``whole``, for ``times`` rows of each episode."""
        state = whole.simulator.state
        count = state.count

        def take(value: Tensor) -> Tensor:
            rows = value if count == 1 else value.view(-1, count, *value.shape[1:])[:, number]
            return rows if times == 1 else rows.repeat_interleave(times, 0)

        super().__init__(whole, state.rows, take)
        self.__dict__["name"] = self.__dict__["id"] = whole.names[number]


class Others(Mapping[str, OtherSatellite]):
    """The satellites of an episode by name, as one of its types sees them, itself included."""

    def __init__(self, satellite: BoundSatellite) -> None:
        """Show the satellites of the fleet to a ``satellite``."""
        self._satellite, self._fleet = satellite, satellite.fleet

    def __getitem__(self, name: str) -> OtherSatellite:
        whole, number = self._fleet.find(name)
        return OtherSatellite(whole, number, self._satellite.simulator.count)

    def __iter__(self) -> Iterator[str]:
        return iter(self._fleet.places)

    def __len__(self) -> int:
        return len(self._fleet.places)


class TaskState(StateTable):
    """Tasks in progress of N satellites."""

    previous_action: Tensor  # key of the last action, or of the one in progress; see Decision
    dead: Tensor  # which satellites have died
    requires_retasking: Tensor  # which have no task left
    ends: Tensor  # tick since reset at which the task's time is up
    action: Tensor  # the action in progress, which the builder of actions declares: its number [N], or its values [N, A]
    task_duration: Tensor  # its duration, s
    expected: Tensor  # tick at which it will probably end

    def __init__(self, num_envs: int, count: int, device: torch.device) -> None:
        """Make the table; no satellite has a task."""
        super().__init__(num_envs, count, device)
        self.declare("previous_action", -1)
        self.declare("dead", False)
        self.declare("requires_retasking", True)
        self.declare("ends", NEVER, low=0, high=NEVER)
        self.declare("task_duration", 0.0, low=0.0)
        self.declare("expected", NEVER, low=0, high=NEVER)


Bound = TypeVar("Bound", bound="BoundSatellite")


class BoundSatellite(Satellite):
    """The N satellites of one type in an environment; rows as in their simulator.

    The class of an instance is composed of the user's class and of this one, so that methods of the user's class run on it.

    Attributes:
        fleet: All satellites of the environment.
        type_index: Number of the type in the fleet.
        simulator: Simulation of the satellites.
        task: Their tasks in progress, which are part of the state.
        names: Names of the satellites of this type in an episode.
        dynamics, fsw: Their models, instances of the user's classes.
        memory: Tensors [N, ...] reset with every episode; ``memory.declare(name, initial, *shape)`` adds one.
        sat_args: Arguments of the current episodes by name, [N, ...] each, float64.
        others: The satellites of the episodes by name: ``satellite.others["RSO"].dynamics.r_BN_N`` is [N, 3], with the rows of
            this type. KeyError for an unknown name, with the nearest one. Available in observations, but not while they are
            linked.
        scenario: Scenario of the environment; None until it has been linked.
        rewarder: Rewarder of the environment; None until it has been linked.
        action_description: Name of every action.
        observation_description: Name of every entry of the observation vector.
    """

    fleet: SatelliteFleet
    type_index: int
    simulator: Simulator
    task: TaskState
    names: tuple[str, ...]
    dynamics: Any
    fsw: Any
    memory: StateTable
    sat_args: UserArguments
    others: Others
    scenario: Any
    rewarder: Any
    action_description: list[str]
    observation_description: list[str]

    @classmethod
    def of(cls: type[Bound], satellite: Satellite, fleet: SatelliteFleet, type_index: int) -> Bound:
        """Return the satellites of type number ``type_index`` of a fleet, as a description of the user says."""
        made: Any = copy.copy(satellite)
        made.__class__ = composed(type(satellite), cls)  # type: ignore[arg-type]  # mypy: a class is not Hashable
        made._join(fleet, type_index)
        return made

    def _join(self, fleet: SatelliteFleet, type_index: int) -> None:
        self.fleet, self.type_index, self.simulator = fleet, type_index, fleet.simulators[type_index]
        self.names = tuple(fleet.names[column] for column in fleet.columns[type_index].tolist())
        self.dynamics, self.fsw = self.dyn_type(self.simulator), self.fsw_type(self.simulator)
        self.dynamics.satellite = self.fsw.satellite = self
        state = self.simulator.state
        self.task = TaskState(state.num_envs, state.count, state.device)
        state.add("task", self.task)
        self.memory, self.sat_args = state.memory, Arguments(state)
        self.others = Others(self)
        self.scenario = self.rewarder = None
        self.observation_description = []

    @property
    def data_store(self) -> Any:
        """Knowledge of the satellites, stored by the rewarder, in ``data_store.data``; AttributeError if there is none."""
        store_of = getattr(self.rewarder, "store_of", None)
        if store_of is None:
            raise AttributeError(f"{type(self.rewarder).__name__} keeps no data of satellites; data.UniqueImageReward does")
        return store_of(self.type_index)

    @property
    def time_limit(self) -> Tensor:
        """Time limits of the episodes, [N] s."""
        return self.of_env(self.fleet.state.time_limit)

    @property
    def removed(self) -> Tensor | None:
        """Satellites that are absent or have left, [N], for which queries return nothing; None if there can be none."""
        return self.rows_of(self.fleet.state.removed) if self.fleet.size > 1 else None

    @property
    def present(self) -> Tensor:
        """Satellites that take part in their episodes, dead or alive, [N]; see :meth:`bsk_torch.scene.Scenario.present`."""
        present = self.simulator.present
        return torch.ones_like(self.task.dead) if present is None else present

    @property
    def opportunity_types(self) -> tuple[str, ...]:
        """Kinds of opportunities that the satellites have; none."""
        return ()

    @property
    def functions(self) -> list[UserFunction]:
        """User functions that the satellites call; an environment tries them when it is built."""
        return []

    def title(self, row: int) -> str:
        """Return the name of the satellite of a row [N] in errors."""
        env, k = divmod(row, len(self.names))
        return f"environment {env}" if len(self.names) == 1 else f"satellite {self.names[k]} of environment {env}"

    def rows_of(self, table: Tensor) -> Tensor:
        """Return the rows [N, ...] of these satellites from a table of all satellites, [environments, S, ...].

        Such tables are declared by rewarders and communicators with ``fleet.size``: ``fleet.memory[name]``.
        """
        return self.fleet.rows_of(self.type_index, table)

    def of_env(self, table: Tensor) -> Tensor:
        """Return the rows [N, ...] of these satellites from a table of the environments, [environments, ...]."""
        return self.simulator.state.of_env(table)

    def next_eclipse(self, sampled: bool = False) -> tuple[Tensor, Tensor]:
        """Return the next start and the next end of an eclipse, [N] s since reset.

        An eclipse is the time in the Earth's umbra. Within one, the end is that of the present one and the start that of the next
        one. The search looks ahead for 1.1 revolutions, 12,000 s at least and two days at most; without a start, or an end, the
        time at which the search ends is returned. Eclipses shorter than 30 s may be missed.

        Args:
            sampled: Whether to return the answers of a search on samples, as always under ``compat="bsk_rl"``: later by up to
                30 s, and one second after reset if its search, of 6,000 s, fails, though an eclipse may come, and a later query
                may find it.
        """
        return self.simulator.lookahead.next_eclipse(self.simulator.state.sim_time, sampled)

    def aliveness(self) -> dict[str, Tensor]:
        """Return the result [N] of every aliveness check of dynamics and flight software, by name."""
        others = self.fleet.encounters.checks_of_deputies(self.type_index)
        return {**self.dynamics.aliveness(), **self.fsw.aliveness(), **others}

    def is_alive(self) -> Tensor:
        """Return whether every aliveness check holds now, [N]."""
        checks = self.aliveness().values()
        if not checks:
            return torch.ones_like(self.simulator.state.ticks, dtype=torch.bool)
        return functools.reduce(operator.and_, checks)


Satellite.bound_type = BoundSatellite


@cache
def composed(described: type[Satellite], bound: type[BoundSatellite]) -> type[BoundSatellite]:
    """Return the class of bound satellites whose description is of the class ``described``.

    Methods are looked up in the user's classes first, then in ``bound``, in what the package adds to satellites of that kind
    (``bound_type``), and in the package's descriptions.
    """
    bases: tuple[type[Satellite], ...] = (bound, described.bound_type)
    if not issubclass(described.bound_type, described):  # else it is the package's own, which comes last
        bases = (described, *bases)
    unique = [base for base in dict.fromkeys(bases) if not any(other is not base and issubclass(other, base) for other in bases)]
    names = {"__module__": described.__module__, "__qualname__": described.__qualname__, "__doc__": described.__doc__}
    return type(described.__name__, tuple(unique), names)


def link_entry(entry: Any, satellite: BoundSatellite) -> None:
    """Link an action or observation; TypeError if its ``link_satellite`` does not call the one of its base class."""
    entry.link_satellite(satellite)
    if getattr(entry, "satellite", None) is not satellite:
        raise TypeError(f"{type(entry).__name__}.link_satellite(satellite) must call super().link_satellite(satellite)")


class Arguments(Mapping[str, Any]):
    """Arguments of the current episodes by name, looked up when read; a wrong name is answered with the nearest right one."""

    def __init__(self, state: SatelliteState) -> None:
        """Read the arguments of a ``state``."""
        self._state = state

    def __getitem__(self, name: str) -> Any:
        try:
            return self._state.argument(name)
        except KeyError:
            raise KeyError(f"sat_args has no {name!r}; {nearest(name, self)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter((*self._state.arguments, *self._state.constants))

    def __len__(self) -> int:
        return len(self._state.arguments.places) + len(self._state.constants)
