"""Models of one satellite, and the world, as a program of bsk_rl reads them: arrays and numbers of the present.

Properties of the core's models are evaluated by the core; those that a user's class defines run with the view as ``self``. Of
Basilisk's modules and messages, those that programs usually read are imitated (:mod:`bsk_torch.bsk_rl.sim.messages`); reading
another one raises AttributeError with advice.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from copy import deepcopy
from functools import cache, cached_property, partial
from operator import attrgetter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from bsk_torch.astro.sight import line_clearance, stretch
from bsk_torch.bsk_rl.sim import messages
from bsk_torch.bsk_rl.sim.commands import OWN, Command, Commanded, is_command, module_of
from bsk_torch.bsk_rl.sim.engine import SKY, row_mask
from bsk_torch.bsk_rl.sim.models import classes_of_users
from bsk_torch.bsk_rl.sim.rso_imaging import Capture
from bsk_torch.bsk_rl.sim.setup import NotSimulatedError
from bsk_torch.sim.dyn import GroundStationDynModel, LOSCommDynModel
from bsk_torch.sim.environment.world import station_arrays, station_names
from bsk_torch.sim.fsw.setpoint import ATTITUDE_MRP, HOLD_INERTIAL
from bsk_torch.sim.names import nearest
from bsk_torch.sim.readout.observables import Observer, observable
from bsk_torch.tasks.objects import SpaceToSpaceImagingDynModel
from bsk_torch.vec3 import Mat3, Vec3

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from bsk_torch.bsk_rl.sats.satellite import Satellite
    from bsk_torch.bsk_rl.scene.rso_targets import EpisodeTarget
    from bsk_torch.bsk_rl.sim.simulator import Simulator
    from bsk_torch.sim.readout.observables import Now
    from bsk_torch.sim.simulator import Simulator as CoreSimulator


CORE = "bsk_torch.sim."
"""Modules of the classes whose members are evaluated by the core."""


ELEMENTS = {
    "semi_major_axis": "a", "eccentricity": "e", "inclination": "i", "ascending_node": "Omega", "argument_of_periapsis": "omega",
    "true_anomaly": "f",
}  # fmt: skip
"""Orbital elements of bsk_rl's models by property."""


PACKAGE = "bsk_torch."
"""Beginning of the names of the package's modules."""


class _Overridden:
    """A member of a view that the class of a user's model defines, too: the user's is the one that programs see."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, view: ModelView, owner: type | None = None) -> object:
        return view.__getattr__(self.name)


@cache
def _overriding(view: type, model: type) -> type:
    """Return the class of views of a model: ``view`` itself, or a subclass where the user's model defines some of its members."""
    names = {
        name for owner in classes_of_users(model) for name in vars(owner) if not name.startswith("_") and hasattr(view, name)
    }
    return type(view.__name__, (view,), {name: _Overridden(name) for name in names}) if names else view


@cache
def _defined(model: type, name: str) -> tuple[Any, type] | None:
    """Return a member of a model and the class that defines it; None if there is none."""
    return next(((vars(owner)[name], owner) for owner in model.__mro__ if name in vars(owner)), None)


def of_row(value: object, row: int) -> Any:
    """Return one row of a tensor [N, ...] as a Python number or a new NumPy array; likewise in tuples and dictionaries.

    Anything else is the same for all rows.
    """
    if isinstance(value, torch.Tensor):
        entry = value[row]
        return entry.item() if entry.ndim == 0 else entry.numpy(force=True).copy()
    if isinstance(value, tuple) and any(isinstance(part, torch.Tensor) for part in value):
        return tuple(of_row(part, row) for part in value)
    if isinstance(value, dict):
        return {name: of_row(part, row) for name, part in value.items()}
    return value


