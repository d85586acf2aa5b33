"""The modules and messages of Basilisk that programs of bsk_rl usually read, answered from the simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch

from bsk_torch.astro.ephemeris import sun_state
from bsk_torch.constants import AU, MU_EARTH, MU_SUN, R_EARTH, R_SUN, SOLAR_FLUX
from bsk_torch.sim.dyn.hub import BODY, box_inertia
from bsk_torch.sim.fsw.models import BasicFSWModel, FSWModel, ImagingFSWModel, SteeringFSWModel

COMPONENT = (
    "parts of a spacecraft are components here: write a Component and list it in components= of a model "
    "(docs/how_to/own_component.md), and read its fields by a property of the model"
)

ABSENT = (
    "faultList", "fsw_proc", "dyn_proc", "tasks", "processName", "rwFactory", "rwPowerList", "thrusterSet", "thrFactory",
    "rwNullSpace", "thrForceMapping", "extForceTorqueObject", "dragEffector", "wheelSinkList", "powerSinkList", "Gs",
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


def unreadable(name: str, what: str, readable: Iterable[str]) -> str:
    """Return the text of the error for an attribute of a module or message that cannot be read."""
    return f"{name!r} of {what} of Basilisk's cannot be read here; known are {sorted(readable)}. {COMPONENT}"


class Payload(SimpleNamespace):
    """What a message holds; ``_later`` are functions of what takes long to compute."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if name in (later := vars(self).get("_later", {})):
            value = self.__dict__[name] = later[name]()
            return value
        raise AttributeError(unreadable(name, "a message", vars(self)))


class View(Protocol):
    """A dynamics model, or the world, whose quantities modules and messages read by name."""

    def __getattr__(self, name: str) -> Any: ...


class Message:
    """A message: :meth:`read` returns what it holds now."""

    def __init__(self, read: Callable[[], Mapping[str, object]], write: Callable[[Any], None] | None = None) -> None:
        self._read, self._write = read, write

    def write(self, payload: object, *_: object) -> None:
        """Write a payload; TypeError for a message that follows from the simulation."""
        if self._write is None:
            raise TypeError(f"this message follows from the simulation and cannot be written; {COMPONENT}")
        self._write(payload)

    def read(self) -> Any:
        """Return the present payload, with the names of Basilisk's."""
        return Payload(**self._read())

    def recorder(self, minUpdateTime: int = 0) -> Recorder:
        """Return what keeps the payload of every tick, at least ``minUpdateTime`` ns apart; add it by ``AddModelToTask``."""
        return Recorder(self, minUpdateTime)


class Recorder:
    """Keeps the payloads of a message from when it is added to a task; the fields of the payload are arrays [T, ...]."""

    def __init__(self, message: Message, minUpdateTime: int) -> None:
        self._message, self._every = message, minUpdateTime
        self._times: list[int] = []
        self._payloads: list[Any] = []

    def record(self, nanoseconds: int) -> None:
        """Keep the payload of now, unless the last one is not old enough."""
        if not self._times or nanoseconds >= self._times[-1] + max(self._every, 1):
            self._times.append(nanoseconds)
            self._payloads.append(self._message.read())

    def times(self) -> np.ndarray:
        """Return the times of the payloads, ns."""
        return np.array(self._times, dtype=np.int64)

    timesWritten = times

    def clear(self) -> None:
        """Forget what has been recorded."""
        self._times, self._payloads = [], []

    def __getattr__(self, name: str) -> np.ndarray:
        if name.startswith("_"):
            raise AttributeError(name)
        return np.array([getattr(payload, name) for payload in self._payloads])


class Module(NamedTuple):
    """A module of Basilisk: its attributes by name, as functions of a dynamics model, and what the model must have."""

    attributes: Mapping[str, Callable[[View], object]]
    needs: str = "r_BN_N"


def read_of(view: object, attributes: Mapping[str, Callable[[Any], object]], name: str) -> Any:
    """Return an attribute of a module of a model; AttributeError with advice for one that cannot be read."""
    if name not in attributes:
        raise AttributeError(unreadable(name, "a module", attributes))
    return attributes[name](view)


def _argument(name: str) -> Callable[[View], object]:
    return lambda dynamics: dynamics.satellite.model_args[name]


def _states(*names: str) -> Callable[[View], Message]:
    return lambda dynamics: Message(lambda: {name: getattr(dynamics, name) for name in names})


