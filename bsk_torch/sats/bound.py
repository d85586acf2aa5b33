"""The satellites of one type in an environment: what hooks and user functions read."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

import torch
from torch import Tensor

from bsk_torch.sats.others import Others, OtherSatellite
from bsk_torch.sats.satellite import Satellite
from bsk_torch.sats.task_state import TaskState
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.names import nearest
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.state import StateTable

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet

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
    sat_args: Mapping[str, Any]
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

    # -- views --------------------------------------------------------------------------------------------------------

    def member(self, number: int, times: int = 1) -> OtherSatellite:
        """Return a read-only view of one satellite of each environment, whose tensors are [num_envs * times, ...].

        Args:
            number: Index of the satellite among those of the type.
            times: Number of repetitions of each row.
        """
        return OtherSatellite(self, number, times)

    def title(self, row: int) -> str:
        """Return the name of the satellite of a row [N] in errors."""
        env, k = divmod(row, len(self.names))
        return f"environment {env}" if len(self.names) == 1 else f"satellite {self.names[k]} of environment {env}"

    # -- reading ------------------------------------------------------------------------------------------------------

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
        alive = torch.ones_like(self.simulator.state.ticks, dtype=torch.bool)
        for check in self.aliveness().values():
            alive = alive & check
        return alive


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
    unique = tuple(base for base in bases if not any(other is not base and issubclass(other, base) for other in bases))
    names = {"__module__": described.__module__, "__qualname__": described.__qualname__, "__doc__": described.__doc__}
    return type(described.__name__, unique, names)


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
