"""The ``setup_...`` methods of users' models, which change arguments of an episode before its simulation begins.

bsk_rl's models make Basilisk's modules in these methods. Here a :class:`Setup` stands for the model while they run: methods of
the package keep the arguments that they are called with, and settings of modules that the package has are arguments, too.
Modules that a method makes itself, if Basilisk is installed, are read where the package simulates them: an exponential
atmosphere, and reaction wheels. Anything else raises :class:`NotSimulatedError`.
"""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from bsk_torch.bsk_rl.sim.messages import COMPONENT
from bsk_torch.bsk_rl.sim.models import SETUP, Task, classes_of_users
from bsk_torch.sim.dyn import Wheel
from bsk_torch.sim.dyn.effectors.wheel_set import EACH

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from bsk_torch.bsk_rl.sats.satellite import Satellite


class NotSimulatedError(NotImplementedError):
    """A model that adds a part that the package does not simulate."""


def _array(value: ArrayLike) -> np.ndarray:
    return np.asarray(value, dtype=float)


RENAMED: dict[str, dict[str, tuple[str, Callable[[Any], object]]]] = {
    "hub": {
        "mHub": ("mass", float),
        "IHubPntBc_B": ("inertia", lambda value: _array(value).reshape(3, 3).tolist()),
        "sigma_BNInit": ("sigma_init", lambda value: _array(value).ravel().tolist()),
        "omega_BN_BInit": ("omega_init", lambda value: _array(value).ravel().tolist()),
    },
    "densityModel": {name: (name, float) for name in ("planetRadius", "baseDensity", "scaleHeight")},
    "powerMonitor": {"storageCapacity": ("batteryStorageCapacity", float), "storedCharge_Init": ("storedCharge_Init", float)},
    "instrument": {"nodeBaudRate": ("instrumentBaudRate", float)},
    "transmitter": {"nodeBaudRate": ("transmitterBaudRate", lambda value: -abs(value))},
    "instrumentPowerSink": {"nodePowerOut": ("instrumentPowerDraw", float)},
    "transmitterPowerSink": {"nodePowerOut": ("transmitterPowerDraw", float)},
    "thrusterPowerSink": {"nodePowerOut": ("thrusterPowerDraw", float)},
    "basePowerSink": {"nodePowerOut": ("basePowerDraw", float)},
    "storageUnit": {"storageCapacity": ("dataStorageCapacity", float)},
    "imagingTarget": {
        "minimumElevation": ("imageTargetMinimumElevation", float),
        "maximumRange": ("imageTargetMaximumRange", float),
    },
    "locPoint": {"pHat_B": ("inst_pHat_B", list)},
    "insControl": {
        "attErrTolerance": ("imageAttErrorRequirement", float),
        "rateErrTolerance": ("imageRateErrorRequirement", float),
    },
    "mrpFeedbackControl": {name: (name, float) for name in ("K", "Ki", "P", "integralLimit")},
    "mrpSteeringControl": {name: (name, float) for name in ("K1", "K3", "omega_max")},
    "servo": {"Ki": ("servo_Ki", float), "P": ("servo_P", float), "integralLimit": ("integralLimit", float)},
    "thrDesatControl": {"hs_min": ("hs_min", float)},
    "thrDump": {"maxCounterValue": ("maxCounterValue", int), "thrMinFireTime": ("thrMinFireTime", float)},
}
"""Settings of Basilisk's modules by the models' names of these: the arguments that they are, and how values are converted."""


class Part:
    """A module of the package while a model is set up: its settings are arguments."""

    def __init__(self, name: str, args: dict[str, object]) -> None:
        self.__dict__.update(_name=name, _args=args)

    def __setattr__(self, name: str, value: object) -> None:
        if name == "ModelTag":
            return
        settings = RENAMED.get(self._name, {})
        if name not in settings or settings[name][0] not in self._args | {"inertia": None, "integralLimit": None}:
            raise NotSimulatedError(
                f"{self._name}.{name} of Basilisk's cannot be set here; {sorted(settings)} can be, as can all of sat_args and "
                f"world_args. {COMPONENT}"
            )
        argument, convert = settings[name]
        self._args[argument] = convert(value)

    def __getattr__(self, name: str) -> Any:
        settings = self.__dict__.get("_args", {}), RENAMED.get(self.__dict__.get("_name", ""), {})
        if name in settings[1]:
            return settings[0][settings[1][name][0]]
        raise NotSimulatedError(f"{self._name}.{name} of Basilisk's cannot be read while a model is set up; {COMPONENT}")


