"""Instruments with their own limits of elevation, range and light in Basilisk, which has one place to image and no light.

The limits of that place change when an action begins. Between it and the instrument's controller, a module in Python withholds
access in the wrong light. Windows are bsk_rl's above the instrument's elevation, cut to where range and light allow an image.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from Basilisk.architecture import messaging, sysModel
from Basilisk.utilities import SimulationBaseClass, macros, simIncludeGravBody
from Basilisk.utilities.supportDataTools.dataFetcher import DataFile, get_path
from bsk_rl import data, sats
from bsk_rl.sim import dyn
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

ELEVATION, REACH = "imageTargetMinimumElevation", "imageTargetMaximumRange"
LEAST_SUN, MOST_SUN = "imageTargetMinimumSunElevation", "imageTargetMaximumSunElevation"
LIMITS = ELEVATION, REACH, LEAST_SUN, MOST_SUN
LONGEST = 40_000.0  # [s] Up to when the Sun is known

Array = NDArray[Any]


def kind_of(name: str, own: dict[str, Any]) -> str:
    """Type of the windows of an instrument that differs from the satellite in the arguments ``own``."""
    return f"target@{name}" if any(limit in own for limit in LIMITS) else "target"


def sine_of_sun(r_SN: Array, r_LN: Array) -> float:
    """Sine of the Sun's elevation at a place on a sphere."""
    away = np.subtract(r_SN, r_LN)
    return float(np.dot(away, r_LN) / np.linalg.norm(away) / np.linalg.norm(r_LN))


def sun_in_earth(utc: str) -> CubicSpline:
    """Position of the Sun in the Earth-fixed frame [m] over time [s], of Basilisk's SpiceInterface."""
    simulation = SimulationBaseClass.SimBaseClass()
    simulation.CreateNewProcess("process").addTask(simulation.CreateNewTask("task", macros.sec2nano(30.0)))
    bodies = simIncludeGravBody.gravBodyFactory()
    bodies.createEarth()
    bodies.createSun()
    spice = bodies.createSpiceInterface(str(get_path(DataFile.EphemerisData.de430).parent), utc)
    spice.zeroBase = "earth"
    logs = [message.recorder() for message in spice.planetStateOutMsgs[:2]]
    for model in (spice, *logs):
        simulation.AddModelToTask("task", model)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(macros.sec2nano(LONGEST))
    simulation.ExecuteSimulation()
    earth, sun = logs
    r_SE_N = sun.PositionVector - earth.PositionVector
    return CubicSpline(earth.times() * macros.NANO2SEC, np.einsum("tij,tj->ti", earth.J20002Pfix, r_SE_N))


class LightGate(sysModel.SysModel):
    """Passes the access to a place on where the Sun's elevation is within ``limits`` [rad]."""

    def __init__(self, place: Any, earth: Any, sun: Any) -> None:
        """Read access and position of a ``place``, and messages of the Earth and the Sun."""
        super().__init__()
        self.ModelTag, self.limits = "LightGate", (-np.pi, np.pi)
        self.access, self.place = place.accessOutMsgs[-1].addSubscriber(), place.currentGroundStateOutMsg.addSubscriber()
        self.earth, self.sun = earth.addSubscriber(), sun.addSubscriber()
        self.passedOutMsg = messaging.AccessMsg()

    def UpdateState(self, now: int) -> None:
        """Called by Basilisk in every tick, after the place."""
        passed, place = self.access(), np.array(self.place().r_LN_N)
        r_SN_N = np.subtract(self.sun().PositionVector, self.earth().PositionVector)
        low, high = np.sin(np.clip(self.limits, -np.pi / 2, np.pi / 2))
        passed.hasAccess = int(bool(passed.hasAccess) and low <= sine_of_sun(r_SN_N, place) <= high)
        self.passedOutMsg.write(passed, now, self.moduleID)


class LitDynModel(dyn.GroundStationDynModel):
    """Adds light to the place."""

    def _setup_dynamics_objects(self, **kwargs: Any) -> None:
        """See the base class; the gate runs after the place, whose priority is 2000."""
        super()._setup_dynamics_objects(**kwargs)
        messages = self.world.gravFactory.spiceObject.planetStateOutMsgs
        self.gate = LightGate(self.imagingTarget, messages[self.world.body_index], messages[self.world.sun_index])
        self.simulator.AddModelToTask(self.world.world_task_name, self.gate, ModelPriority=1999)


