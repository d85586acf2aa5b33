"""Checks of user-defined model classes: members that would never be used raise an error at the definition."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from bsk_torch.astro.gravity import DEGREE
from bsk_torch.sim.component import Component
from bsk_torch.sim.hooks import check_class
from bsk_torch.sim.schedule import SCHEDULE, Schedule, anchored


class Table(NamedTuple):
    """A table of a model class: the models that have it, and how it is written."""

    owners: str
    example: str


TABLES: dict[str, Table] = {
    "components": Table("dynamics, flight-software and world models", "components = (HEATER,)"),
    "world_components": Table("dynamics models", "world_components = (MOON,)"),
    "requires_world": Table("dynamics models", "requires_world = (world.EclipseWorldModel,)"),
    "orbit": Table("dynamics models", "orbit = 'arc'"),
    "gravity_degree": Table("dynamics models", "gravity_degree = 4"),
    "schedule": Table("dynamics models", "schedule = SCHEDULE.moved('wheels', before='hub')"),
    "modes": Table("flight-software models", "modes = {'safe': fsw.Mode(('control_on', 'sun_on'))}"),
    "commands": Table("flight-software models", "commands = {'desat': fsw.Command(('desat_sun',))}"),
    "requires_dyn": Table("flight-software models", "requires_dyn = (dyn.BasicDynamicsModel,)"),
    "only_where_required": Table("world models", "only_where_required = True"),
}
"""Values that classes of models may define."""

COMPONENT = (
    "write a Component, from bsk_torch.sim.component, with args=, state= and update(bus), and list it in components "
    "(docs/how_to/own_component.md)"
)
MESSAGES = f"messages are attributes of the bus that components share; {COMPONENT}"
STATE = f"what is reset with every episode is a Field in state= of a Component, with initial=; {COMPONENT}"
DEFAULTS = f"arguments are Arg(name, default, unit, doc) in args= of a Component; {COMPONENT}"

UNUSED: dict[str, str] = {
    **dict.fromkeys(
        ("_setup_dynamics_objects", "_setup_fsw_objects", "_setup_world_objects", "_make_task_list", "_create_process"), COMPONENT
    ),
    **dict.fromkeys(("create_task", "_create_module_data", "_add_model_to_task", "_utc_init"), COMPONENT),
    **dict.fromkeys(("_set_messages", "_set_config_msgs", "_set_gateway_msgs", "_zero_gateway_msgs"), MESSAGES),
    **dict.fromkeys(("_set_vehicle_config_msg", "_set_thrusters_config_msg", "_set_rw_config_msg"), MESSAGES),
    **dict.fromkeys(("reset_overwrite_previous", "reset_pre_sim_init", "reset_during_sim_init", "reset_post_sim_init"), STATE),
    "reset_for_action": "name the fields in resets= of an fsw.Mode, a row of the table modes",
    "_requires_world": f"write {TABLES['requires_world'].example}",
    "_requires_dyn": f"write {TABLES['requires_dyn'].example}",
    "default_world_args": DEFAULTS,
    "is_alive": "mark methods that return [N] booleans with dyn.aliveness_checker",
}
"""Names that are not hooks of models, and what to write instead."""

LEAST_DEGREE = 2
"""Least degree of the Earth's field, apart from the point mass: solvers of arcs are built around its oblateness."""

DEGREES = (0, *range(LEAST_DEGREE, DEGREE + 1))  # degrees of the Earth's field
SIMILAR = 0.85  # similarity of two names of values from which one counts as a misspelling of the other


def check_model(cls: type, base: type, runs: Callable[[str, object], bool] | None = None) -> None:
    """Raise an error for a class of models, derived from ``base``, with definitions that would never be used.

    ``runs`` tells of a name and its definition whether they are used outside of the core. TypeError for hooks that do not exist
    here, misspelled tables, and tables that are not made of what they hold; ValueError for a component that has no place in the
    tick.
    """
    check_class(cls, base, (), UNUSED, runs)
    for owner in cls.__mro__:
        if owner is object or (owner is not cls and issubclass(owner, base)):
            continue  # checked when it was defined
        for name, value in vars(owner).items():
            if runs is None or not runs(name, value):
                _check_member(cls, owner, base, name, value)
    schedules = (vars(model).get("schedule") for model in (base, *_subclasses(base)))
    slots = {slot.name for schedule in schedules if isinstance(schedule, Schedule) for slot in schedule}
    for component in (*vars(cls).get("components", ()), *vars(cls).get("world_components", ())):
        if anchored(component)[0] not in slots:  # of another dynamics model: the environment that has both looks again
            vars(cls).get("schedule", SCHEDULE).place(component)


