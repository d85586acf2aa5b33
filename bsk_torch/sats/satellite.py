"""The satellite: a list of observations, a list of actions, and the models that simulate it."""

from __future__ import annotations

import copy
import keyword
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor

from bsk_torch._checks import switch, text
from bsk_torch.sats.dtypes import as_dtype
from bsk_torch.sats.hooks import check_satellite
from bsk_torch.sats.one import OneSatellite
from bsk_torch.sats.others import Others, OtherSatellite
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.argument_table import ArgumentTable
from bsk_torch.sim.composition import compose
from bsk_torch.sim.dyn.models import BasicDynamicsModel, DynamicsModel
from bsk_torch.sim.fsw.models import BasicFSWModel, FSWModel
from bsk_torch.sim.given import Given, expand
from bsk_torch.sim.hooks import check_tensor
from bsk_torch.sim.params import nearest
from bsk_torch.sim.satellite_state import SatelliteState
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.state import StateTable

VECTOR_TYPES = (torch.Tensor, np.ndarray, list)
"""Values of ``obs_type`` that mean one vector; the latter two are bsk_rl's."""


class _Arguments(Mapping[str, Any]):
    """Arguments of the present episodes by name, looked up when read; a wrong name is answered with the nearest right one."""

    def __init__(self, state: SatelliteState) -> None:
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


class Actions(Protocol):
    """Actions of the satellites of one type; see :class:`bsk_torch.act.base.ActionBuilder`."""

    entries: tuple[Any, ...]
    n_actions: int
    n_negative_actions: int

    @property
    def description(self) -> list[str]:
        """Name of every action."""

    def entry_of(self, action: Any) -> int:
        """Return the number of the entry of ``action_spec`` that an action belongs to."""

    def title(self, action: Tensor) -> str:
        """Return what an action is called."""

    def table(self) -> Any:
        """Return the modes and durations of the actions that have fixed ones."""

    def mask(self) -> Tensor:
        """Return a mask of the legal actions, [N, n_actions]."""


class Observations(Protocol):
    """Observations of the satellites of one type; see :class:`bsk_torch.obs.base.ObservationBuilder`."""

    entries: tuple[Any, ...]

    def get_dict(self) -> dict[str, Any]:
        """Return the observations by name, [N, ...] each."""

    def get_vector(self, dtype: torch.dtype) -> Tensor:
        """Return the observations as one vector, [N, O]."""


class Group(Protocol):
    """Satellites of one type in an environment; see :class:`bsk_torch.env.satellite_group.SatelliteGroup`."""

    simulator: Simulator
    dynamics: Any
    fsw: Any
    names: tuple[str, ...]
    scenario: Any
    rewarder: Any
    fleet: Any
    index: int
    observation_description: list[str]

    @property
    def actions(self) -> Actions:
        """Actions of the satellites."""

    @property
    def observations(self) -> Observations:
        """Observations of the satellites."""

    @property
    def time_limit(self) -> Tensor:
        """Time limits of the episodes, [N] s."""

    @property
    def removed(self) -> Tensor | None:
        """Satellites that have left their episodes, [N]."""


