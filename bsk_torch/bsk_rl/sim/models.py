"""Classes of models for one episode: the core's, with the hooks that bsk_rl calls on models.

:func:`counterpart` derives from each model of the core one with the same name. Its subclasses may define what the drop-in runs,
in addition to what the core's may: ``is_alive``, ``reset_during_sim_init``, ``reset_post_sim_init``, ``default_world_args``,
``_requires_world``, ``_requires_dyn``, commands marked by :func:`action`, and ``setup_...`` methods that change arguments
(:mod:`bsk_torch.bsk_rl.sim.setup`). Anything else that would never run raises TypeError when the class is defined.
"""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, TypeVar

from bsk_torch.bsk_rl.methods import DYN, FSW, TASKS, WORLD
from bsk_torch.sim import dyn, fsw, world
from bsk_torch.sim.fsw.models import NO_TASKS
from bsk_torch.sim.names import nearest
from bsk_torch.sim.readout.hooks import check_model

Function = TypeVar("Function", bound=Callable[..., object])

ROOTS: tuple[type, ...] = (dyn.DynamicsModel, fsw.FSWModel, world.WorldModel)
"""Models from which all others of the core are derived."""

CORE = ("bsk_torch.sim.", "bsk_torch.tasks.")
"""Modules of the core's models."""

HOOKS = ("is_alive", "reset_overwrite_previous", "reset_pre_sim_init", "reset_during_sim_init", "reset_post_sim_init")
"""Hooks of dynamics and flight software; as in bsk_rl, no one calls the second and the third of models."""

REQUIREMENTS = {"_requires_world": "requires_world", "_requires_dyn": "requires_dyn"}
"""Class methods that list required models, and the tables of the core."""

SETUP = ("_setup_dynamics_objects", "_setup_world_objects")
"""Methods that call all ``setup_...`` methods of a model."""

WITHOUT_ARGUMENTS: dict[type, str] = {
    dyn.DynamicsModel: "setup_gravity_bodies setup_simple_nav_object",
    dyn.EclipseDynModel: "setup_eclipse_object",
    dyn.AtmosphericDragDynModel: "setup_density_model",
    dyn.BasicDynamicsModel: "setup_thruster_dyn_effector",
    dyn.GroundStationDynModel: "setup_ground_station_locations",
    world.WorldModel: "setup_ephem_object",
    world.EclipseWorldModel: "setup_eclipse_object",
}
"""Methods of bsk_rl's models that set up modules without arguments."""


class Task:
    """A task of flight software. Those of the package are switched by ``simulator.enableTask(task.name + satellite.name)``.

    A subclass of one of these may define ``setup_...`` methods that change arguments; one that adds modules raises TypeError.
    """

    name: ClassVar[str]

    def __init__(self, fsw: object, priority: int = 100) -> None:
        self.fsw, self.priority = fsw, priority

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        if cls.__module__ == __name__:
            return
        for name, value in vars(cls).items():
            if callable(value) and not name.startswith(("setup_", "__init__")):
                raise TypeError(f"{cls.__qualname__}.{name} is never run here; {NO_TASKS}")
        if not hasattr(cls, "name") or cls.name not in TASK_FLAGS:
            raise TypeError(f"{cls.__qualname__} is a task that no model of the package has; {NO_TASKS}")


TASK_FLAGS = {
    "mrpControlTask": "control_on",
    "nadirPointTask": "nadir_on",
    "sunPointTask": "sun_on",
    "rwDesatTask": "desat_on",
    "locPointTask": "location_on",
    "trackingErrTask": "",
}
"""Tasks of the package by Basilisk's names, and the flags of the mode table that they are; the error is always tracked."""

NESTED: dict[type, dict[str, str]] = {
    fsw.FSWModel: {
        "MRPControlTask": "mrpControlTask",
        "NadirPointTask": "nadirPointTask",
        "TrackingErrorTask": "trackingErrTask",
    },
    fsw.BasicFSWModel: {"SunPointTask": "sunPointTask", "RWDesatTask": "rwDesatTask"},
    fsw.ImagingFSWModel: {"LocPointTask": "locPointTask"},
}
"""Task classes of models."""


def action(function: Function) -> Function:
    """Mark a method of flight software as a command, which begins with all tasks but attitude control switched off.

    It may call other commands, switch tasks of the package, and set what these commands set:
    :class:`bsk_torch.bsk_rl.sim.commands.Command`.
    """
    function.is_command = True  # type: ignore[attr-defined]
    return function


@functools.cache
def counterpart(core: Any) -> Any:
    """Return the model for one episode that a model of the core stands for."""
    parents = [counterpart(base) for base in core.__bases__ if issubclass(base, ROOTS)]
    made = type(core.__name__, (*parents, core), {"__doc__": core.__doc__})
    body: dict[str, object] = {"__module__": f"{__name__.rpartition('.')[0]}.{_kind(core)}"}
    if core in ROOTS:
        body |= {"of_one_episode": True, "__init_subclass__": classmethod(_check), **dict.fromkeys(HOOKS[1:], _nothing)}
        body |= WORLD_HOOKS if core is world.WorldModel else SATELLITE_HOOKS
    methods = {**_arguments_of(DYN, core), **_arguments_of(FSW, core), **_arguments_of(WORLD, core)}
    methods |= dict.fromkeys(WITHOUT_ARGUMENTS.get(core, "").split(), ())
    body |= {name: _taker(name, args) for name, args in methods.items()}
    body |= {name: _task(name, title, core) for name, title in NESTED.get(core, {}).items()}
    body |= {f"action_{name}": _command(name) for name in (*vars(core).get("modes", ()), *vars(core).get("commands", ()))}
    for name, value in body.items():  # after the core has checked the class, which has more hooks than the core's
        setattr(made, name, value)
    return made


