"""The modules and messages of Basilisk that programs of bsk_rl usually read, answered from the simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple, Protocol

import numpy as np

COMPONENT = (
    "parts of a spacecraft are components here: write a Component and list it in components= of a model "
    "(docs/how_to/own_component.md), and read its fields by a property of the model"
)

ABSENT = (
    "faultList", "fsw_proc", "dyn_proc", "tasks", "processName", "rwFactory", "thrusterSet", "rwNullSpace",
    "rwConstellationConfigInMsg", "rwMotorTorque", "mrpFeedbackControl", "mrpSteeringControl", "servo", "sunPoint",
    "hillPoint", "trackingError", "thrForceMapping", "thrDump", "momentumDump", "thrusterDump", "extForceTorqueObject",
    "dragEffector", "densityModel", "wheelSinkList", "powerSinkList", "AddModelToTask", "CreateNewTask", "CreateNewProcess",
    "enableTask", "disableTask", "Gs", "vcConfigMsg", "attRefMsg",
)  # fmt: skip
"""Attributes of Basilisk's objects that there are no counterparts of."""

KEPT = (
    "maxWheelSpeed", "conjunction_radius", "max_range_radius", "chief_name", "storageUnitValidCheck", "desatAttitude", "mu",
    "min_orbital_radius", "groundLocationPlanetRadius", "gsMinimumElevation", "gsMaximumRange",
)  # fmt: skip
"""Arguments that models of bsk_rl keep as attributes of the same name."""

WHOLE_STORE = "STORED DATA"
"""Name that Basilisk gives the only partition of a simple store."""

WHEELS = 36
"""Number of wheels that Basilisk's messages have places for; those that do not exist are at rest."""

LISTS = ("r_BN_N", "v_BN_N", "sigma_BN", "omega_BN_B")
"""Properties that are lists in bsk_rl, which adds them as such; other vectors are arrays."""


def advice(name: str) -> str:
    """Return what to write instead of a module or message of Basilisk's; nothing for another name."""
    if name in ABSENT or name.endswith(("InMsg", "OutMsg", "Msgs", "Object", "Task")):
        return f"{name} is an object of Basilisk's, and bsk_torch has none; {COMPONENT}"
    return ""


class Payload(SimpleNamespace):
    """What a message holds."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise AttributeError(
            f"{name!r} of a message of Basilisk's cannot be read here; known are {sorted(vars(self))}. {COMPONENT}"
        )


class View(Protocol):
    """A dynamics model, or the world, whose quantities modules and messages read by name."""

    def __getattr__(self, name: str) -> Any: ...


class Message:
    """A message: :meth:`read` returns what it holds now."""

    def __init__(self, read: Callable[[], Mapping[str, Any]], write: Callable[[Any], None] | None = None) -> None:
        """Read with a function, and write with another one if the message can be written."""
        self._read, self._write = read, write

    def write(self, payload: object, *_: object) -> None:
        """Write a payload; TypeError for a message that follows from the simulation."""
        if self._write is None:
            raise TypeError(f"this message follows from the simulation and cannot be written; {COMPONENT}")
        self._write(payload)

    def read(self) -> Any:
        """Return the present payload, with the names of Basilisk's."""
        return Payload(**self._read())


class Module(NamedTuple):
    """A module of Basilisk: its attributes by name, as functions of a dynamics model, and what the model must have."""

    attributes: Mapping[str, Callable[[View], object]]
    needs: str = "r_BN_N"


class ModuleView:
    """A module of one satellite."""

    def __init__(self, dynamics: View, attributes: Mapping[str, Callable[[View], Any]]) -> None:
        """View a module of a dynamics model."""
        self.__dict__["_dynamics"], self.__dict__["_attributes"] = dynamics, attributes

    def __getattr__(self, name: str) -> Any:
        attributes = self.__dict__["_attributes"]
        if name not in attributes:
            raise AttributeError(
                f"{name!r} of a module of Basilisk's cannot be read here; known are {sorted(attributes)}. {COMPONENT}"
            )
        return attributes[name](self.__dict__["_dynamics"])

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{name!r} of a module of Basilisk's cannot be set: give it in sat_args, or {COMPONENT}")


def _argument(name: str) -> Callable[[View], object]:
    return lambda dynamics: dynamics.satellite.sat_args[name]


def _states(*names: str) -> Callable[[View], Message]:
    return lambda dynamics: Message(lambda: {name: getattr(dynamics, name) for name in names})


