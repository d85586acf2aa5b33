"""The modules and messages of Basilisk that programs of bsk_rl usually read, answered from the simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sim.views import DynamicsView, WorldView

COMPONENT = (
    "parts of a spacecraft are components here: write a Component and list it in components= of a model "
    "(docs/how_to/own_component.md), and read its fields by a property of the model"
)

ABSENT = [
    "faultList",
    "fsw_proc",
    "dyn_proc",
    "tasks",
    "processName",
    "rwFactory",
    "thrusterSet",
    "rwNullSpace",
    "rwConstellationConfigInMsg",
    "rwMotorTorque",
    "mrpFeedbackControl",
    "mrpSteeringControl",
    "servo",
    "sunPoint",
    "hillPoint",
    "trackingError",
    "thrForceMapping",
    "thrDump",
    "momentumDump",
    "thrusterDump",
    "extForceTorqueObject",
    "dragEffector",
    "densityModel",
    "wheelSinkList",
    "powerSinkList",
    "AddModelToTask",
    "CreateNewTask",
    "CreateNewProcess",
    "enableTask",
    "disableTask",
    "Gs",
    "vcConfigMsg",
    "attRefMsg",
]
"""Attributes of Basilisk's objects that there are no counterparts of."""


KEPT = (
    "maxWheelSpeed",
    "conjunction_radius",
    "max_range_radius",
    "chief_name",
    "storageUnitValidCheck",
    "desatAttitude",
    "mu",
    "min_orbital_radius",
    "groundLocationPlanetRadius",
    "gsMinimumElevation",
    "gsMaximumRange",
)
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
        """Raise AttributeError, with advice, for a number that is not imitated."""
        if name.startswith("__"):
            raise AttributeError(name)
        raise AttributeError(
            f"{name!r} of a message of Basilisk's cannot be read here; known are {sorted(vars(self))}. {COMPONENT}"
        )


class Message:
    """A message: :meth:`read` returns what it holds now."""

    def __init__(self, read: Callable[[], Mapping[str, Any]], write: Callable[[Any], None] | None = None) -> None:
        """Read with a function, and write with another one if the message can be written."""
        self._read, self._write = read, write

    def write(self, payload: Any, *_: Any) -> None:
        """Write a payload; TypeError for a message that follows from the simulation."""
        if self._write is None:
            raise TypeError(f"this message follows from the simulation and cannot be written; {COMPONENT}")
        self._write(payload)

    def read(self) -> Any:
        """Return the present payload, with the names of Basilisk's."""
        return Payload(**self._read())


class Module(NamedTuple):
    """A module of Basilisk: its attributes by name, as functions of a dynamics model, and what the model must have."""

    attributes: Mapping[str, Callable[[DynamicsView], Any]]
    needs: str = "r_BN_N"

    def exists(self, dynamics: DynamicsView) -> bool:
        """Return whether the model has what the module is about."""
        return hasattr(type(dynamics._whole), self.needs)

    def __call__(self, dynamics: DynamicsView) -> Any:
        """Return the module of a satellite."""
        return ModuleView(dynamics, self.attributes)


class ModuleView:
    """A module of one satellite."""

    def __init__(self, dynamics: DynamicsView, attributes: Mapping[str, Callable[[DynamicsView], Any]]) -> None:
        """View a module of a dynamics model."""
        self.__dict__["_dynamics"], self.__dict__["_attributes"] = dynamics, attributes

    def __getattr__(self, name: str) -> Any:
        """Return an attribute; AttributeError, with advice, for one that is not imitated."""
        attributes = self.__dict__["_attributes"]
        if name not in attributes:
            raise AttributeError(
                f"{name!r} of a module of Basilisk's cannot be read here; known are {sorted(attributes)}. {COMPONENT}"
            )
        return attributes[name](self.__dict__["_dynamics"])

    def __setattr__(self, name: str, value: object) -> None:
        """Raise AttributeError: modules are imitated to be read."""
        raise AttributeError(f"{name!r} of a module of Basilisk's cannot be set: give it in sat_args, or {COMPONENT}")


def _argument(name: str) -> Callable[[DynamicsView], Any]:
    return lambda dynamics: dynamics.satellite.sat_args[name]


def _states(*names: str) -> Callable[[DynamicsView], Message]:
    return lambda dynamics: Message(lambda: {name: getattr(dynamics, name) for name in names})