def for_one_episode(model: type) -> Any:
    """Return the counterpart of a model of the core, and other classes unchanged."""
    of_core = model.__module__.startswith(CORE) and not hasattr(model, "of_one_episode")
    return counterpart(model) if of_core else model


@functools.cache
def core_world(world_type: Any) -> Any:
    """Return a world model as the core takes it: with the core's table of arguments."""
    table = vars(world.WorldModel)["default_world_args"]
    return type(world_type.__name__, (world_type,), {"default_world_args": table, "__module__": __name__})


def counterparts(title: str, names: Iterable[str], *places: str) -> None:
    """Replace the models of the core in a module by those for one episode; it is also the modules that bsk_rl has below it."""
    module = sys.modules[title]
    for name in names:
        value = getattr(module, name)
        if inspect.isclass(value) and issubclass(value, ROOTS):
            setattr(module, name, for_one_episode(value))
    for place in places:
        sys.modules[f"{title}.{place}"] = module
        setattr(module, place, module)


def _kind(core: type) -> str:
    return next(name for name, root in zip(("dyn", "fsw", "world"), ROOTS, strict=True) if issubclass(core, root))


def _arguments_of(table: Mapping[type, Mapping[str, str]], core: type) -> dict[str, tuple[str, ...]]:
    return {name: tuple(args.split()) for name, args in table.get(core, {}).items() if name.startswith("setup_")}


def _task(name: str, title: str, core: type) -> type:
    tables = (table[name] for base, table in TASKS.items() if issubclass(base, core) and name in table)
    takers = {method: _taker(method, tuple(args.split())) for table in tables for method, args in table.items()}
    return type(name, (Task,), {"name": title, "__module__": __name__, **takers})


def _taker(name: str, args: tuple[str, ...]) -> Callable[..., None]:
    """Return the ``setup_...`` method of a model of the package, which keeps arguments for the simulation."""

    def take(self: Any, **kwargs: object) -> None:
        self._take(name, args, kwargs)

    take.__name__ = name
    return take


def _command(name: str) -> Callable[..., object]:
    """Return the method of a command of the package, for the flight software of users that calls it by ``super()``."""

    def command(self: Any, *args: object, **options: object) -> object:
        return self._command(name)(*args, **options)

    command.__name__ = f"action_{name}"
    return command


# -- hooks -----------------------------------------------------------------------------------------------------------------------


def _nothing(self: object) -> None:
    """Do nothing; a hook of bsk_rl's models."""


def is_alive(self: Any, log_failure: bool = False) -> bool:
    """Return whether every aliveness check of a model holds."""
    return self._checks_hold(log_failure)


def default_world_args(cls: type, **overrides: object) -> dict[str, object]:
    """Return all arguments of the world by name: values, and functions that draw them; KeyError for an unknown one."""
    from bsk_torch.bsk_rl.defaults import world_defaults  # which imports models

    args = world_defaults(cls)
    for name, value in overrides.items():
        if name not in args:
            raise KeyError(f"{name} is not a valid key for world_args; {nearest(name, args)}")
        args[name] = value
    return args


def _set_up_all(self: Any, **kwargs: object) -> None:
    self._set_up_all(kwargs)


SATELLITE_HOOKS = {
    "is_alive": is_alive,
    "_requires_world": classmethod(lambda cls: list(getattr(cls, "all_required_worlds", tuple)())),
    "_requires_dyn": classmethod(lambda cls: list(getattr(cls, "all_required_dyn", tuple)())),
    "_setup_dynamics_objects": _set_up_all,
}
"""Hooks of dynamics and flight software, in addition to :data:`HOOKS`."""

WORLD_HOOKS = {"default_world_args": classmethod(default_world_args), "_setup_world_objects": _set_up_all}
"""Hooks of world models, likewise."""


def _check(cls: type, **options: object) -> None:
    """Check a class of users, as the core does, apart from what runs here."""
    root = next(root for root in ROOTS if issubclass(cls, root))
    if cls.__module__.split(".")[0] == "bsk_torch":
        return
    check_model(cls, root, runs)
    for method, table in REQUIREMENTS.items():
        if method in vars(cls):
            setattr(cls, table, tuple(getattr(cls, method)()))


def classes_of_users(model: type) -> list[type]:
    """Return the classes among the bases of a model that users have written."""
    return [owner for owner in model.__mro__ if owner.__module__.split(".")[0] not in ("bsk_torch", "builtins", "types", "abc")]


def for_one_episode_only(model: type) -> list[str]:
    """Return the definitions of users' classes among the bases of a model that run for one episode only."""
    return sorted(
        name
        for owner in classes_of_users(model)
        for name, value in vars(owner).items()
        if name not in (*REQUIREMENTS, "default_world_args") and runs(name, value)
    )


def runs(name: str, value: object) -> bool:
    """Return whether a definition in a class of users runs here, though it would not in the core."""
    if name in (*HOOKS, *REQUIREMENTS, *SETUP, "default_world_args"):
        return True
    if inspect.isclass(value):
        return issubclass(value, Task)
    return (name.startswith("setup_") or getattr(value, "is_command", False)) and inspect.isfunction(value)