class ModelView:
    """A dynamics or flight-software model of one satellite, or the world around it.

    ``isinstance`` is true for the classes of the model. Attributes that a program sets are kept until the next reset.
    """

    def __new__(cls, whole: object, *_: object) -> Any:
        """Return a view whose members the user's class of the model may override."""
        return object.__new__(_overriding(cls, type(whole)))  # type: ignore[arg-type]  # mypy: a class is not Hashable

    def __init__(self, whole: object, row: int) -> None:
        self.__dict__.update(_whole=whole, _row=row, _memo=(-1, {}))

    @property  # type: ignore[misc]
    def __class__(self) -> Any:
        """The class of the model, so that ``isinstance`` is true for it and its bases."""
        return type(self.__dict__["_whole"])

    def __repr__(self) -> str:
        return f"<{type(self._whole).__name__}>"

    def __getattr__(self, name: str) -> Any:
        whole = self.__dict__["_whole"]
        if name.startswith("__"):
            raise AttributeError(name)
        if name in vars(whole) and not isinstance(inspect.getattr_static(type(whole), name, None), cached_property):
            # set by __init__ of the user's class, for each satellite and episode in bsk_rl
            value = self.__dict__[name] = deepcopy(vars(whole)[name])
            return value
        defined = _defined(type(whole), name)  # type: ignore[arg-type]  # mypy: as above
        if defined is None:
            raise AttributeError(self._advice(name))
        return self._member(name, *defined)

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute of the program's; AttributeError, with advice, for one that the simulation would not follow."""
        if name in messages.KEPT and name not in self.__dict__:
            raise AttributeError(f"{name} of a model cannot be set during an episode: give it in sat_args or world_args")
        member = inspect.getattr_static(type(self._whole), name, None)
        if isinstance(member, property):
            if member.fset is None:
                raise AttributeError(f"property {name!r} of {type(self._whole).__name__!r} has no setter")
            member.fset(self, value)
        else:
            super().__setattr__(name, value)

    def _advice(self, name: str) -> str:
        advice = messages.advice(name) or nearest(name, self._names())
        return f"{type(self._whole).__name__} has no attribute {name!r}; {advice}"

    def _names(self) -> list[str]:
        return [name for name in dir(self._whole) if not name.startswith("_")]

    def _entry(self, name: str, value: object) -> object:
        entry = of_row(value, self._row)
        return entry.tolist() if name in messages.LISTS else entry

    def observed(self, function: Callable[[Now], object]) -> Any:
        """Return an observable of the core, which is read once until the state changes."""
        memo = self._present()
        value = memo.get(function)
        if value is None:
            value = memo[function] = self._read(function, memo)
        return value.copy() if isinstance(value, np.ndarray | list) else value

    def _present(self) -> dict[object, Any]:
        """Return what has been read since the state changed last."""
        observer = self._observer
        if self._memo[0] != observer.state.version:
            table = observer.table()
            row = None if table is None else table[0][self._row].numpy(force=True)
            self.__dict__["_memo"] = observer.state.version, {"row": row, "layout": {} if table is None else table[1].layout}
        return self._memo[1]

    def _read(self, function: Callable[[Now], object], memo: Mapping[object, Any]) -> Any:
        if function not in memo["layout"]:
            return self._entry(function.__name__, self._observer.read(function))
        (at, kind), row = memo["layout"][function], memo["row"]
        if isinstance(at, int):
            return bool(row[at] > 0.5) if kind is bool else float(row[at])
        values = row[at]
        return values.reshape(3, 3) if kind is Mat3 else values.tolist() if function.__name__ in messages.LISTS else values

    @property
    def _observer(self) -> Observer:
        return self._whole.simulator.observer

    def _member(self, name: str, member: Any, owner: type) -> object:
        of_core = owner.__module__.startswith(CORE)
        if getattr(member, "is_aliveness_checker", False):
            return partial(self._check, name, None if of_core or isinstance(member, observable) else member)
        if isinstance(member, property | cached_property):
            if isinstance(member, observable):
                return self.observed(member.function)
            if of_core:
                return self._entry(name, getattr(self._whole, name))
            if isinstance(member, property):
                return member.fget(self)  # type: ignore[misc]
            value = self.__dict__[name] = member.func(self)
            return value
        if not callable(member) or isinstance(member, staticmethod | classmethod | type):
            return getattr(self._whole, name)
        if not of_core:
            return member.__get__(self)
        return lambda *args, **options: of_row(getattr(self._whole, name)(*args, **options), self._row)

    def _check(self, name: str, method: Any, *args: object, log_failure: bool = False, **options: object) -> object:
        """Evaluate an aliveness check, the core's or a ``method`` of the user's; log a warning of its failure on request."""
        if method is None:
            alive = of_row(getattr(self._whole, name)(*args, **options), self._row)
        else:
            alive = method.__get__(self)(*args, **options)
        if log_failure and not np.all(alive):
            self.satellite.logger.warning("failed %s check", name)
        return alive

    # -- what every model has -----------------------------------------------------------------------------------------

    simulator = property(attrgetter("satellite.simulator"), doc="The simulation of the episode.")
    world = property(attrgetter("simulator.world"), doc="Sun, Earth and ground stations.")
    dynamics = property(attrgetter("satellite.dynamics"), doc="The dynamics model of the satellite.")
    fsw = property(attrgetter("satellite.fsw"), doc="The flight-software model of the satellite.")

    def is_alive(self, log_failure: bool = False) -> bool:
        """Return whether every aliveness check holds; those after the first failure, which may be logged, are not called."""
        return self._checks_hold(log_failure)

    def _checks_hold(self, log_failure: bool) -> bool:
        vitals = self._vitals()
        return all(vitals.get(name) or getattr(self, name)(log_failure=log_failure) for name in self._whole.checks())

    def _vitals(self) -> dict[str, bool]:
        """Return the results of the core's checks that its kernel computes together; none where there is no kernel."""
        memo = self._present()
        if "vitals" not in memo:
            checks = {name: function for name, function in self._whole.vitals().items() if function in memo["layout"]}
            memo["vitals"] = {name: self._read(function, memo) for name, function in checks.items()}
        return memo["vitals"]