class Spacecraft(Part):
    """The spacecraft while a model is set up; effectors of the package's kinds are read by :class:`Setup`."""

    def __init__(self, args: dict[str, object]) -> None:
        super().__init__("scObject", args)
        self.__dict__["hub"] = Part("hub", args)
        self.__dict__["scStateOutMsg"] = _message("SCStatesMsg")

    def addStateEffector(self, effector: object) -> None:
        """Accept an effector, whose numbers :class:`Setup` reads from its factory."""
        self.__dict__.setdefault("effectors", []).append(effector)


def _message(kind: str) -> Any:
    """Return an empty message of Basilisk's, for its modules that subscribe to it; None where Basilisk is not loaded."""
    messaging = sys.modules.get("Basilisk.architecture.messaging")
    return None if messaging is None else getattr(messaging, kind)()


def _of_basilisk(value: object) -> bool:
    return type(value).__module__.split(".")[0] == "Basilisk"


# -- modules that are read -------------------------------------------------------------------------------------------------------


def _atmosphere(module: object, args: Mapping[str, object]) -> dict[str, object]:
    return {name: float(getattr(module, name)) for name in ("planetRadius", "baseDensity", "scaleHeight")}


def _wheels(factory: Any, args: Mapping[str, object]) -> dict[str, object]:
    """Return the arguments of the wheels that a factory has made."""
    listed, to_rpm = list(factory.rwList.values()), 30.0 / math.pi
    if any(int(wheel.RWModel) != 0 for wheel in listed):
        raise NotSimulatedError("wheels with imbalance or jitter (RWModel) are not simulated; make them balanced")
    numbers: list[dict[str, Any]] = [
        {name: float(getattr(wheel, name)) for name in ("Js", "u_max", "u_min", *FRICTION)} for wheel in listed
    ]
    described = [
        Wheel(
            "custom",
            _array(wheel.gsHat_B).ravel().tolist(),
            Omega_max=max(float(wheel.Omega_max) * to_rpm, 1.0),  # rwOmegaMax replaces it
            **given,
        )
        for wheel, given in zip(listed, numbers, strict=True)
    ]
    each = {name: [args[name]] * len(listed) for name in EACH if isinstance(args.get(name), int | float)}
    return {
        **each,
        "wheels": described,
        "u_max": [float(wheel.u_max) for wheel in listed],
        "rwOmegaMax": [float(wheel.Omega_max) * to_rpm for wheel in listed],
        "wheelSpeeds": [float(wheel.Omega) * to_rpm for wheel in listed],
    }


FRICTION = ("P_max", "fCoulomb", "fStatic", "betaStatic", "cViscous")

READ: dict[str, Callable[[Any, Mapping[str, object]], dict[str, object]]] = {
    "ExponentialAtmosphere": _atmosphere,
    "rwFactory": _wheels,
}
"""Modules of Basilisk by class, and functions that return the arguments that they stand for."""

IGNORED = ("ReactionWheelStateEffector",)
"""Modules whose numbers are those of another one of the table."""