def _battery(dynamics: View) -> Message:
    capacity = float(dynamics.satellite.model_args["batteryStorageCapacity"])

    def write(payload: Any) -> None:
        dynamics.satellite.fsw._write("charge", float(payload.storageLevel))

    return Message(lambda: {"storageLevel": dynamics.battery_charge, "storageCapacity": capacity}, write)


def _store(dynamics: View) -> Message:
    def read() -> dict[str, object]:
        levels, args = [float(x) for x in dynamics.partition_levels], dynamics.satellite.model_args
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


def inertia(dynamics: View) -> np.ndarray:
    """Return the inertia of the hub about its center of mass, [3, 3] kg m^2 in B; of a box as in bsk_rl unless it is given."""
    args = dynamics.satellite.model_args
    if args.get("inertia") is not None:
        return np.array(args["inertia"], dtype=float)
    return np.diag(box_inertia(*(torch.tensor(args[name], dtype=torch.float64) for name in BODY)).numpy())


def _hub(dynamics: View) -> SimpleNamespace:
    args, tensor = dynamics.satellite.model_args, inertia(dynamics)
    return SimpleNamespace(mHub=args["mass"], IHubPntBc_B=tensor.tolist(), r_BcB_B=[0.0, 0.0, 0.0])


def _panel_power(dynamics: View) -> Message:
    """Return the power of the solar panel, W; see :func:`bsk_torch.sim.dyn.power.panels.collect_sunlight`."""

    def read() -> dict[str, object]:
        args, r_BN_N = dynamics.satellite.model_args, np.array(dynamics.r_BN_N)
        r_SB_N, normal = dynamics.world.r_SN_N - r_BN_N, np.array(args["nHat_B"], dtype=float)
        distance = np.linalg.norm(r_SB_N)
        cosine = max(float(normal / np.linalg.norm(normal) @ (np.array(dynamics.BN) @ r_SB_N)) / distance, 0.0)
        light = dynamics.world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].read().illuminationFactor
        area = float(args["panelArea"]) * float(args["panelEfficiency"])
        return {"netPower": SOLAR_FLUX * (AU / distance) ** 2 * area * light * cosine}

    return Message(read)


def _sink(name: str, flag: str | None) -> Module:
    """Return a device that draws the power of an argument, W, while a flag of the mode is set."""

    def status(dynamics: View) -> int:
        return int(flag is None or flag in dynamics.satellite.fsw.flags_on)

    def power(dynamics: View) -> float:
        return float(dynamics.satellite.model_args[name])

    def message(dynamics: View) -> Message:
        return Message(lambda: {"netPower": power(dynamics) * status(dynamics)})

    return Module({"nodePowerOut": power, "powerStatus": status, "nodePowerOutMsg": message}, "battery_charge")


MODULES: dict[str, Module] = {
    "scObject": Module(
        {
            "scStateOutMsg": _states("r_BN_N", "v_BN_N", "sigma_BN", "omega_BN_B"),
            "ModelTag": lambda d: d.satellite.name,
            "hub": _hub,
        }
    ),
    "basePowerSink": _sink("basePowerDraw", None),
    "instrumentPowerSink": _sink("instrumentPowerDraw", "instrument_power")._replace(needs="storage_level"),
    "transmitterPowerSink": _sink("transmitterPowerDraw", "transmitter_on")._replace(needs="storage_level"),
    "thrusterPowerSink": _sink("thrusterPowerDraw", "thruster_power"),
    "imagingTarget": Module(
        {
            "r_LP_P_Init": lambda d: d.satellite.fsw.field("r_LP_P").tolist(),
            "minimumElevation": _argument("imageTargetMinimumElevation"),
            "maximumRange": _argument("imageTargetMaximumRange"),
        },
        "storage_level",
    ),
    "simpleNavObject": Module({"transOutMsg": _states("r_BN_N", "v_BN_N"), "attOutMsg": _states("sigma_BN", "omega_BN_B")}),
    "powerMonitor": Module(
        {"batPowerOutMsg": _battery, "storageCapacity": _argument("batteryStorageCapacity")}, "battery_charge"
    ),
    "solarPanel": Module(
        {"nodePowerOutMsg": _panel_power, **{name: _argument(name) for name in ("nHat_B", "panelArea", "panelEfficiency")}},
        "battery_charge",
    ),
    "rwStateEffector": Module({"rwSpeedOutMsg": _wheels}, "wheel_speeds"),
    "storageUnit": Module(
        {"storageUnitDataOutMsg": _store, "storageCapacity": _argument("dataStorageCapacity")}, "storage_level"
    ),
    "instrument": Module({"nodeBaudRate": _argument("instrumentBaudRate")}, "storage_level"),
    "transmitter": Module(
        {
            "nodeBaudRate": _argument("transmitterBaudRate"),
            "dataStatus": lambda d: int("transmitter_on" in d.satellite.fsw.flags_on),
        },
        "storage_level",
    ),
}
"""Modules of a satellite's dynamics by name."""