class SatelliteModelView(ModelView):
    """A model of one satellite; arguments that bsk_rl's model keeps are attributes."""

    def __init__(self, whole: object, row: int, satellite: Satellite) -> None:
        super().__init__(whole, row)
        self.__dict__["satellite"] = satellite

    satellite: Any

    def __getattr__(self, name: str) -> Any:
        if name in messages.KEPT:
            args = (arg for component in type(self._whole).all_components() for arg in component.args)
            if any(arg.name == name for arg in args):
                return self.satellite.model_args[name]
        return super().__getattr__(name)

    logger = property(attrgetter("satellite.logger"), doc="Logger of the satellite.")


class DynamicsView(SatelliteModelView):
    """The dynamics model of a satellite; Basilisk's usual modules are attributes."""

    def __getattr__(self, name: str) -> Any:
        return module_of(self, name, lambda: self.satellite.fsw._commanding) or super().__getattr__(name)

    dyn_rate = property(attrgetter("simulator.sim_rate"), doc="Length of a tick, s.")
    task_name = property(lambda view: f"DynamicsTask{view.satellite.name}", doc="Name of the task to which recorders are added.")

    @property
    def I_mat(self) -> list[float]:
        """Inertia of the hub, nine numbers, kg m^2 in B."""
        return messages.inertia(self).ravel().tolist()

    @property
    def eclipse_index(self) -> int:
        """Number of the satellite's message in ``world.eclipseObject.eclipseOutMsgs``."""
        return self.simulator.satellites.index(self.satellite)

    @property
    def conjunctions(self) -> list[object]:
        """Satellites with which this one has collided, in the order of the collisions."""
        self._require("conjunctions")
        pairs = (pair for pair in self.simulator.collisions if self.satellite in pair)
        return [other if one is self.satellite else one for one, other in pairs]

    @property
    def out_of_ranges(self) -> list[object]:
        """Satellites from which this one was too far away."""
        self._require("out_of_ranges")
        flags = self._whole.out_of_ranges[self._row].tolist()
        return [satellite for satellite, flag in zip(self.simulator.satellites, flags, strict=True) if flag]

    @property
    def los_comms_ids(self) -> list[str]:
        """Names of the other satellites, in the order of the messages of ``losComms``."""
        if not isinstance(self, LOSCommDynModel):
            raise AttributeError(self._advice("los_comms_ids"))
        return [satellite.name for satellite in self.simulator.satellites if satellite is not self.satellite]

    @property
    def losComms(self) -> SimpleNamespace:
        """Basilisk's sensor: ``accessOutMsgs``, messages with ``hasAccess``, whether another satellite is in sight now."""
        names, every = self.los_comms_ids, self.simulator.satellites
        number = every.index(self.satellite)

        def message(other: int) -> messages.Message:
            return messages.Message(lambda: {"hasAccess": int(self.simulator.sights_now()[number, other])})

        return SimpleNamespace(accessOutMsgs=[message(k) for k, satellite in enumerate(every) if satellite.name in names])

    def _require(self, name: str) -> None:
        if not hasattr(type(self._whole), name):
            raise AttributeError(self._advice(name))

    @cached_property
    def _oe(self) -> dict[str, float]:
        """Orbital elements as they were when they were first read in the episode, as in bsk_rl."""
        elements = self._whole.elements
        return {name: float(getattr(elements, name)[self._row]) for name in ELEMENTS.values()}

    def observed(self, function: Callable[[Now], object]) -> Any:
        """See :meth:`ModelView.observed`; orbital elements are those of the first moment at which one was read."""
        name = function.__name__
        return self._oe[ELEMENTS[name]] if name in ELEMENTS else super().observed(function)

    @property
    def _bound_targets(self) -> dict[str, Satellite]:
        """Targets that the imager knows, by id; AttributeError for other satellites."""
        if not isinstance(self, SpaceToSpaceImagingDynModel):
            raise AttributeError(self._advice("bind_rso_target"))
        return self.__dict__.setdefault("_targets", {})

    def bind_rso_target(self, target: EpisodeTarget) -> None:
        """Let the imager know a target of its scenario; ValueError for one that it knows."""
        if target.id in self._bound_targets:
            raise ValueError(f"{self.satellite.name} knows the target {target.id!r} already")
        self._bound_targets[target.id] = target.target_spacecraft
        self.simulator.aims.add(target.target_spacecraft)

    @property
    def rso_partition_names(self) -> dict[str, str]:
        """Partitions of the imager's store by the ids of targets."""
        return {target_id: self.satellite.rso_scenario.partition_name(target_id) for target_id in self._bound_targets}

    @property
    def rso_access_messages(self) -> dict[str, messages.Message]:
        """Messages by the ids of targets: ``hasAccess``, whether the target is in sight and within range."""
        return {
            target_id: messages.Message(partial(self._access, target.dynamics))
            for target_id, target in self._bound_targets.items()
        }

    def _access(self, other: DynamicsView) -> dict[str, object]:
        pole = Vec3.of(torch.from_numpy(self.world.PN[2]))
        ends = [Vec3.of(torch.tensor(list(each.r_BN_N)).double()) for each in (self, other)]
        clear = bool(line_clearance(*(stretch(end, pole) for end in ends)) > 0.0)
        reach = float(self.satellite.model_args["imageTargetMaximumRange"])
        return {"hasAccess": int(clear and (reach < 0.0 or float((ends[1] - ends[0]).norm()) <= reach))}

    def _checks_hold(self, log_failure: bool) -> bool:
        """See :meth:`ModelView.is_alive`; deputies may take their chief with them."""
        if not super()._checks_hold(log_failure):
            return False
        part, row = self.satellite.core_row
        near = all(bool(valid[row]) for valid in self.simulator.fleet.encounters.checks_of_deputies(part).values())
        if log_failure and not near:
            self.satellite.logger.warning("failed range_valid check")
        return near


