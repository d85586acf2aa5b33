"""The satellite of an episode: its specification, its arguments, and its events."""

from __future__ import annotations

import keyword
import logging
from abc import ABC
from collections.abc import Callable
from operator import attrgetter
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import DTypeLike
from typing_extensions import override

from bsk_torch.bsk_rl.act.actions import ActionBuilder, select_action_builder
from bsk_torch.bsk_rl.defaults import sat_defaults
from bsk_torch.bsk_rl.obs.observations import ObservationBuilder
from bsk_torch.bsk_rl.sim.simulator import Simulator
from bsk_torch.bsk_rl.sim.trajectory import TrajectorySimulator
from bsk_torch.bsk_rl.sim.views import DynamicsView, FlightSoftwareView
from bsk_torch.bsk_rl.utils.functional import ResetableGroup
from bsk_torch.sim.assembly.composition import compose
from bsk_torch.sim.component import UserArguments
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.fsw.models import FSWModel
from bsk_torch.sim.names import nearest

SatObs = TypeVar("SatObs")
SatAct = TypeVar("SatAct")


class Satellite(ABC, ResetableGroup):
    """An agent of bsk_rl. Subclasses set ``observation_spec``, ``action_spec``, ``dyn_type`` and ``fsw_type``.

    Models are classes of :mod:`bsk_torch.sim.dyn` and :mod:`bsk_torch.sim.fsw`, or tuples of them, of which the first wins.

    Attributes:
        sat_args_generator: Arguments of the models as they were given: values, and functions that draw them.
        sat_args: Arguments of the current episode.
        simulator, dynamics, fsw: Simulation and models of the current episode.
        trajectory: Prediction of the orbit.
        data_store: Data that the satellite has collected.
        requires_retasking: Whether its task is over.
        info: List that a program may fill during a step; every step starts with an empty one.
        time_of_death: Time at which it was found dead, s; None while it is alive.
        backend: Back end of the environment, which also predicts the orbit.
    """

    dyn_type: ClassVar[Any]
    fsw_type: ClassVar[Any]
    observation_spec: ClassVar[Any]
    action_spec: ClassVar[Any]

    simulator: Simulator
    dynamics: Any
    fsw: Any
    data_store: Any
    requires_retasking: bool
    info: list[object]
    trajectory: TrajectorySimulator
    sat_args: dict[str, Any]
    model_args: dict[str, Any]
    """Arguments of the episode as ``setup_...`` methods of users' models leave them."""
    backend: str = "compiled"
    core_row: tuple[int, int]
    """Type of the satellite in the core's simulation, and its row there."""

    @classmethod
    def get_dyn_type(cls) -> type[DynamicsModel]:
        """Return the dynamics model that ``dyn_type`` stands for."""
        return cls._composed("dyn_type", DynamicsModel)

    @classmethod
    def get_fsw_type(cls) -> type[FSWModel]:
        """Return the flight-software model that ``fsw_type`` stands for."""
        return cls._composed("fsw_type", FSWModel)

    @classmethod
    def _composed(cls, name: str, base: type) -> Any:
        if not hasattr(cls, name):
            raise AttributeError(f"{cls.__name__} must set {name}")
        return compose(getattr(cls, name), base, cls.__name__)

    @classmethod
    def default_sat_args(cls, **kwargs: object) -> dict[str, object]:
        """Return all arguments of the models with their defaults, or the given values; KeyError for an unknown name."""
        defaults = sat_defaults(cls.get_dyn_type(), cls.get_fsw_type())
        for name, value in kwargs.items():
            if name not in defaults:
                raise KeyError(f"{name} is not a valid key for sat_args; {nearest(name, defaults)}")
            defaults[name] = value
        return defaults

    def __init__(
        self,
        name: str,
        sat_args: UserArguments | None = None,
        obs_type: type = np.ndarray,
        dtype: DTypeLike = np.float64,
        variable_interval: bool = True,
    ) -> None:
        """Describe a satellite.

        Args:
            name: A Python identifier.
            sat_args: Arguments that differ from the defaults: values, or functions without arguments that draw them.
            obs_type: ``np.ndarray``, ``list`` or ``dict``.
            dtype: Type of observations.
            variable_interval: Whether the end of a task ends the step.

        Raises:
            ValueError: For several instruments, which bsk_rl does not have.
        """
        self.name = name
        self.logger = logging.getLogger(__name__).getChild(self.name)
        self.sat_args_generator = self.default_sat_args(**(sat_args or {}))
        if self.sat_args_generator.get("instruments") is not None:
            raise ValueError("sat_args['instruments']: satellites of bsk_torch.bsk_rl have one; use one of bsk_torch.sats")
        self.variable_interval = variable_interval
        self._timed_terminal_event_name: str | None = None
        self.observation_builder = ObservationBuilder(self, obs_type=obs_type, dtype=dtype)
        self.action_builder = select_action_builder(self)
        self.fsw_type, self.dyn_type = self.get_fsw_type(), self.get_dyn_type()  # type: ignore[misc]

    @property
    def name(self) -> str:
        """Name of the satellite in its environment."""
        return self._name

    @name.setter
    def name(self, value: str) -> None:
        if not isinstance(value, str) or not value:
            raise ValueError("Satellite name must be a nonempty string.")
        if not value.isidentifier() or keyword.iskeyword(value):
            raise ValueError(f"Satellite name must be a valid Python identifier, for example 'camera_a'; it is {value!r}")
        self._name = value

    id = property(attrgetter("name"), doc="The name.")

    @property
    def holds_attitudes(self) -> bool:
        """Whether an action may command an attitude set-point, so that the flight software must know them."""
        return any(getattr(entry, "may_hold_attitude", True) for entry in self.action_builder.action_spec)

    # -- an episode begins --------------------------------------------------------------------------------------------

    def generate_sat_args(self, **kwargs: object) -> None:
        """Draw the arguments of an episode, in their order, and replace some; KeyError for an unknown name."""
        self.sat_args = {name: value() if callable(value) else value for name, value in self.sat_args_generator.items()}
        for name, value in kwargs.items():
            if name not in self.sat_args:
                raise KeyError(f"{name} is not a valid key for sat_args; {nearest(name, self.sat_args)}")
            self.sat_args[name] = value
        self.logger.debug("Satellite initialized with %s", self.sat_args)

    @override
    def _parts(self) -> tuple[ObservationBuilder, ActionBuilder]:
        return self.observation_builder, self.action_builder

    @override
    def reset_overwrite_previous(self) -> None:
        self.requires_retasking, self._timed_terminal_event_name = True, None
        self._is_alive = True
        self.time_of_death: float | None = None
        super().reset_overwrite_previous()

    def create_vizard_data(self, color: object, **_: object) -> None:
        """Do nothing: pictures for Vizard are not made."""

    @override
    def reset_pre_sim_init(self) -> None:
        args = self.sat_args
        state = {name: args[name] for name in ("rN", "vN", "oe", "mu")}
        self.trajectory = TrajectorySimulator(args["utc_init"], **state, backend=self.backend)
        super().reset_pre_sim_init()

    def set_simulator(self, simulator: Simulator) -> None:
        """Store the simulation of the episode."""
        self.simulator = simulator

    def set_dynamics(self, dyn_rate: float) -> object:
        """Return the dynamics model of the episode."""
        part, row = self.core_row
        self.dynamics = DynamicsView(self.simulator.fleet.satellites[part].dynamics, row, self)
        return self.dynamics

    def set_fsw(self, fsw_rate: float) -> object:
        """Return the flight software of the episode."""
        part, row = self.core_row
        self.fsw = FlightSoftwareView(self.simulator.fleet.satellites[part].fsw, row, self)
        return self.fsw

    # -- observations and actions -------------------------------------------------------------------------------------

    observation_space = property(attrgetter("observation_builder.observation_space"), doc="Known after the first reset.")
    observation_description = property(attrgetter("observation_builder.observation_description"), doc="Names of its entries.")
    action_space = property(attrgetter("action_builder.action_space"), doc="Space of the actions.")
    action_description = property(attrgetter("action_builder.action_description"), doc="Names of the actions.")

    def get_obs(self) -> Any:
        """Return the observation of the present."""
        return self.observation_builder.get_obs()

    def set_action(self, action: object) -> None:
        """Begin an action."""
        self.action_builder.set_action(action)

    # -- life ---------------------------------------------------------------------------------------------------------

    def is_alive(self, log_failure: bool = True) -> bool:
        """Return whether every aliveness check of the models has held so far."""
        if self._is_alive:
            self._is_alive = bool(self.dynamics.is_alive(log_failure) and self.fsw.is_alive(log_failure))
            if not self._is_alive:
                self.record_death(self.simulator.sim_time)
        return self._is_alive

    def record_death(self, time: float) -> None:
        """Keep the time of death, s, unless it is known."""
        if self.time_of_death is None:
            self.time_of_death = time

    def log_info(self, info: object) -> None:
        """Log at level INFO."""
        self.logger.info("%s", info)

    def log_warning(self, warning: object) -> None:
        """Log a warning."""
        self.logger.warning("%s", warning)

    # -- events -------------------------------------------------------------------------------------------------------

    def update_timed_terminal_event(
        self, t_close: float, info: str = "", extra_actions: Callable[[Simulator], object] | None = None
    ) -> None:
        """Let the task end at a time, s; the event replaces the one before.

        Raises:
            TypeError: For ``extra_actions`` that are text, which bsk_rl executes.
        """
        if extra_actions is not None and not callable(extra_actions):
            raise TypeError(f"extra_actions={extra_actions!r} must be a function of the simulator")
        self.disable_timed_terminal_event()
        self.logger.info("setting timed terminal event at %.1f", t_close)
        self._timed_terminal_event_name = f"timed_terminal_{self.name}"

        def over(simulator: Simulator) -> None:
            self.logger.info("timed termination at %.1f %s", t_close, info)
            self.requires_retasking = True
            if extra_actions is not None:
                extra_actions(simulator)

        self.simulator.add_timed_event(self._timed_terminal_event_name, t_close, over, bool(self.variable_interval))

    def disable_timed_terminal_event(self) -> None:
        """Remove the event set by :meth:`update_timed_terminal_event`."""
        if self._timed_terminal_event_name in self.simulator.eventMap:
            self.simulator.delete_event(str(self._timed_terminal_event_name))