# -- flight software -------------------------------------------------------------------------------------------------------------


def _guidance(fsw: View) -> Message:
    """Return the attitude error of the last tick; of guidance that points an axis, rates are not kept by the simulation."""

    def read() -> dict[str, object]:
        from bsk_torch.bsk_rl.basilisk.utilities.RigidBodyKinematics import subMRP  # which imports SciPy

        on, dynamics = fsw.flags_on, fsw.dynamics
        for law in ("sun", "location"):
            if f"{law}_on" in on:
                return {"sigma_BR": fsw.field(f"{law}_sigma_BR").tolist()}
        sigma_RN, omega_RN_N = _hill_reference(dynamics) if "nadir_on" in on else (np.zeros(3), np.zeros(3))
        omega_RN_B = np.array(dynamics.BN) @ omega_RN_N
        return {
            "sigma_BR": subMRP(dynamics.sigma_BN, sigma_RN).tolist(),
            "omega_BR_B": (np.array(dynamics.omega_BN_B) - omega_RN_B).tolist(),
            "omega_RN_B": omega_RN_B.tolist(),
        }

    return Message(read)


def _hill_reference(dynamics: View) -> tuple[np.ndarray, np.ndarray]:
    """Return the attitude of the Hill frame, an MRP, and its rate, rad/s in N."""
    from bsk_torch.bsk_rl.basilisk.utilities.RigidBodyKinematics import C2MRP  # likewise

    r, v, HN = np.array(dynamics.r_BN_N), np.array(dynamics.v_BN_N), np.array(dynamics.HN)
    return np.array(C2MRP(HN)), HN[2] * np.linalg.norm(np.cross(r, v)) / (r @ r)


def _reference(fsw: View) -> Message:
    """Return the attitude of the reference; see :func:`_guidance`. Writing it commands an attitude set-point."""

    def read() -> dict[str, object]:
        from bsk_torch.bsk_rl.basilisk.utilities.RigidBodyKinematics import addMRP  # likewise

        guidance = _guidance(fsw).read()
        sigma_RN = addMRP(np.array(fsw.dynamics.sigma_BN), -np.array(guidance.sigma_BR))
        rates = {}
        if hasattr(guidance, "omega_RN_B"):
            rates = {"omega_RN_N": (np.array(fsw.dynamics.BN).T @ np.array(guidance.omega_RN_B)).tolist()}
        return {"sigma_RN": np.array(sigma_RN).tolist(), **rates}

    return Message(read, lambda payload: fsw.action_attitude_mrp(payload.sigma_RN))


def _motor_torques(fsw: View) -> Message:
    def read() -> dict[str, object]:
        torques = fsw.field("motor_torque_command_B").tolist()
        return {"motorTorque": torques + [0.0] * (WHEELS - len(torques))}

    return Message(read)


def _arguments(**names: str) -> dict[str, Callable[[View], object]]:
    return {attribute: _argument(name) for attribute, name in names.items()}


class Software(NamedTuple):
    """A module or message of the flight software: its attributes, or the message, and the model that has it."""

    model: type
    attributes: Mapping[str, Callable[[View], object]] = {}
    message: Callable[[View], Message] | None = None
    without: type = type(None)


