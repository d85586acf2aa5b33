"""Arguments of models with their defaults, in the order in which bsk_rl draws them from NumPy's global generator.

bsk_rl collects arguments from the methods of models by name: those of the tasks of the flight software first, the last task
before the others, then those of the flight software itself, then those of the dynamics. :mod:`bsk_torch.bsk_rl.methods` lists
the arguments declared by each method of each model there; constant values are those of the components here. Arguments of
components that bsk_rl lacks follow behind.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from copy import deepcopy

import numpy as np

from bsk_torch.bsk_rl.methods import DYN, FSW, TASKS, WORLD, Methods
from bsk_torch.bsk_rl.utils.attitude import random_tumble
from bsk_torch.bsk_rl.utils.orbital import random_epoch, random_orbit
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Distribution
from bsk_torch.sim.component import Arg, Component

RANDOM: dict[str, Callable[[], object]] = {
    "utc_init": random_epoch,
    "oe": random_orbit,
    "sigma_init": lambda: random_tumble(maxSpinRate=0.0001)[0],
    "omega_init": lambda: random_tumble(maxSpinRate=0.0001)[1],
    "wheelSpeeds": lambda: np.random.uniform(-1500, 1500, 3),
    "storedCharge_Init": lambda: np.random.uniform(30.0 * 3600.0, 70.0 * 3600.0),
}
"""Arguments that are drawn unless they are given; attitude and rate each draw both, as in bsk_rl."""

FIXED: dict[str, object] = {
    "utc_init": "this value will be set by the world model",
    "groundLocationPlanetRadius": R_EARTH,
    "imageTargetMinimumElevation": math.radians(45.0),
    "imageTargetMaximumRange": -1.0,
    "inst_pHat_B": [0.0, 0.0, 1.0],
}
"""Arguments of satellites that only some models of bsk_rl declare, or that components lack because others replace them."""


ARRAYS = ("nHat_B",)
"""Vectors that are arrays in bsk_rl; others are lists."""


def safe_dict_merge(updates: Mapping[str, object], base: dict[str, object]) -> dict[str, object]:
    """Add copies of the entries of ``updates`` to ``base``, with a warning for those that replace others; return ``base``."""
    for name, value in updates.items():
        if name in base and np.any(base[name] != value):
            warnings.warn(f"Conflicting values for {name}: overwriting {base[name]} with {value}", stacklevel=2)
    base.update(deepcopy(dict(updates)))
    return base


def sat_defaults(dyn_type: type, fsw_type: type) -> dict[str, object]:
    """Return all arguments of satellites of two models, by name: constants, or functions that draw a value."""
    components = (*dyn_type.all_components(), *fsw_type.all_components())  # type: ignore[attr-defined]
    values = {**FIXED, **_values(components, without="utc_init")}
    args = _collected(dyn_type, _methods(dyn_type, DYN), values)
    args = safe_dict_merge(args, _collected(fsw_type, _methods(fsw_type, FSW), values))
    tasks = _tasks(fsw_type)
    for name in sorted(tasks):
        args = safe_dict_merge(args, _collected(getattr(fsw_type, name, None), tasks[name], values))
    replaced = {arg for name in _replaced(dyn_type, _methods(dyn_type, DYN)) for arg in _methods(dyn_type, DYN)[name].split()}
    return args | {name: value for name, value in values.items() if name not in {*args, *FIXED, *replaced}}


def model_defaults(model: type) -> dict[str, object]:
    """Return the arguments that the methods of one model declare, without those of tasks; see :func:`sat_defaults`."""
    values = {**FIXED, **_values(model.all_components())}  # type: ignore[attr-defined]
    return _collected(model, _methods(model, {**DYN, **FSW, **WORLD}), values)


def world_defaults(world_type: type) -> dict[str, object]:
    """Return all arguments of a world model by name; see :func:`sat_defaults`."""
    values = _values(world_type.all_components())  # type: ignore[attr-defined]
    values.pop("earthRotation", None)  # bsk_rl has one model of it
    if "groundLocationPlanetRadius" in values:  # stations of bsk_rl lie on a sphere
        values["groundLocationPlanetRadius"] = R_EARTH
    args = _collected(world_type, _methods(world_type, WORLD), values)
    return args | {name: value for name, value in values.items() if name not in args}


def _methods(model: type, table: Mapping[type, Methods]) -> Methods:
    return {name: args for base in reversed(model.__mro__) for name, args in table.get(base, {}).items()}


def _tasks(model: type) -> dict[str, Methods]:
    """Return the declaring methods of each task of flight software, and the tasks of its subclasses that declare others."""
    listed = {name: methods for base in reversed(model.__mro__) for name, methods in TASKS.get(base, {}).items()}
    tasks = (name for name in dir(model) if name.endswith("Task"))
    return listed | {name: listed.get(name, {}) for name in tasks}


def _collected(model: object, methods: Methods, values: Mapping[str, object]) -> dict[str, object]:
    """Return the arguments that methods declare, in the order of their names, and those that users have declared with them."""
    declared: dict[str, dict[str, object]] = {}  # by utils.functional.default_args, by method
    if model is not None:
        marked = (name for name in dir(model) if not name.startswith("__") and hasattr(getattr(model, name), "defaults"))
        declared = {name: dict(getattr(model, name).defaults) for name in marked}
    args: dict[str, object] = {}
    for name in sorted({*methods, *declared} - _replaced(model, methods)):
        safe_dict_merge(declared.get(name) or {arg: values[arg] for arg in methods[name].split()}, args)
    return args


def _replaced(model: object, methods: Methods) -> set[str]:
    """Return the names of methods that a user's model defines without declaring arguments: there are none then, as in bsk_rl."""
    attributes = {name: getattr(model, name, None) for name in methods}
    return {
        name
        for name, method in attributes.items()
        if method is not None and not method.__module__.startswith("bsk_torch.") and not hasattr(method, "defaults")
    }


def _values(components: tuple[Component, ...], without: str = "") -> dict[str, object]:
    args = (arg for component in components for arg in component.args if arg.name != without)
    return {arg.name: _value(arg) for arg in args}


def _value(arg: Arg) -> object:
    if arg.name in RANDOM and isinstance(arg.default, Distribution):
        return RANDOM[arg.name]
    if arg.name in ARRAYS:
        return np.array(arg.default)
    if isinstance(arg.default, tuple):
        return list(arg.default)
    return int(arg.default) if arg.whole and isinstance(arg.default, float) and math.isfinite(arg.default) else arg.default