def _battery(dynamics: DynamicsView) -> Message:
    capacity = float(dynamics.satellite.sat_args["batteryStorageCapacity"])

    def write(payload: Any) -> None:
        dynamics.satellite.fsw._write("charge", float(payload.storageLevel))

    return Message(lambda: {"storageLevel": dynamics.battery_charge, "storageCapacity": capacity}, write)


def _store(dynamics: DynamicsView) -> Message:
    def read() -> dict[str, Any]:
        levels, args = [float(x) for x in dynamics.partition_levels], dynamics.satellite.sat_args
        given = args.get("bufferNames", [WHOLE_STORE])  # None for numbered partitions
        names = list(given) if given is not None else [str(k) for k in range(len(levels))]
        return {
            "storageLevel": dynamics.storage_level,
            "storageCapacity": args["dataStorageCapacity"],
            "storedData": levels,
            "storedDataName": names,
        }

    return Message(read)


def _wheels(dynamics: DynamicsView) -> Message:
    def read() -> dict[str, Any]:
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
    "solarPanel": Module(
        {
            name: _argument(argument)
            for name, argument in (("nHat_B", "nHat_B"), ("panelArea", "panelArea"), ("panelEfficiency", "panelEfficiency"))
        },
        "battery_charge",
    ),
    "rwStateEffector": Module({"rwSpeedOutMsg": _wheels}, "wheel_speeds"),
    "storageUnit": Module(
        {"storageUnitDataOutMsg": _store, "storageCapacity": _argument("dataStorageCapacity")}, "storage_level"
    ),
    "instrument": Module({"nodeBaudRate": _argument("instrumentBaudRate")}, "storage_level"),
    "transmitter": Module({"nodeBaudRate": _argument("transmitterBaudRate")}, "storage_level"),
}
"""Modules of a satellite's dynamics by name."""


class PlanetState(NamedTuple):
    """State of a body, as Basilisk's ``spiceObject`` writes it."""

    PositionVector: Any
    VelocityVector: Any
    J20002Pfix: Any
    PlanetName: str


class GravityFactory:
    """Basilisk's ``gravFactory``: ``spiceObject.planetStateOutMsgs[world.sun_index].read().PositionVector``, m in N."""

    def __init__(self, world: WorldView) -> None:
        """Read a world."""
        self.world = world

    @property
    def spiceObject(self) -> GravityFactory:
        """The module with the messages."""
        return self

    @property
    def planetStateOutMsgs(self) -> list[Message]:
        """Messages of the Sun and of the Earth, which is at rest at the origin."""
        return [Message(self._sun), Message(self._earth)]

    def _sun(self) -> dict[str, Any]:
        r, v = self.world.r_SN_N.tolist(), self.world.v_SN_N.tolist()
        return PlanetState(r, v, np.eye(3).tolist(), "sun")._asdict()

    def _earth(self) -> dict[str, Any]:
        return PlanetState([0.0] * 3, [0.0] * 3, self.world.PN.tolist(), "earth")._asdict()


class Ephemerides:
    """Basilisk's ``ephemConverter``: ``ephemOutMsgs[world.sun_index].read().r_BdyZero_N``, m in N."""

    def __init__(self, world: WorldView) -> None:
        """Read a world."""
        self.world = world

    @property
    def ephemOutMsgs(self) -> list[Message]:
        """Messages of the Sun and of the Earth."""
        sun = Message(lambda: {"r_BdyZero_N": self.world.r_SN_N.tolist(), "v_BdyZero_N": self.world.v_SN_N.tolist()})
        return [sun, Message(lambda: {"r_BdyZero_N": [0.0] * 3, "v_BdyZero_N": [0.0] * 3})]


class Eclipses:
    """Basilisk's ``eclipseObject``: ``eclipseOutMsgs[dynamics.eclipse_index].read().shadowFactor``, 1 in full sunlight."""

    def __init__(self, world: WorldView) -> None:
        """Read a world."""
        self.world = world

    @property
    def eclipseOutMsgs(self) -> list[Message]:
        """Messages of all satellites in their order."""
        return [self._of(*satellite.core_row) for satellite in self.world.simulator.satellites]

    def _of(self, part: int, row: int) -> Message:
        def read() -> dict[str, float]:
            light = float(self.world.simulator.fleet.simulators[part].read("illumination")[row])
            return {"shadowFactor": light, "illuminationFactor": light}

        return Message(read)
