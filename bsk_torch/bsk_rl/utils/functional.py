"""Helpers of classes that are reset with every episode; counterpart of ``bsk_rl.utils.functional``."""

from __future__ import annotations

import functools
import re
import types
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar
from unittest.mock import MagicMock

import numpy as np

from bsk_torch.bsk_rl.defaults import model_defaults, safe_dict_merge
from bsk_torch.bsk_rl.older import check_arguments
from bsk_torch.sim import dyn, fsw, world

__all__ = [
    "AbstractClassProperty",
    "Resetable",
    "aliveness_checker",
    "check_aliveness_checkers",
    "collect_default_args",
    "default_args",
    "is_property",
    "safe_dict_merge",
    "valid_func_name",
    "vectorize_nested_dict",
]

Function = TypeVar("Function", bound=Callable[..., object])


class Resetable:
    """Base of what is reset with every episode: satellites, scenarios, rewarders and communicators.

    ``env.reset`` calls the hooks in this order: :meth:`reset_overwrite_previous` before anything is drawn,
    :meth:`reset_pre_sim_init` before and :meth:`reset_during_sim_init` while the simulation is made, and
    :meth:`reset_post_sim_init` when it is at time zero.
    """

    def reset_overwrite_previous(self) -> None:
        """Forget what belongs to the last episode."""

    def reset_pre_sim_init(self) -> None:
        """Prepare an episode, before there is a simulation."""

    def reset_during_sim_init(self) -> None:
        """Prepare an episode, when satellites have their models and the clock has not begun."""

    def reset_post_sim_init(self) -> None:
        """Prepare an episode, at time zero."""


class Part(Resetable):
    """An action or an observation: ``satellite`` is the satellite that has it, ``simulator`` the simulation of the episode."""

    satellite: Any
    simulator: Any

    def __new__(cls, *args: object, **kwargs: object) -> Any:
        """Make a part; TypeError for an argument of older versions of bsk_rl."""
        check_arguments(cls, kwargs)
        return super().__new__(cls)

    def link_satellite(self, satellite: object) -> None:
        """Store the satellite."""
        self.satellite = satellite

    def link_simulator(self, simulator: object) -> None:
        """Store the simulation of the episode."""
        self.simulator = simulator


def _passing(hook: str) -> Callable[[ResetableGroup], None]:
    def passed(self: ResetableGroup) -> None:
        getattr(super(ResetableGroup, self), hook)()
        for part in self._parts():
            getattr(part, hook)()

    return passed


class ResetableGroup(Resetable):
    """Passes the hooks on to its parts, after those of the class itself."""

    def _parts(self) -> Iterable[Resetable]:
        raise NotImplementedError(f"{type(self).__name__} must implement _parts()")

    reset_overwrite_previous = _passing("reset_overwrite_previous")
    reset_pre_sim_init = _passing("reset_pre_sim_init")
    reset_during_sim_init = _passing("reset_during_sim_init")
    reset_post_sim_init = _passing("reset_post_sim_init")


# -- default arguments -----------------------------------------------------------------------------------------------------------


def default_args(**defaults: object) -> Callable[[Function], Function]:
    """Return a decorator that declares ``defaults`` as arguments of a model, for ``sat_args`` or ``world_args``."""

    def declare(function: Function) -> Function:
        function.defaults = dict(defaults)  # type: ignore[attr-defined]
        return function

    return declare


def collect_default_args(object: object) -> dict[str, object]:
    """Return what :func:`default_args` has declared on the methods of a class or object, by the names of the methods in order.

    Of a class of models, the result has the arguments that its counterpart in bsk_rl declares, too.
    """
    if isinstance(object, type) and issubclass(object, dyn.DynamicsModel | fsw.FSWModel | world.WorldModel):
        return model_defaults(object)
    defaults: dict[str, Any] = {}
    for method in _marked(object, "defaults"):
        safe_dict_merge(method.defaults, defaults)
    return defaults


def _marked(object: object, mark: str) -> list[Any]:
    """Return the methods that have an attribute, by name; properties are not read."""
    names = (name for name in dir(object) if not name.startswith("__") and not is_property(object, name))
    members = (getattr(object, name, None) for name in names)
    return [member for member in members if callable(member) and hasattr(member, mark)]