class LimitedImager(sats.ImagingSatellite):
    """Windows of several instruments; ``target_types`` names those of the one that is used."""

    own: dict[str, dict[str, Any]]
    """Arguments of each instrument with limits, by the type of its windows."""

    def reset_pre_sim_init(self) -> None:
        """See the base class."""
        super().reset_pre_sim_init()
        self._tasking = False

    @functools.cached_property
    def sun(self) -> CubicSpline:
        """Position of the Sun in the Earth-fixed frame [m] over time [s]; a satellite flies one episode."""
        return sun_in_earth(self.simulator.world.gravFactory.spiceObject.UTCCalInit)

    def add_location_for_access_checking(self, object: Any, r_LP_P: Array, min_elev: float, type: str, **kwargs: Any) -> None:
        """See the base class; a target is a place for each instrument."""
        super().add_location_for_access_checking(object, r_LP_P, min_elev, type, **kwargs)
        for kind, own in self.own.items() if type == "target" else ():
            super().add_location_for_access_checking(object, r_LP_P, own.get(ELEVATION, min_elev), kind, **kwargs)

    def _add_window(self, object: Any, new_window: tuple[float, float], type: str, r_LP_P: Array, **kwargs: Any) -> None:
        """See the base class; cut windows to where range and light are within the limits of their instrument."""
        windows = [new_window]
        for margin in margins(self, self.own.get(type, {}), r_LP_P):
            windows = [part for window in windows for part in positive_parts(margin, *window)]
        for window in windows:
            super()._add_window(object, window, type=type, r_LP_P=r_LP_P, **kwargs)

    @property
    def upcoming_opportunities(self) -> list[dict[str, Any]]:
        """See the base class; while a target is tasked, only windows of the instrument that is used."""
        found: list[dict[str, Any]] = super().upcoming_opportunities
        return [one for one in found if one["type"] == self.target_types] if self._tasking else found

    def enable_target_window(self, target: Any, max_duration: float | None = None) -> None:
        """See the base class, which takes the first window of any type."""
        self._tasking = True
        super().enable_target_window(target, max_duration=max_duration)
        self._tasking = False


def margins(satellite: LimitedImager, own: dict[str, Any], r_LP_P: Array) -> list[Callable[[float], float]]:
    """Functions of time [s] that are positive where range and light are within the limits of an instrument."""
    found: list[Callable[[float], float]] = []
    if REACH in own:
        place = satellite.trajectory.r_BP_P
        found.append(lambda t: own[REACH] - float(np.linalg.norm(place(t) - r_LP_P)))
    if LEAST_SUN in own:
        found.append(lambda t: sine_of_sun(satellite.sun(t), r_LP_P) - np.sin(own[LEAST_SUN]))
    if MOST_SUN in own:
        found.append(lambda t: np.sin(own[MOST_SUN]) - sine_of_sun(satellite.sun(t), r_LP_P))
    return found


def positive_parts(margin: Callable[[float], float], start: float, end: float) -> list[tuple[float, float]]:
    """Parts of a window in which a smooth function is positive, searched in steps of at most 2 s."""
    times = np.linspace(start, end, 2 + int((end - start) / 2.0))
    values = [margin(t) for t in times]
    roots = [brentq(margin, times[k], times[k + 1], xtol=1e-9) for k in range(len(times) - 1) if values[k] * values[k + 1] < 0.0]
    edges = [start, *roots, end]
    return [(a, b) for a, b in itertools.pairwise(edges) if b > a and margin(0.5 * (a + b)) > 0.0]


class UniqueImages(data.UniqueImageReward):
    """Hides imaged targets from all instruments, as bsk_rl hides them from its one."""

    def create_data_store(self, satellite: LimitedImager) -> None:
        """See the base class."""
        super().create_data_store(satellite)
        imaged = satellite.data_store
        satellite.add_access_filter(lambda one: not one["type"].startswith("target@") or one["object"] not in imaged.data.imaged)
