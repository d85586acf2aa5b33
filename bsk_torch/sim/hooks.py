"""Checks of the classes that users derive from the package's base classes.

A hook is a method, property or value of a base class that subclasses may define. A definition that the package would never use
otherwise shows only as a wrong result, so :func:`check_class` raises an error when the class is defined.
"""

from __future__ import annotations

import difflib
import inspect
import logging
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

SIMILAR = 0.8  # similarity of two names (`difflib`'s ratio) from which one counts as a misspelling of the other

FLEET_MEMORY = (
    "keep values that are reset with every episode in self.fleet.memory, where link(fleet) declares them: "
    "fleet.memory.declare(name, initial_value)"
)
"""Advice for scenarios and communication methods that keep values of episodes themselves."""


FOR_ONE_EPISODE = {
    *("reset_overwrite_previous", "reset_pre_sim_init", "reset_during_sim_init", "reset_post_sim_init"),
    *("link_simulator", "link_satellites", "link_scenario", "space", "action_space", "observation_space"),
    *("set_action", "set_action_override", "get_action_mask", "get_obs", "get_observation", "regenerate_targets"),
    *("get_log_state", "compare_log_states", "update_from_logs", "create_data_store", "initial_data", "data_type"),
    *("data_store_type", "stage_communicated_data", "update_with_communicated_data", "update_timed_terminal_event"),
    *("parse_target_selection", "enable_target_window"),
}
"""Names that classes written for one episode define, and no class of batches."""

NOTHING: Mapping[str, str] = {}

logger = logging.getLogger(__name__)

_noted: set[str] = set()


def note_slow(title: str, advice: str) -> None:
    """Log, once for each ``title``, that a hook is called environment by environment, and what is faster."""
    if title not in _noted:
        _noted.add(title)
        logger.warning("%s is called for each environment, which is slow; to be fast, %s", title, advice)


def is_of_package(function: object) -> bool:
    """Return whether a function belongs to this package, and not to a user's module."""
    return str(getattr(function, "__module__", "")).startswith(__name__.partition(".")[0] + ".")


def check_class(
    cls: type,
    base: type,
    hooks: Sequence[str],
    unused: Mapping[str, str] = NOTHING,
    runs: Callable[[str, object], bool] | None = None,
) -> None:
    """Raise TypeError for definitions of a subclass that would never be used; call from ``base.__init_subclass__``.

    Bases of the class that do not derive from ``base``, which declares the ``hooks``, are checked with it. ``unused`` are names
    that a user may expect to be hooks, each with advice what to write instead; ``runs`` tells which definitions, by name and
    value, something else uses. Others that are wrong: a hook of classes for one
    episode, a method of the base class that is final, a public method spelled almost like a hook and callable like it, and a
    hook of another kind than the base class's, or not callable with the arguments of the hook.
    """
    for owner in cls.__mro__:
        if owner is object or (owner is not cls and issubclass(owner, base)):
            continue  # checked when it was defined
        for name, value in vars(owner).items():
            if runs is not None and runs(name, value):
                continue
            if name in hooks:
                _check_hook(f"{cls.__name__}.{name}", value, inspect.getattr_static(base, name))
            elif name in unused:
                raise TypeError(f"{cls.__name__}.{name} is never used; {unused[name]}")
            elif name in FOR_ONE_EPISODE:
                raise TypeError(
                    f"{cls.__name__}.{name} is never used: it is a hook of classes for one episode, which bsk_torch.bsk_rl runs; "
                    f"hooks of {base.__name__} are {', '.join(hooks)}"
                )
            elif getattr(declared := inspect.getattr_static(base, name, None), "__final__", False) and value is not declared:
                raise TypeError(f"{cls.__name__}.{name} is called by environments; define one of {', '.join(hooks)} instead")
            elif (meant := _misspelled(cls, owner, name, value, base, hooks)) is not None:
                raise TypeError(
                    f"{cls.__name__}.{name} is never used; did you mean {meant!r}? The name of a helper may begin with an "
                    f"underscore: '_{name}'"
                )


def defined_first(instance: object, *names: str) -> str:
    """Return the name defined closest to an instance: in itself, its class, or the first of the bases that define one."""
    for namespace in (vars(instance), *(vars(cls) for cls in type(instance).__mro__)):
        for name in names:
            if name in namespace:
                return name
    raise AttributeError(f"{type(instance).__name__} defines none of {list(names)}")


