"""Names of bsk_rl before version 1.3, and what to write today: the table of the messages for programs that use them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib.machinery import ModuleSpec
from typing import NoReturn

ROOT = __name__.rpartition(".")[0]

MODULES = {
    "env.gym_env": "", "env.scenario.actions": "act", "env.scenario.communication": "comm", "env.scenario.data": "data",
    "env.scenario.environment_features": "scene", "env.scenario.observations": "obs", "env.scenario.sat_actions": "act",
    "env.scenario.sat_observations": "obs", "env.scenario.satellites": "sats", "env.simulation.dynamics": "sim.dyn",
    "env.simulation.environment": "sim.world", "env.simulation.fsw": "sim.fsw", "env.simulation.simulator": "sim",
    "env.types": "", "env": "", "envs": "", "observation": "obs", "sat": "sats",
}  # fmt: skip
"""Modules below bsk_rl, and the present ones."""

NAMES = {
    "data": {
        "DataManager": "GlobalReward", "NoDataManager": "NoReward", "NadirScanningManager": "ScanningTimeReward",
        "NadirScanningTimeData": "ScanningTime", "ScanningNadirTimeStore": "ScanningTimeStore",
        "UniqueImagingManager": "UniqueImageReward",
    },
    "scene": {
        "EnvironmentFeatures": "Scenario", "StaticTargets": "UniformTargets", "UniformNadirFeature": "UniformNadirScanning",
    },
    "act": {
        "ChargingAction": "Charge", "DesatAction": "Desat", "DiscreteSatAction": "DiscreteAction", "DownlinkAction": "Downlink",
        "DriftAction": "Drift", "ImagingActions": "Image", "NadirImagingAction": "Scan", "SatAction": "Action",
    },
    "obs": {
        "EclipseState": "Eclipse", "GroundStationState": "OpportunityProperties with type='ground_station'",
        "NormdPropertyState": "SatProperties", "SatObservation": "Observation", "TargetState": "OpportunityProperties",
        "TimeState": "Time",
    },
    "sats": {
        "BasicSatellite": "Satellite", "FBImagerSatellite": "ImagingSatellite with fsw_type = fsw.ImagingFSWModel",
        "FullFeaturedSatellite": "ImagingSatellite", "ImageAheadSatellite": "ImagingSatellite",
        "SteeringImagerSatellite": "ImagingSatellite with fsw_type = fsw.SteeringImagerFSWModel",
    },
    "sim.world": {
        "BasicEnvironmentModel": "EclipseWorldModel and AtmosphereWorldModel, or leave world_type out",
        "BasicWorldModel": "EclipseWorldModel and AtmosphereWorldModel, or leave world_type out",
        "GroundStationEnvModel": "GroundStationWorldModel", "EnvironmentModel": "WorldModel",
    },
    "": {"MultiagentSatelliteTasking": "ConstellationTasking", "SingleSatelliteTasking": "SatelliteTasking"},
}  # fmt: skip
"""Names of classes by module, and what to write."""

ARGUMENTS = {
    "GeneralSatelliteTasking": {
        "env_features": "scenario", "data_manager": "rewarder", "env_type": "world_type", "env_args": "world_args",
    },
    "SatelliteTasking": {"satellites": "satellite"},
    "ConstellationTasking": {"satellite": "satellites"},
    "Image": {"n_ahead_act": "n_ahead_image"},
    "ImagingSatellite": {"n_ahead_observe": "n_ahead_observe of obs.OpportunityProperties",
                         "n_ahead_act": "n_ahead_image of act.Image"},
}  # fmt: skip
"""Arguments by class, and their present names."""


def check_arguments(kind: type, names: Iterable[str]) -> None:
    """Raise TypeError for an argument of a class that had another name in older versions."""
    renamed = {name: now for base in reversed(kind.__mro__) for name, now in ARGUMENTS.get(base.__name__, {}).items()}
    for name in names:
        if name in renamed:
            raise TypeError(f"{kind.__name__}({name}=...) is written as in bsk_rl before 1.3; write {renamed[name]} now")


def advising(module: str, advice: Mapping[str, str]) -> Callable[[str], NoReturn]:
    """Return ``__getattr__`` of a module, which raises ImportError with ``advice`` for names of bsk_rl that are not there."""

    def find(name: str) -> NoReturn:
        if name in advice:
            raise ImportError(f"{module}.{name} {advice[name]}")
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return find


def renamed_in(module: str) -> Callable[[str], NoReturn]:
    """Return ``__getattr__`` of a module, which tells what to write in place of a name of older versions."""
    place = module.removeprefix(ROOT).strip(".")
    names = {name: f"{place}.{now}".lstrip(".") for name, now in NAMES[place].items()}
    return advising(module, {name: f"is a name of bsk_rl before 1.3; write {now} now" for name, now in names.items()})


class OlderModules:
    """Tells what to import in place of a module of older versions, which nothing else has found."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Raise ModuleNotFoundError for a module of older versions; see :class:`importlib.abc.MetaPathFinder`."""
        place = name.removeprefix(f"{ROOT}.")
        if place == name or place not in MODULES:
            return None
        table = "; ".join(f"{old}: {f'{ROOT}.{now}'.strip('.')}" for old, now in MODULES.items() if old.startswith(f"{place}."))
        now = f"{ROOT}.{MODULES[place]}".strip(".")
        raise ModuleNotFoundError(
            f"{name} is a module of bsk_rl before 1.3; import {now} now" + (f" (modules below it: {table})" if table else ""),
            name=name,
        )


sys.meta_path.append(OlderModules)