def aliveness_checker(method: Function) -> Function:
    """Mark a method of a model as an aliveness check, and let it take ``log_failure``.

    With ``log_failure=True``, the logger of the model's satellite gets a warning of a failure.
    """

    @functools.wraps(method)
    def checked(self: Any, *args: Any, log_failure: bool = False, **options: Any) -> Any:
        alive = method(self, *args, **options)
        if log_failure and not np.all(np.asarray(alive)):
            self.satellite.logger.warning(f"failed {method.__name__} check")
        return alive

    return dyn.aliveness_checker(checked)  # type: ignore[return-value]  # mypy: wraps() keeps the signature


def check_aliveness_checkers(model: object, log_failure: bool = False) -> bool:
    """Return whether all methods of a model that :func:`aliveness_checker` marks hold.

    Args:
        model: Model of a satellite.
        log_failure: Whether the logger of ``model.satellite`` gets a warning of the first one that does not.
    """
    for method in _marked(model, "is_aliveness_checker"):
        if not np.all(np.asarray(method())):
            if log_failure:
                model.satellite.logger.warning(f"failed {method.__name__} check")  # type: ignore[attr-defined]
            return False
    return True


def is_property(obj: object, attr_name: str) -> bool:
    """Return whether the class of an object defines a name as a property, which is not read."""
    return isinstance(getattr(type(obj), attr_name, None), property)


# -- names and vectors -----------------------------------------------------------------------------------------------------------


def valid_func_name(name: str) -> str:
    """Return a name with underscores for what Python's names may not have."""
    name = re.sub(r"\W+", "_", name)
    return f"_{name}" if name[0].isdigit() else name


def vectorize_nested_dict(dictionary: Mapping[str, object]) -> tuple[list[str], np.ndarray]:
    """Return the names and numbers of nested dictionaries, as ``"target.priority"`` or ``"r_BN_N[0]"``, one after another.

    Raises:
        TypeError: For what is no number, list, array or dictionary of such.
    """
    names: list[str] = []
    for key, value in dictionary.items():
        if isinstance(value, Mapping):
            names += [f"{key}.{name}" for name in vectorize_nested_dict(value)[0]]
        elif isinstance(value, np.ndarray | list):
            names += [f"{key}[{k}]" for k in range(np.size(value) if isinstance(value, np.ndarray) else len(value))]
        else:
            names.append(key)
    return names, numbers_of(dictionary)


def numbers_of(dictionary: Mapping[str, object]) -> np.ndarray:
    """Return the numbers of nested dictionaries; see :func:`vectorize_nested_dict`."""
    parts: list[np.ndarray] = []
    single: list[object] = []  # numbers since the last array

    def walk(entries: Mapping[str, object]) -> None:
        for key, value in entries.items():
            if isinstance(value, float | int) or (
                isinstance(value, np.number | np.bool_) and not isinstance(value, np.complexfloating)
            ):
                single.append(value)
            elif isinstance(value, np.ndarray | list):
                if single:
                    parts.append(np.array(single))
                    single.clear()
                parts.append(value.flatten() if isinstance(value, np.ndarray) else np.asarray(value))
            elif isinstance(value, Mapping):
                walk(value)
            else:
                raise TypeError(f"{key}={value!r} cannot be part of a vector: give a number, a list or an array")

    walk(dictionary)
    if single or not parts:
        parts.append(np.array(single))
    return np.concatenate(parts)


# -- composition of classes ------------------------------------------------------------------------------------------------------


class AbstractClassProperty:
    """A class attribute that subclasses must define; reading it of an instance raises NotImplementedError."""

    __isabstractmethod__ = True
    name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, instance: object, owner: type) -> AbstractClassProperty:
        if instance is None:
            return self
        raise NotImplementedError(f"{owner.__name__}.{self.name} must be defined by the subclass")


def mock_safe_bases(*bases: type | MagicMock) -> tuple[type, ...]:
    """Return classes, with the classes that mocks stand for in place of mocks."""
    return tuple((base._spec_class or object) if isinstance(base, MagicMock) else base for base in bases)


def remove_duplicate_bases(*bases: type) -> tuple[type, ...]:
    """Return classes without repetitions, in their order."""
    return tuple(dict.fromkeys(bases))


def remove_inherited_bases(*bases: type) -> tuple[type, ...]:
    """Return the classes from which no other one of them is derived."""
    return tuple(base for base in bases if not any(base is not other and issubclass(other, base) for other in bases))


def compose_types(*types_: type, name: str = "") -> type:
    """Return a class derived from all of ``types_``, the first of which comes first; ``name`` begins its name."""
    title = f"{name}({', '.join(part.__name__ for part in types_)})"
    return types.new_class(title, mock_safe_bases(*remove_inherited_bases(*remove_duplicate_bases(*types_))))