FSW_MODULES: dict[str, Software] = {
    "attGuidMsg": Software(FSWModel, message=_guidance),
    "attRefMsg": Software(FSWModel, message=_reference),
    "vcConfigMsg": Software(FSWModel, message=lambda fsw: Message(lambda: {"ISCPntB_B": fsw.dynamics.I_mat})),
    "hillPoint": Software(FSWModel),
    "trackingError": Software(FSWModel, {"attGuidOutMsg": _guidance}),
    "sunPoint": Software(BasicFSWModel, {"pHat_B": lambda fsw: unit(fsw, "nHat_B"), "attGuidOutMsg": _guidance}),
    "locPoint": Software(ImagingFSWModel, {"pHat_B": lambda fsw: unit(fsw, "inst_pHat_B"), "attGuidOutMsg": _guidance}),
    "rwMotorTorque": Software(BasicFSWModel, {"rwMotorTorqueOutMsg": _motor_torques}),
    "mrpFeedbackControl": Software(BasicFSWModel, _arguments(K="K", Ki="Ki", P="P"), None, SteeringFSWModel),
    "mrpSteeringControl": Software(SteeringFSWModel, _arguments(K1="K1", K3="K3", omega_max="omega_max")),
    "servo": Software(SteeringFSWModel, _arguments(Ki="servo_Ki", P="servo_P")),
    "thrDesatControl": Software(BasicFSWModel, _arguments(hs_min="hs_min")),
    "thrDump": Software(BasicFSWModel, _arguments(maxCounterValue="maxCounterValue", thrMinFireTime="thrMinFireTime")),
    "insControl": Software(
        ImagingFSWModel,
        {
            **_arguments(attErrTolerance="imageAttErrorRequirement", rateErrTolerance="imageRateErrorRequirement"),
            "controllerStatus": lambda fsw: int("controller_on" in fsw.flags_on),
            "imaged": lambda fsw: int(fsw.field("image_taken")[0]),
        },
    ),
}
"""Modules and messages of flight software by name."""


def unit(model: View, name: str) -> np.ndarray:
    """Return an argument of a satellite that is a direction, as a unit vector."""
    axis = np.array(model.satellite.model_args[name], dtype=float)
    return axis / np.linalg.norm(axis)


# -- world -----------------------------------------------------------------------------------------------------------------------


AT_REST = (0.0, 0.0, 0.0)
"""Position, m, and velocity, m/s, of the Earth in N."""


BODIES = {"sun": (MU_SUN, R_SUN), "earth": (MU_EARTH, R_EARTH)}
"""Gravitational parameter, m^3/s^2, and equatorial radius, m, of the bodies that attract."""


def _sun_velocity(et: float) -> list[float]:
    """Return the velocity of the Sun relative to the Earth at an ET, m/s in N."""
    velocity: list[float] = sun_state(torch.tensor([et], dtype=torch.float64))[1][0].tolist()
    return velocity


def gravity_factory(world: View) -> SimpleNamespace:
    """Return Basilisk's ``gravFactory``: ``gravBodies`` by name, and ``spiceObject.planetStateOutMsgs`` of Sun and Earth.

    Positions are in m and velocities in m/s, in N.
    """

    def sun() -> dict[str, object]:
        later = {"VelocityVector": partial(_sun_velocity, world.et)}
        return {"PositionVector": world.r_SN_N.tolist(), "J20002Pfix": np.eye(3).tolist(), "PlanetName": "sun", "_later": later}

    def earth() -> dict[str, object]:
        rest = {"PositionVector": list(AT_REST), "VelocityVector": list(AT_REST), "PlanetName": "earth"}
        return {**rest, "J20002Pfix": world.PN.tolist()}

    bodies = {
        name: SimpleNamespace(mu=mu, radEquator=radius, planetName=f"{name}_planet_data", isCentralBody=name == "earth")
        for name, (mu, radius) in BODIES.items()
    }
    return SimpleNamespace(spiceObject=SimpleNamespace(planetStateOutMsgs=[Message(sun), Message(earth)]), gravBodies=bodies)


def ephemerides(world: View) -> SimpleNamespace:
    """Return Basilisk's ``ephemConverter``: ``ephemOutMsgs`` of the Sun and of the Earth, m and m/s in N."""

    def sun() -> dict[str, object]:
        return {"r_BdyZero_N": world.r_SN_N.tolist(), "_later": {"v_BdyZero_N": partial(_sun_velocity, world.et)}}

    return SimpleNamespace(
        ephemOutMsgs=[Message(sun), Message(lambda: {"r_BdyZero_N": list(AT_REST), "v_BdyZero_N": list(AT_REST)})]
    )


def eclipses(world: View) -> SimpleNamespace:
    """Return Basilisk's ``eclipseObject``: ``eclipseOutMsgs`` of all satellites, with ``shadowFactor``, 1 in full sunlight."""

    def message(part: int, row: int) -> Message:
        def read() -> dict[str, float]:
            light = float(world.simulator.fleet.simulators[part].read("illumination")[row])
            return {"shadowFactor": light, "illuminationFactor": light}

        return Message(read)

    return SimpleNamespace(eclipseOutMsgs=[message(*satellite.core_row) for satellite in world.simulator.satellites])