class Setup:
    """Stands for a model of an episode while its ``setup_...`` methods run."""

    def __init__(self, model: type, args: Mapping[str, object], satellite: object = None, fsw: object = None) -> None:
        added = list[object]()
        simulator = SimpleNamespace(satellites=[], AddModelToTask=lambda task, module, ModelPriority=-1: added.append(module))
        self.__dict__.update(_model=model, _args=dict(args), _parts={}, _done=set(), _complete=False, _added=added)
        self.__dict__.update(satellite=satellite, world=None, fsw=fsw, simulator=simulator)
        self.__dict__.update(task_name="DynamicsTask", world_task_name="WorldTask", sun_index=0, body_index=1)

    @property  # type: ignore[misc]
    def __class__(self) -> Any:
        """The class of the model, which ``super()`` in its methods needs."""
        return self.__dict__["_model"]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        parts, args = self.__dict__["_parts"], self.__dict__["_args"]
        if name == "scObject":
            return parts.setdefault(name, Spacecraft(args))
        if name == "gravFactory":
            messages = [_message("SpicePlanetStateMsg") for _ in range(2)]
            return parts.setdefault(name, SimpleNamespace(spiceObject=SimpleNamespace(planetStateOutMsgs=messages)))
        if name in RENAMED:
            return parts.setdefault(name, Part(name, args))
        member = inspect.getattr_static(self.__dict__["_model"], name, None)
        if inspect.isfunction(member):
            return member.__get__(self)
        if name in args:
            return args[name]
        raise NotSimulatedError(
            f"{self.__dict__['_model'].__name__}: {name!r} cannot be read while the model is set up; {COMPONENT}"
        )

    def __setattr__(self, name: str, value: object) -> None:
        if name in self._args and not _of_basilisk(value):
            self._args[name] = value
        self.__dict__[name] = value

    # -- called by methods of the package, see :mod:`bsk_torch.bsk_rl.sim.models` --------------------------------------

    def _take(self, method: str, names: tuple[str, ...], kwargs: Mapping[str, object]) -> None:
        self._done.add(method)
        self._args.update({name: kwargs[name] for name in names if name in kwargs})

    def _set_up_all(self, kwargs: Mapping[str, object]) -> None:
        """Run the ``setup_...`` methods; NotSimulatedError for one that leaves out what the package's sets up."""
        for name in sorted(name for name in dir(self._model) if name.startswith("setup_")):
            before = len(self._read())
            getattr(self, name)(**kwargs)
            if name not in self._done and len(self._read()) == before:
                raise NotSimulatedError(
                    f"{self._model.__name__}.{name} neither calls super().{name}(**kwargs) nor makes one of {sorted(READ)}, so "
                    f"that a part would be left out or be another one, which is not simulated here. {COMPONENT}"
                )
        self.__dict__["_complete"] = True

    def _read(self) -> list[object]:
        return [value for value in vars(self).values() if type(value).__name__ in READ]

    def _run(self, method: str, args: Mapping[str, object]) -> None:
        if method == "_set_up_all":
            self._set_up_all(args)
            return
        getattr(self, method)(**args)
        if not self._complete:
            raise NotSimulatedError(
                f"{self._model.__name__}.{method} must call super().{method}(**kwargs): parts cannot be left out. {COMPONENT}"
            )

    def _finish(self, before: Mapping[str, object]) -> dict[str, object]:
        """Return the arguments that have changed; NotSimulatedError for modules that are not simulated."""
        made = self._read()
        for module in made:
            self._args.update(READ[type(module).__name__](module, self._args))
        for module in self._added:
            if (kind := type(module).__name__) not in (*READ, *IGNORED):
                raise NotSimulatedError(
                    f"{self._model.__name__} adds {kind}, which is not simulated here; of Basilisk's modules, {sorted(READ)} are "
                    f"read. {COMPONENT}"
                )
        return {name: value for name, value in self._args.items() if name not in before or value is not before[name]}


def changed_arguments(model: type, args: Mapping[str, object], satellite: Satellite | None = None) -> dict[str, object]:
    """Run the ``setup_...`` methods of a user's model of a satellite, or of the world; return the arguments that they change.

    NotSimulatedError for a method that adds a part that is not simulated.
    """
    definitions = (item for owner in classes_of_users(model) for item in vars(owner).items())
    if not any(
        name.startswith(("setup_", "_setup_")) or (inspect.isclass(value) and issubclass(value, Task))
        for name, value in definitions
    ):
        return {}
    whole = Setup(model, args, satellite)
    run = next((name for name in SETUP if hasattr(model, name)), "_set_up_all")
    whole._run(run, args)
    changed = whole._finish(args)
    tasks = (getattr(model, name) for name in dir(model) if name.endswith("Task"))
    for task in (task for task in tasks if classes_of_users(task)):
        made = Setup(task, args, satellite, fsw=whole)
        made._set_up_all(args)
        changed |= made._finish(args)
    if "inertia" in changed and satellite is not None:
        satellite.logger.warning(
            "%s sets the inertia of the hub: the flight software knows it here; in bsk_rl, it takes that of the box for true, so "
            "that attitudes differ slightly",
            model.__name__,
        )
    return changed
