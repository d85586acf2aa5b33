"""Named, versioned environments; each module documents its decision process, and ``bsk-torch list`` prints names and tasks.

name                       module                      task
=========================  ==========================  ========================================================================
``NadirScan-v1``           ``presets.nadir_scan``      record the ground below; manage battery, wheels and data buffer
``NadirScience-v1``        ``presets.nadir_science``   the same with a strong disturbance: BSK-RL's ``nadir_science``
``FaultyScan-v1``          ``presets.faulty_scan``     NadirScan-v1 while parts of the satellite fail at random times
``Areas-v1``               ``tasks.areas``             record areas cell by cell, with a store that fills whatever lies below
``AEOS-v1``                ``presets.aeos``            choose which of the next 32 targets to image
``AEOSCity-v1``            ``presets.aeos``            the same, with cities as targets
``CloudyAEOS-v1``          ``presets.aeos``            the same under clouds, observed only as a forecast
``AEOSPower-v1``           ``presets.aeos_power``      the same, with a small battery and data buffer, and weak wheels
``AEOSConstellation-v1``   ``presets.constellation``   three imagers in one plane that share all knowledge once a minute
``Constellation-v1``       ``presets.constellation``   12 imagers that communicate along lines of sight
``RelayConstellation-v1``  ``presets.constellation``   four low imagers, two high relays; broadcasting is an action
``HeteroCluster-v1``       ``presets.hetero_cluster``  two optical satellites and a radar, to which clouds do not matter
``Sites-v1``               ``tasks.sites``             take mosaics of images that pay when complete, under weather
``SitesTeam-v1``           ``tasks.sites``             the same with two imagers, one behind the other
``RSOInspection-v1``       ``tasks.inspection``        fly around a spacecraft until its surface is inspected
``MultiInspection-v1``     ``tasks.inspection``        the same with three inspectors that must not collide
``Services-v1``            ``tasks.objects``           image satellites and debris again and again; the ground verifies the images
``ThreeSensors-v1``        ``tasks.objects``           three imagers of objects in orbit that know different images
``Walker4-v1``             ``tasks.objects``           four imagers that tell each other of images by radio
``CWDocking-v1``           ``tasks.safe_autonomy``     dock with thrusters below a speed limit; linear motion
``CWInspection-v1``        ``tasks.safe_autonomy``     inspect lit points of a spacecraft with thrusters; linear motion
``AEOSBench-v1``           ``tasks.aeos_bench``        AEOS-Bench: point satellites at tasks on the ground, second by second
=========================  ==========================  ========================================================================

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