class Satellite:
    """An agent. Subclasses set ``observation_spec``, ``action_spec``, ``dyn_type`` and ``fsw_type``.

    ``dyn_type`` and ``fsw_type`` are written as a class of :mod:`bsk_torch.sim.dyn` or :mod:`bsk_torch.sim.fsw`, or as a tuple of
    classes, of which the first wins; they are read as the one class that these stand for.
    """

    observation_spec: ClassVar[Sequence[Any]] = ()
    action_spec: ClassVar[Sequence[Any]] = ()
    dyn_type: ClassVar[Any] = BasicDynamicsModel
    fsw_type: ClassVar[Any] = BasicFSWModel
    opportunity_types: tuple[str, ...] = ()
    view_type: ClassVar[type[OneSatellite]] = OneSatellite

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse definitions that no environment would use, by a TypeError with advice."""
        super().__init_subclass__(**options)
        check_satellite(cls, Satellite)
        cls._compose_models()

    def __init__(
        self,
        name: str,
        sat_args: Mapping[str, Any] | Callable[[], Mapping[str, Any]] | None = None,
        *,
        obs_type: type = torch.Tensor,
        dtype: Any = None,
        variable_interval: bool = True,
    ) -> None:
        """Describe a satellite; an environment makes its own copy and simulates that.

        Args:
            name: A Python identifier.
            sat_args: Arguments of the models that differ from :meth:`default_sat_args`: constants, distributions of
                :mod:`bsk_torch.rand`, or callables without arguments; or one callable that returns a dictionary of them, for
                values that depend on one another.
            obs_type: ``torch.Tensor`` for one vector, ``dict`` for named observations; bsk_rl's ``np.ndarray`` and ``list`` mean
                one vector, too.
            dtype: Type of observations, of torch or NumPy, unless the environment names one; all satellites of an environment
                have the same.
            variable_interval: Whether the end of an action ends the step; else steps last ``max_step_duration``.
        """
        if not text("name", name).isidentifier() or keyword.iskeyword(name):
            raise ValueError(f"name={name!r} must be a Python identifier, such as 'Scanner1'")
        if obs_type is not dict and not any(obs_type is kind for kind in VECTOR_TYPES):
            raise ValueError(f"obs_type={obs_type!r} must be dict, or one of torch.Tensor, np.ndarray and list for one vector")
        self.name, self.obs_type = name, dict if obs_type is dict else torch.Tensor
        self.variable_interval = switch("variable_interval", variable_interval)
        self.dtype = as_dtype(dtype)
        self._compose_models()
        self.sat_args_generator = Given(expand(sat_args, "sat_args"), type(self).default_sat_args(), "sat_args")

    @classmethod
    def default_sat_args(cls, **overrides: Any) -> ArgumentTable:
        """Return every argument that ``sat_args`` accepts, with its default or the given value.

        Raises:
            KeyError: For a value of an unknown argument.
        """
        cls._compose_models()
        return ArgumentTable((*cls.dyn_type.all_components(), *cls.fsw_type.all_components()), overrides)

    @classmethod
    def get_dyn_type(cls) -> type[DynamicsModel]:
        """Return the dynamics model that ``dyn_type`` stands for."""
        cls._compose_models()
        return cls.dyn_type

    @classmethod
    def get_fsw_type(cls) -> type[FSWModel]:
        """Return the flight-software model that ``fsw_type`` stands for."""
        cls._compose_models()
        return cls.fsw_type

    @classmethod
    def _compose_models(cls) -> None:
        """Replace tuples of models, where they were written, by the classes that they stand for; TypeError for what is none."""
        for name, base in (("dyn_type", DynamicsModel), ("fsw_type", FSWModel)):
            owner = next(other for other in cls.__mro__ if name in vars(other))
            setattr(owner, name, compose(getattr(owner, name), base, owner.__name__))

    # -- in an environment --------------------------------------------------------------------------------------------

    def generation(self, limit: Tensor) -> Tensor:
        """Return the seconds for which access windows are generated at reset, given time limits [n]; zero here."""
        return torch.zeros_like(limit)

    @property
    def segment(self) -> float:
        """Seconds by which access windows are extended."""
        return 600.0

    def as_given(self) -> Satellite:
        """Return a copy that later changes of ``sat_args_generator`` do not reach, with the flight software of its actions."""
        copied = copy.copy(self)
        copied.sat_args_generator = copy.copy(self.sat_args_generator)
        added = [entry.fsw_type for entry in self.action_spec if getattr(entry, "fsw_type", None) is not None]
        if added:
            copied.fsw_type = compose((self.fsw_type, *added), FSWModel)  # type: ignore[misc]
        return copied

    def bound_to(self, group: Group) -> Satellite:
        """Return a copy that represents all satellites of a group in an environment."""
        copied = copy.copy(self)
        copied.group = group
        return copied

    def on_bind(self) -> None:
        """Declare memory and the like; called once on the copy in an environment, before actions and observations are linked."""

    def note_events(self, event: Tensor) -> None:
        """Record the events of a run: ``event`` [N] is true where one ended the actions that wait for it."""

    def legal_actions(self) -> Tensor | None:
        """Return which actions are legal now beside their own masks, [N, n_actions]; None for all of them."""
        return None

    def action_mask(self) -> Tensor:
        """Return which actions are legal now, [N, n_actions]; all of them where none would be."""
        mask, legal = self.actions.mask(), self.legal_actions()
        if legal is not None:
            check_tensor(f"{type(self).__name__}.legal_actions()", legal, mask.shape, torch.bool)
        mask = mask if legal is None else mask & legal
        return mask | ~mask.any(1, keepdim=True)

    def counts(self) -> dict[str, Tensor]:
        """Return the counters of the present episodes, [N] each, by name."""
        return {}

    def one(self, row: int) -> OneSatellite:
        """Return a read-only view of the satellite of one row [N], which answers as a satellite of bsk_rl does.

        Its properties are NumPy arrays and Python numbers; see :mod:`bsk_torch.sats.one`. With one satellite of the type in each
        environment, ``row`` is the number of the environment.
        """
        return self.view_type(self, row)

    def member(self, number: int, times: int = 1) -> OtherSatellite:
        """Return a read-only view of one satellite of each environment, whose tensors are [num_envs * times, ...].

        Args:
            number: Its number among those of the type.
            times: How often each row is repeated.
        """
        return OtherSatellite(self, number, times)

    @property
    def others(self) -> Others:
        """The satellites of the episodes by name: ``satellite.others["RSO"].dynamics.r_BN_N`` is [N, 3], beside one's own rows.

        KeyError for an unknown name, with the nearest one. They are there when observations are made, not when they are linked.
        """
        return Others(self)

    @property
    def functions(self) -> list[UserFunction]:
        """Functions of users that the satellite calls; an environment tries them when it is built."""
        return []

    def title(self, row: int) -> str:
        """Return the name of the satellite of a row [N] in errors."""
        env, k = divmod(row, len(self.names))
        return f"environment {env}" if len(self.names) == 1 else f"satellite {self.names[k]} of environment {env}"

    group: Group
    """Group of the satellite in its environment; set in environments only."""

    @property
    def simulator(self) -> Simulator:
        """Simulation of the satellites."""
        return self.group.simulator

    @property
    def dynamics(self) -> Any:
        """Dynamics model."""
        return self.group.dynamics

    @property
    def fsw(self) -> Any:
        """Flight-software model."""
        return self.group.fsw

    @property
    def actions(self) -> Actions:
        """Actions, see :class:`bsk_torch.act.base.ActionBuilder`."""
        return self.group.actions

    @property
    def observations(self) -> Observations:
        """Observations, see :class:`bsk_torch.obs.base.ObservationBuilder`."""
        return self.group.observations

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each satellite of an episode that is of this type."""
        return self.group.names

    @property
    def scenario(self) -> Any:
        """Scenario of the environment."""
        return self.group.scenario

    @property
    def rewarder(self) -> Any:
        """Rewarder of the environment; None where there is none, as in a fleet of its own."""
        return self.group.rewarder

    @property
    def data_store(self) -> Any:
        """What the satellites know, as the rewarder keeps it, in ``data_store.data``; AttributeError for rewarders without it."""
        store_of = getattr(self.rewarder, "store_of", None)
        if store_of is None:
            raise AttributeError(
                f"{type(self.rewarder).__name__} keeps no data of satellites; data.UniqueImageReward does, and rewarders in "
                "bsk_rl's form with a data_store_type"
            )
        return store_of(self.group.index)

    @property
    def memory(self) -> StateTable:
        """Tensors [N, ...] that start anew with every episode; ``memory.declare(name, initial, *shape)`` adds one."""
        return self.simulator.memory

    @property
    def time_limit(self) -> Tensor:
        """Time limits of the episodes, [N] s."""
        return self.group.time_limit

    @property
    def removed(self) -> Tensor | None:
        """Satellites that have left their episodes, [N], for which queries return nothing; None where none can leave."""
        return self.group.removed

    @property
    def observation_description(self) -> list[str]:
        """Name of every entry of the observation vector."""
        return self.group.observation_description

    @property
    def sat_args(self) -> Mapping[str, Any]:
        """Arguments of the present episodes, [N, ...] each, float64."""
        return _Arguments(self.simulator.state)

    @property
    def action_description(self) -> list[str]:
        """Name of every action."""
        return self.actions.description

    def next_eclipse(self) -> tuple[Tensor, Tensor]:
        """Return the next start and the next end of an eclipse, [N] s since reset."""
        return self.simulator.lookahead.next_eclipse(self.simulator.state.sim_time)

    def aliveness(self) -> dict[str, Tensor]:
        """Return the result [N] of every aliveness check of dynamics and flight software, by name."""
        others = self.group.fleet.encounters.checks_of_deputies(self.group.index)
        return {**self.dynamics.aliveness(), **self.fsw.aliveness(), **others}

    def is_alive(self) -> Tensor:
        """Return whether every aliveness check holds now, [N]."""
        alive = torch.ones_like(self.simulator.state.ticks, dtype=torch.bool)
        for check in self.aliveness().values():
            alive = alive & check
        return alive