def _subclasses(base: type) -> Iterator[type]:
    children: list[type] = type.__subclasses__(base)
    for child in children:
        yield child
        yield from _subclasses(child)


def _check_member(cls: type, owner: type, base: type, name: str, value: object) -> None:
    title = f"{cls.__name__}.{name}"
    if name in TABLES:
        if base not in owner.__bases__ and not any(hasattr(parent, name) for parent in cls.__bases__):
            raise TypeError(f"{title} is never used; it belongs to {TABLES[name].owners}")
        _check_table(title, name, value)
    elif inspect.isclass(value):
        if name.endswith("Task"):
            raise TypeError(f"{title} is never used; tasks are components and modes here: {COMPONENT}")
    elif callable(value) or isinstance(value, staticmethod | classmethod):
        _check_method(title, name, value, base)
    elif not name.startswith("_") and not isinstance(value, property) and (meant := _misspelled(cls, name)) is not None:
        raise TypeError(f"{title} is never used; did you mean {meant!r}?")


def _check_method(title: str, name: str, value: object, base: type) -> None:
    if name.startswith("setup_"):
        raise TypeError(f"{title} is never used; {COMPONENT}")
    if name.startswith("action_"):
        command = name.removeprefix("action_")
        raise TypeError(
            f"{title} is never used; a command is a row of the table modes, which act.DiscreteFSWAction({command!r}) enters: "
            f"modes = {{{command!r}: fsw.Mode(('control_on', 'nadir_on'))}}"
        )
    if (
        name == "__init__"
        and inspect.isfunction(value)
        and len(names := _required(value)) > len(_required(inspect.getattr_static(base, "__init__")))
    ):
        raise TypeError(
            f"{title} requires {', '.join(names)}, but one object of the class is made for all episodes, without these. Write "
            "def __init__(self, *args, **kwargs), which calls super().__init__(*args, **kwargs); what depends on a satellite or "
            f"its arguments is a property, or {COMPONENT}"
        )
    if isinstance(getattr(value, "defaults", None), Mapping):
        raise TypeError(f"{title} has default arguments that are never used; {DEFAULTS}")


def _required(function: Callable[..., object]) -> list[str]:
    parameters = list(inspect.signature(function).parameters.values())[1:]
    variable = inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD
    return [each.name for each in parameters if each.default is inspect.Parameter.empty and each.kind not in variable]


def _check_table(title: str, name: str, value: object) -> None:
    example = f"it must be written like {TABLES[name].example}"
    if name in ("components", "world_components"):
        if not isinstance(value, tuple | list) or not all(isinstance(entry, Component) for entry in value):
            raise TypeError(f"{title}={value!r} is no tuple of Components; {example}")
    elif name in ("requires_world", "requires_dyn"):
        if not isinstance(value, tuple | list) or not all(inspect.isclass(entry) for entry in value):
            raise TypeError(f"{title}={value!r} is no tuple of models; {example}")
    elif name == "schedule" and not isinstance(value, Schedule):
        raise TypeError(f"{title}={value!r} is no Schedule, from bsk_torch.sim.schedule; {example}")
    elif name == "gravity_degree" and not (type(value) is int and value in DEGREES):
        raise TypeError(f"{title}={value!r} must be 0 (a point mass) or from {LEAST_DEGREE} to {DEGREE}; {example}")
    elif name in ("modes", "commands") and not isinstance(value, Mapping):
        raise TypeError(f"{title}={value!r} is no dictionary; {example}")


def _misspelled(cls: type, name: str) -> str | None:
    if any(hasattr(parent, name) for parent in cls.__bases__):
        return None
    return next(iter(difflib.get_close_matches(name, TABLES, n=1, cutoff=SIMILAR)), None)