def _battery(dynamics: View) -> Message:
    capacity = float(dynamics.satellite.sat_args["batteryStorageCapacity"])

    def write(payload: Any) -> None:
        dynamics.satellite.fsw._write("charge", float(payload.storageLevel))

    return Message(lambda: {"storageLevel": dynamics.battery_charge, "storageCapacity": capacity}, write)


def _store(dynamics: View) -> Message:
    def read() -> dict[str, object]:
        levels, args = [float(x) for x in dynamics.partition_levels], dynamics.satellite.sat_args
        buffers = args.get("bufferNames", [WHOLE_STORE])  # None for numbered partitions
        names = list(buffers) if buffers is not None else [str(k) for k in range(len(levels))]
        return {
            "storageLevel": dynamics.storage_level,
            "storageCapacity": args["dataStorageCapacity"],
            "storedData": levels,
            "storedDataName": names,
        }

    return Message(read)


def _wheels(dynamics: View) -> Message:
    def read() -> dict[str, object]:
        speeds = dynamics.wheel_speeds.tolist()
        return {"wheelSpeeds": speeds + [0.0] * (WHEELS - len(speeds))}

    return Message(read)


MODULES: dict[str, Module] = {
    "scObject": Module(
        {"scStateOutMsg": _states("r_BN_N", "v_BN_N", "sigma_BN", "omega_BN_B"), "ModelTag": lambda d: d.satellite.name}
    ),
    "simpleNavObject": Module({"transOutMsg": _states("r_BN_N", "v_BN_N"), "attOutMsg": _states("sigma_BN", "omega_BN_B")}),
    "powerMonitor": Module(
        {"batPowerOutMsg": _battery, "storageCapacity": _argument("batteryStorageCapacity")}, "battery_charge"
    ),
    "solarPanel": Module({name: _argument(name) for name in ("nHat_B", "panelArea", "panelEfficiency")}, "battery_charge"),
    "rwStateEffector": Module({"rwSpeedOutMsg": _wheels}, "wheel_speeds"),
    "storageUnit": Module(
        {"storageUnitDataOutMsg": _store, "storageCapacity": _argument("dataStorageCapacity")}, "storage_level"
    ),
    "instrument": Module({"nodeBaudRate": _argument("instrumentBaudRate")}, "storage_level"),
    "transmitter": Module({"nodeBaudRate": _argument("transmitterBaudRate")}, "storage_level"),
}
"""Modules of a satellite's dynamics by name."""


AT_REST = (0.0, 0.0, 0.0)
"""Position, m, and velocity, m/s, of the Earth in N."""


def gravity_factory(world: View) -> SimpleNamespace:
    """Return Basilisk's ``gravFactory``: ``spiceObject.planetStateOutMsgs`` of the Sun and of the Earth, m and m/s in N."""

    def planet(name: str, r: list[float], v: list[float], turn: np.ndarray) -> dict[str, object]:
        return {"PositionVector": r, "VelocityVector": v, "J20002Pfix": turn.tolist(), "PlanetName": name}

    sun = Message(lambda: planet("sun", world.r_SN_N.tolist(), world.v_SN_N.tolist(), np.eye(3)))
    earth = Message(lambda: planet("earth", list(AT_REST), list(AT_REST), world.PN))
    return SimpleNamespace(spiceObject=SimpleNamespace(planetStateOutMsgs=[sun, earth]))


def ephemerides(world: View) -> SimpleNamespace:
    """Return Basilisk's ``ephemConverter``: ``ephemOutMsgs`` of the Sun and of the Earth, m and m/s in N."""
    sun = Message(lambda: {"r_BdyZero_N": world.r_SN_N.tolist(), "v_BdyZero_N": world.v_SN_N.tolist()})
    return SimpleNamespace(ephemOutMsgs=[sun, Message(lambda: {"r_BdyZero_N": list(AT_REST), "v_BdyZero_N": list(AT_REST)})])


def eclipses(world: View) -> SimpleNamespace:
    """Return Basilisk's ``eclipseObject``: ``eclipseOutMsgs`` of all satellites, with ``shadowFactor``, 1 in full sunlight."""

    def message(part: int, row: int) -> Message:
        def read() -> dict[str, float]:
            light = float(world.simulator.fleet.simulators[part].read("illumination")[row])
            return {"shadowFactor": light, "illuminationFactor": light}

        return Message(read)

    return SimpleNamespace(eclipseOutMsgs=[message(*satellite.core_row) for satellite in world.simulator.satellites])