def overrides(instance: object, base: type, name: str) -> bool:
    """Return whether a method of an instance is not the one of ``base``."""
    return getattr(getattr(instance, name), "__func__", None) is not getattr(base, name)


def check_tensor(title: str, value: object, shape: Sequence[int], *dtypes: torch.dtype) -> None:
    """Raise TypeError unless a hook's result is a tensor of a shape and of one of several dtypes, any if none is given."""
    if isinstance(value, Tensor) and value.shape == tuple(shape) and (not dtypes or value.dtype in dtypes):
        return
    description = f"a tensor of shape {list(value.shape)} and dtype {value.dtype}" if isinstance(value, Tensor) else repr(value)
    kinds = f" and dtype {' or '.join(map(str, dtypes))}" if dtypes else ""
    raise TypeError(f"{title} is {description}; it must be a tensor of shape {list(shape)}{kinds}")


def _kind(value: object) -> str:
    if isinstance(value, property | cached_property):
        return "property"
    return "method" if callable(value) or isinstance(value, staticmethod | classmethod) else "value"


def _check_hook(title: str, value: object, declared: object) -> None:
    if (_kind(value) == "method") != (_kind(declared) == "method"):
        raise TypeError(f"{title} is a {_kind(value)}; it must be a {_kind(declared)}")
    if _kind(declared) == "method" and not _callable_like(value, declared):
        name = title.rpartition(".")[2]
        wanted = ", ".join(_parameters(declared))
        raise TypeError(f"{title}{inspect.signature(_function(value))} cannot be called as {name}({wanted})")


def _misspelled(cls: type, owner: type, name: str, value: object, base: type, hooks: Sequence[str]) -> str | None:
    if name.startswith("_") or _kind(value) == "value" or isinstance(value, type):
        return None
    if any(name in vars(other) for other in cls.__mro__ if other is not owner):
        return None  # overrides a method of another base, which is free to have any
    for meant in difflib.get_close_matches(name, hooks, n=1, cutoff=SIMILAR):
        declared = inspect.getattr_static(base, meant)
        if _kind(value) == _kind(declared) and (_kind(value) == "property" or _callable_like(value, declared)):
            return meant
    return None


def _function(value: Any) -> Callable[..., Any]:
    return value.__func__ if isinstance(value, staticmethod | classmethod) else value


def _parameters(declared: object) -> list[str]:
    return list(inspect.signature(_function(declared)).parameters)[0 if isinstance(declared, staticmethod) else 1 :]


def _callable_like(value: object, declared: object) -> bool:
    try:
        signature = inspect.signature(_function(value))
    except (TypeError, ValueError):
        return True
    bound = 1 if isinstance(value, classmethod) or (hasattr(value, "__get__") and not isinstance(value, staticmethod)) else 0
    try:
        signature.bind(*[None] * (bound + len(_parameters(declared))))
    except TypeError:
        return False
    return True


def check_linked(part: object, method: str, fleet: object) -> None:
    """Raise TypeError unless the ``link`` of a part of an environment has reached its base class, which keeps the fleet."""
    if getattr(part, "fleet", None) is not fleet:
        raise TypeError(f"{type(part).__name__}.{method} must call super().{method}")


class ChangeGuard:
    """Finds public attributes in which an object keeps its own tensors from step to step.

    Such values would not be reset, saved and restored with the episodes that they belong to. A tensor assigned once, such
    as a table built when it is first needed, is allowed.
    """

    def __init__(self) -> None:
        self._seen: dict[str, tuple[Tensor, int]] = {}

    def check(self, instance: object, advice: str, exempt: Sequence[str] = ()) -> None:
        """Compare with the last check; TypeError if an attribute holds another tensor, or one changed in place since.

        Attributes whose names begin with an underscore, and ``exempt`` ones, may change; ``advice`` tells what to do instead.
        """
        for name, value in vars(instance).items():
            if not isinstance(value, Tensor) or name.startswith("_") or name in exempt:
                continue
            version = 0 if value.is_inference() else value._version
            recorded = self._seen.setdefault(name, (value, version))
            if recorded[0] is not value or recorded[1] != version:
                raise TypeError(
                    f"{type(instance).__name__}.{name} is a tensor that has changed during an episode; {advice}. The name of a "
                    f"cache, which can be recomputed at any time, begins with an underscore: '_{name}'"
                )