class FlightSoftwareView(SatelliteModelView):
    """The flight-software model of a satellite; its commands are methods ``action_...``."""

    def __init__(self, whole: object, row: int, satellite: Satellite) -> None:
        super().__init__(whole, row, satellite)
        self.__dict__["_commanding"] = None

    def __getattr__(self, name: str) -> Any:
        defined = _defined(type(self._whole), name)  # type: ignore[arg-type]  # mypy: as above
        if defined is not None and is_command(defined[0]):
            return partial(self._run_command, defined[0])
        if name.startswith("action_") and (defined is None or defined[1].__module__.startswith(PACKAGE)):
            return self._command(name.removeprefix("action_"))
        if name in messages.FSW_MODULES and (defined is None or defined[1].__module__.startswith(PACKAGE)):
            return self._module(name)
        return super().__getattr__(name)

    def _command(self, command: str) -> Callable[..., object]:
        """Return a command of the package, which flight software of users may have replaced."""
        if f"action_{command}" in vars(FlightSoftwareView):
            return partial(vars(FlightSoftwareView)[f"action_{command}"], self)
        if command not in self._core.type.commands:
            raise AttributeError(self._advice(f"action_{command}"))
        return lambda: self._enter(command)

    def _run_command(self, method: Callable[..., object], *args: object, **options: object) -> object:
        """Run a command of a user's, and enter the mode that it has arranged; one within another adds to it."""
        if self._commanding is not None:
            return method(self, *args, **options)
        command = self.__dict__["_commanding"] = Command()
        try:
            result = method(self, *args, **options)
        finally:
            self.__dict__["_commanding"] = None
        core, mode = self._core, command.mode()
        if mode not in core.mode_names:
            raise NotSimulatedError(
                f"{method.__name__} switches on {mode}, which the models of the satellite do not have together"
            )
        if "image_rso" in core.type.commands:
            self.rso_capture.forget()
        core.command(self._rows, torch.full_like(core.state.ticks, core.mode_names.index(mode)))
        for name, value in command.fields.items():
            self._write(name, np.full(self.field(name).shape, value, dtype=float))
        return result

    def _names(self) -> list[str]:
        commands = (command for command in self._core.type.commands if not command.startswith(OWN))
        return [*(f"action_{command}" for command in commands), *super()._names()]

    @property
    def flags_on(self) -> tuple[str, ...]:
        """What the present mode switches on."""
        core = self._core
        return core.type.modes[core.mode_names[int(core.state.mode[self._row])]].on or ()

    def field(self, name: str) -> np.ndarray:
        """Return a field of the state of the satellite; AttributeError for one that it does not have."""
        if name not in self._core.tick.state.fields:
            raise AttributeError(f"{self.satellite.name} has no {name}; another model of its flight software has it")
        return np.atleast_1d(self._core.read(name)[self._row].numpy(force=True))

    fsw_rate = property(attrgetter("simulator.sim_rate"), doc="Length of a tick, s.")

    @property
    def _core(self) -> CoreSimulator:
        return self.simulator.fleet.simulators[self.satellite.core_row[0]]

    @property
    def _rows(self) -> torch.Tensor:
        return row_mask(self.simulator.fleet, *self.satellite.core_row)

    def _enter(self, command: str) -> None:
        core = self._core
        if command not in core.type.commands:
            core.check_command(command)
        if self._commanding is not None:
            mode = core.mode_names[int(core.mode_index(command)[self._row])]
            self._commanding.enter(core.type.modes[mode])
            return
        if "image_rso" in core.type.commands:
            self.rso_capture.forget()
        core.command(self._rows, core.mode_index(command))

    def _write(self, name: str, value: object) -> None:
        if self._commanding is not None:
            self._commanding.fields[name] = value
            return
        rows = self._rows
        self._core.write(name, rows, torch.as_tensor(np.atleast_1d(np.asarray(value, dtype=float))).expand(len(rows), -1))

    @property
    def rso_capture(self) -> Capture:
        """The gate before the instrument of an imager of other satellites, and its images."""
        if "image_rso" not in self._core.type.commands:
            raise AttributeError(self._advice("rso_capture"))
        return self.__dict__.setdefault("_capture", Capture(self.satellite))

    def _module(self, name: str) -> object:
        """Return a module of Basilisk's flight software, if the model has it."""
        module = messages.FSW_MODULES[name]
        if not isinstance(self, module.model) or isinstance(self, module.without):
            raise AttributeError(self._advice(name))
        if module.message is not None:
            return module.message(self)

        return Commanded(name, lambda: self._commanding, partial(messages.read_of, self, module.attributes))

    def action_image_rso(
        self,
        target: EpisodeTarget,
        duration: float = 300.0,
        hold_s: float = 10.0,
        hold_mode: str = "cumulative",
        require_illumination: bool = True,
        illumination_threshold: float = 0.5,
    ) -> None:
        """Point at a target of the scenario and take one image of it; see :class:`bsk_torch.bsk_rl.act.ImageRSO`.

        Raises:
            ValueError: For a target that the imager does not know.
        """
        capture = self.rso_capture
        if target.id not in self.dynamics.rso_partition_names:
            raise ValueError(f"{self.satellite.name} does not know the target {target.id!r}; dynamics.bind_rso_target adds it")
        self._enter("image_rso")
        capture.start(
            target,
            duration,
            rso_hold=float(hold_s),
            rso_continuous=float(hold_mode == "continuous"),
            rso_least_light=float(illumination_threshold) if require_illumination else -1.0,
        )

    def action_image(self, r_LP_P: object, data_name: str = "") -> None:
        """Point the instrument at a place, m in Earth-fixed axes, and take one image of it."""
        if self._commanding is None and "image_rso" in self._core.type.commands:
            raise NotImplementedError(f"{type(self._whole).__name__} images satellites: use act.ImageRSO")
        self._enter("image")
        self._write("r_LP_P", r_LP_P)

    def action_attitude_mrp(self, sigma_RN: object) -> None:
        """Turn to an attitude relative to N, an MRP."""
        self._enter(ATTITUDE_MRP)
        self._write("sigma_RN", sigma_RN)

    def action_impulsive_thrust(self, dv_N: ArrayLike) -> None:
        """Change the velocity at once, m/s in N; the attitude reference becomes that of N."""
        size, available = np.linalg.norm(dv_N), self.dv_available
        if size > available:
            self.satellite.logger.warning("Maneuver exceeds available Delta V (%s/%s m/s).", size, available)
        self._enter(HOLD_INERTIAL)
        rows = self._rows
        dv = torch.as_tensor(np.asarray(dv_N, dtype=float)).reshape(1, 3)
        self._core.thrust(rows, dv.expand(len(rows), 3))


