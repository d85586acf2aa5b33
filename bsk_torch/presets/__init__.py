"""Named, versioned environments; each module documents its decision process.

=========================  ==========================  ==================================================================
name                       module                      task
=========================  ==========================  ==================================================================
``NadirScan-v1``           ``presets.nadir_scan``      record the ground below; manage battery, wheels and data buffer
``NadirScience-v1``        ``presets.nadir_science``   the same with a strong disturbance: BSK-RL's ``nadir_science``
``FaultyScan-v1``          ``presets.faulty_scan``     NadirScan-v1 while parts of the satellite fail at random times
``AEOS-v1``                ``presets.aeos``            choose which of the next 32 targets to image
``AEOSCity-v1``            ``presets.aeos``            the same, with cities as targets
``CloudyAEOS-v1``          ``presets.aeos``            the same under clouds, observed only as a forecast
``AEOSPower-v1``           ``presets.aeos_power``      the same, with a small battery and data buffer, and weak wheels
``AEOSConstellation-v1``   ``presets.constellation``   three imagers in one plane that share all knowledge once a minute
``Constellation-v1``       ``presets.constellation``   12 imagers that communicate along lines of sight
``RelayConstellation-v1``  ``presets.constellation``   four low imagers, two high relays; broadcasting is an action
``HeteroCluster-v1``       ``presets.hetero_cluster``  two optical satellites and a radar, to which clouds do not matter
``RSOInspection-v1``       ``presets.inspection``      fly around a spacecraft until its surface is inspected
``MultiInspection-v1``     ``presets.inspection``      the same with three inspectors that must not collide
``Services-v1``            ``presets.services``        image satellites and debris again and again; the ground verifies the images
``ThreeSensors-v1``        ``presets.sensors``         three imagers of objects in orbit that know different images
``Walker4-v1``             ``presets.sensors``         four imagers that tell each other of images by radio
``CWDocking-v1``           ``presets.cw_docking``      dock by thrusters, slowly enough at every distance; linear motion
``CWInspection-v1``        ``presets.cw_inspection``   inspect lit points of a spacecraft by thrusters; linear motion
``AEOSBench-v1``           ``presets.aeos_bench``      AEOS-Bench: point satellites at tasks on the ground, second by second
=========================  ==========================  ==================================================================
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from bsk_torch.env.assembly.devices import check_default_device
from bsk_torch.presets.aeos import aeos, aeos_city, cloudy_aeos
from bsk_torch.presets.aeos_bench import aeos_bench
from bsk_torch.presets.aeos_power import aeos_power
from bsk_torch.presets.constellation import aeos_constellation, constellation, relay_constellation
from bsk_torch.presets.cw_docking import cw_docking
from bsk_torch.presets.cw_inspection import cw_inspection
from bsk_torch.presets.faulty_scan import faulty_scan
from bsk_torch.presets.hetero_cluster import hetero_cluster
from bsk_torch.presets.inspection import multi_inspection, rso_inspection
from bsk_torch.presets.nadir_scan import nadir_scan
from bsk_torch.presets.nadir_science import nadir_science
from bsk_torch.presets.sensors import three_sensors, walker4
from bsk_torch.presets.services import services
from bsk_torch.sim.arguments.values import nearest

__all__ = ["PRESETS", "make"]

PRESETS: dict[str, Callable[..., Any]] = {
    "NadirScan-v1": nadir_scan,
    "NadirScience-v1": nadir_science,
    "FaultyScan-v1": faulty_scan,
    "AEOS-v1": aeos,
    "AEOSPower-v1": aeos_power,
    "AEOSCity-v1": aeos_city,
    "CloudyAEOS-v1": cloudy_aeos,
    "Constellation-v1": constellation,
    "AEOSConstellation-v1": aeos_constellation,
    "RelayConstellation-v1": relay_constellation,
    "HeteroCluster-v1": hetero_cluster,
    "RSOInspection-v1": rso_inspection,
    "MultiInspection-v1": multi_inspection,
    "Services-v1": services,
    "ThreeSensors-v1": three_sensors,
    "Walker4-v1": walker4,
    "CWDocking-v1": cw_docking,
    "CWInspection-v1": cw_inspection,
    "AEOSBench-v1": aeos_bench,
}
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
        own = [parameter.name for parameter in parameters]
        for option in options:
            if str(error).startswith(f"unexpected keyword argument {option!r}") and difflib.get_close_matches(option, own):
                raise TypeError(
                    f"unexpected keyword argument {option!r}: {name} has no such option; {nearest(option, own)}"
                ) from None
        raise
