"""Named, versioned environments; each module documents its decision process, and ``bsk-torch list`` prints names and tasks.

:data:`bsk_torch._listed.LISTED` is the one table of them: name, module and function, task, rules.
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from bsk_torch._listed import LISTED
from bsk_torch._rooms import Entries
from bsk_torch.env.assembly.devices import check_default_device
from bsk_torch.sim.arguments.values import nearest

__all__ = ["PRESETS", "make"]

PRESETS: Entries[Callable[..., object]] = Entries({name: preset.function for name, preset in LISTED.items()})
"""Presets by name: functions of the arguments of the environment to override."""


def make(name: str, **options: object) -> Any:
    """Return the environment of a preset.

    Args:
        name: One of :data:`PRESETS`, such as ``"NadirScan-v1"``.
        **options: Arguments of the environment to override, such as ``num_envs=1024``; ``sat_args``
            are merged with the preset's.

    Raises:
        TypeError: For an unknown option; the message contains the nearest one.
        ValueError: For an unknown name, with the nearest one; for ``sat_args`` that are not a dictionary; for switches that are
            not booleans; if torch's default device is "meta".
    """
    check_default_device()
    if name not in PRESETS:
        if folder := PRESETS.absent.get(name):
            raise ValueError(f"name={name!r} is not installed: this copy of bsk_torch has no folder {folder}")
        if ":" in name:
            raise ValueError(
                f"name={name!r} is a function of a user's program, which is not imported because a file names it; if you trust "
                f"it, name it yourself: --preset {name}, with --resume preset={name}, or bsk_torch.train({name!r})"
            )
        raise ValueError(f"name={name!r} is not a preset; {nearest(name, PRESETS)}")
    parameters = [p for p in inspect.signature(PRESETS[name]).parameters.values() if p.kind is not p.VAR_KEYWORD]
    for parameter in parameters:
        value = options.get(parameter.name, parameter.default)
        if parameter.annotation == "bool" and not isinstance(value, bool):
            raise ValueError(f"{parameter.name}={value!r} must be True or False")
    if not isinstance(options.get("sat_args") or {}, Mapping):
        raise ValueError(f"sat_args={options['sat_args']!r} must be a dictionary of arguments")
    try:
        return PRESETS[name](**options)
    except TypeError as error:
        names = [parameter.name for parameter in parameters]
        for option in options:
            if str(error).startswith(f"unexpected keyword argument {option!r}") and difflib.get_close_matches(option, names):
                raise TypeError(
                    f"unexpected keyword argument {option!r}: {name} has no such option; {nearest(option, names)}"
                ) from None
        raise