class Station:
    """A ground station, as bsk_rl's world lists it.

    Attributes:
        ModelTag: Its name.
        r_LP_P_Init: Its place, m, Earth-fixed: a column, as Basilisk writes it.
        minimumElevation: Least elevation, rad.
        maximumRange: Longest range, m; no limit if negative.
    """

    def __init__(self, simulator: Simulator, name: str, r_LP_P: ArrayLike, sine: float, reach: float) -> None:
        self._place = np.asarray(r_LP_P, dtype=float)
        self.ModelTag, self.r_LP_P_Init = name, self._place.reshape(3, 1).tolist()
        self.minimumElevation, self.maximumRange = float(np.arcsin(sine)), reach
        self._simulator = simulator

    @property
    def accessOutMsgs(self) -> list[messages.Message]:
        """Messages of the satellites that downlink, in their order: ``hasAccess``, ``slantRange``, m, and ``elevation``, rad."""
        satellites = self._simulator.satellites
        return [messages.Message(partial(self._access, s)) for s in satellites if issubclass(s.dyn_type, GroundStationDynModel)]

    def _access(self, satellite: Satellite) -> dict[str, object]:
        line_P = satellite.dynamics.r_BN_P - self._place
        reach = float(np.linalg.norm(line_P))
        elevation = float(np.arcsin(line_P @ self._place / (reach * np.linalg.norm(self._place))))
        sees = elevation >= self.minimumElevation and (self.maximumRange < 0.0 or reach <= self.maximumRange)
        return {"hasAccess": int(sees), "slantRange": reach, "elevation": elevation}


class WorldView(ModelView):
    """Sun, Earth and ground stations of the episode, with Basilisk's messages of the Sun and the Earth."""

    sun_index, body_index = 0, 1

    def __init__(self, whole: object, simulator: Simulator) -> None:
        super().__init__(whole, 0)
        self.__dict__["_simulator"] = simulator

    simulator = property(attrgetter("_simulator"), doc="The simulation of the episode.")

    def __getattr__(self, name: str) -> Any:
        args = self.simulator.world_args
        return args[name] if name in messages.KEPT and name in args else super().__getattr__(name)

    def _member(self, name: str, member: Any, owner: type) -> object:
        if name in SKY and owner.__module__.startswith(CORE):
            return self.observed(SKY[name])
        return super()._member(name, member, owner)

    def _entry(self, name: str, value: object) -> object:
        return of_row(value, 0)

    @property
    def _observer(self) -> Observer:
        """That of the first satellite, whose kernel knows the sky."""
        return self.simulator.fleet.simulators[0].observer

    @property
    def eclipseObject(self) -> object:
        """Basilisk's eclipse module, with the satellites' messages; AttributeError in a world without eclipses."""
        if all(component.slot != "eclipse" for component in type(self._whole).all_components()):
            raise AttributeError(self._advice("eclipseObject"))
        return messages.eclipses(self)

    planet = property(
        lambda view: view.gravFactory.gravBodies["earth"], doc="Basilisk's Earth: ``mu``, m^3/s^2, ``radEquator``, m."
    )
    gravFactory = property(
        messages.gravity_factory, doc="Basilisk's factory of gravity bodies, with the messages of Sun and Earth."
    )
    ephemConverter = property(messages.ephemerides, doc="Basilisk's converter of ephemerides, with the same messages.")

    @property
    def densityModel(self) -> object:
        """Basilisk's exponential atmosphere: ``planetRadius``, m, ``baseDensity``, kg/m^3, ``scaleHeight``, m."""
        args = self.simulator.world_args
        if "baseDensity" not in args:
            raise AttributeError(self._advice("densityModel"))
        return Commanded("densityModel", lambda: None, args.__getitem__)

    @cached_property
    def groundStations(self) -> list[Station]:
        """The ground stations; AttributeError in a world without any."""
        args = dict(self.simulator.world_args)
        if "groundStationsData" not in args:
            raise AttributeError(self._advice("groundStations"))
        stations = args.get("groundStationsData")
        if not stations:
            return []
        names = ("groundLocationPlanetRadius", "gsMinimumElevation", "gsMaximumRange")
        arrays = station_arrays(
            {"groundStationsData": stations, **{name: torch.tensor(float(args[name]), dtype=torch.float64) for name in names}}
        )
        positions = arrays["station_positions_P"].view(3, -1).T.numpy()
        numbers = (arrays[name].reshape(-1).tolist() for name in ("station_sin_elevations", "station_ranges"))
        return [Station(self.simulator, *each) for each in zip(station_names(stations), positions, *numbers, strict=True)]


__all__ = ["DynamicsView", "FlightSoftwareView", "ModelView", "Station", "WorldView", "observable"]
