"""Satellites of AEOS-Bench on Basilisk, in the order of the benchmark's tick, and the progress of tasks there.

Scenarios are in the benchmark's form: the contents of a constellation file and of a file of tasks. Recordings of this project,
measurements of Basilisk's speed and certificates fly with these modules.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import locationPointing, mrpFeedback, rwMotorTorque
from Basilisk.simulation import (
    ReactionWheelPower,
    eclipse,
    groundLocation,
    groundMapping,
    reactionWheelStateEffector,
    simpleBattery,
    simpleNav,
    simplePowerSink,
    simpleSolarPanel,
    spacecraft,
)
from Basilisk.utilities import SimulationBaseClass, macros, orbitalMotion, simIncludeGravBody, simIncludeRW

Array = np.ndarray

EPOCH = "2019 Jan 01 00:00:00.000000 (UTC)"
R_EARTH = 6378136.6  # m, sphere
MU_EARTH = 398600.436e9  # m^3/s^2
ORBIT = ("semi_major_axis", "eccentricity", "inclination", "right_ascension_of_the_ascending_node", "argument_of_perigee")

Scenario = dict[str, Any]


def place_P(latitude: float, longitude: float) -> Array:
    """Point of the sphere in the Earth-fixed frame, m, from degrees."""
    lat, lon = math.radians(latitude), math.radians(longitude)
    return R_EARTH * np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


# --- Basilisk ---


class Craft:
    """The modules of one satellite, added to its task in the benchmark's order."""

    def __init__(self, base: Any, process: Any, bodies: Any, planets: tuple[Any, Any], entries: Mapping[str, Any]) -> None:
        """Create the modules of a satellite with the fields of its file, and its orbit's."""
        earth, sun = planets
        tag = f"satellite{entries['id']}"
        process.addTask(base.CreateNewTask(tag, macros.sec2nano(1.0)))
        self.body = self._body(tag, entries)
        bodies.addBodiesTo(self.body)
        state = self.body.scStateOutMsg
        self.eclipse = eclipse.Eclipse()
        self.eclipse.addSpacecraftToModel(state)
        self.eclipse.addPlanetToModel(earth)
        self.eclipse.sunInMsg.subscribeTo(sun)
        panel, sensor, store = entries["solar_panel"], entries["sensor"], entries["battery"]
        self.panel = simpleSolarPanel.SimpleSolarPanel()
        self.panel.setPanelParameters(panel["direction"], panel["area"], panel["efficiency"])
        self.panel.stateInMsg.subscribeTo(state)
        self.panel.sunEclipseInMsg.subscribeTo(self.eclipse.eclipseOutMsgs[0])
        self.panel.sunInMsg.subscribeTo(sun)
        self.sensor = simplePowerSink.SimplePowerSink()
        self.sensor.powerStatus, self.sensor.nodePowerOut = int(sensor["enabled"]), -sensor["power"]
        self.battery = simpleBattery.SimpleBattery()
        self.battery.storageCapacity, self.battery.storedCharge_Init = store["capacity"], store["percentage"] * store["capacity"]
        navigation = simpleNav.SimpleNav()
        navigation.scStateInMsg.subscribeTo(state)
        self.target = groundLocation.GroundLocation()
        self.target.planetRadius, self.target.minimumElevation = R_EARTH, 0.0
        self.target.planetInMsg.subscribeTo(earth)
        self.target.addSpacecraftToModel(state)
        self.pointing = locationPointing.locationPointing()
        self.pointing.pHat_B = [0.0, 0.0, 1.0]
        self.pointing.scAttInMsg.subscribeTo(navigation.attOutMsg)
        self.pointing.scTransInMsg.subscribeTo(navigation.transOutMsg)
        self.pointing.locationInMsg.subscribeTo(self.target.currentGroundStateOutMsg)
        self.mapping = groundMapping.GroundMapping()
        self.mapping.minimumElevation, self.mapping.maximumRange = 0.0, 1e9
        self.mapping.cameraPos_B, self.mapping.nHat_B = [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]
        self.mapping.halfFieldOfView = math.radians(sensor["half_field_of_view"])
        self.mapping.scStateInMsg.subscribeTo(state)
        self.mapping.planetInMsg.subscribeTo(earth)
        self._control(tag, entries)
        self.battery.addPowerNodeToModel(self.panel.nodePowerOutMsg)
        self.battery.addPowerNodeToModel(self.sensor.nodePowerOutMsg)
        for node in self.wheel_power:
            self.battery.addPowerNodeToModel(node.nodePowerOutMsg)
        modules = (self.body, self.eclipse, self.panel, self.sensor, self.battery, navigation, self.target, self.pointing)
        for k, module in enumerate((*modules, self.mapping, self.feedback, self.motors, self.wheels, *self.wheel_power)):
            if module not in (self.body, self.wheels):
                module.ModelTag = f"{tag}module{k}"
            base.AddModelToTask(tag, module)

    def _body(self, tag: str, entries: Mapping[str, Any]) -> Any:
        elements, orbit = orbitalMotion.ClassicElements(), entries["orbit"]
        elements.a, elements.e = orbit[ORBIT[0]], orbit[ORBIT[1]]
        elements.i, elements.Omega, elements.omega = (orbit[key] * macros.D2R for key in ORBIT[2:])
        elements.f = entries["true_anomaly"] * macros.D2R
        body = spacecraft.Spacecraft()
        body.ModelTag = tag
        body.hub.r_CN_NInit, body.hub.v_CN_NInit = orbitalMotion.elem2rv(MU_EARTH, elements)
        body.hub.mHub, body.hub.r_BcB_B = entries["mass"], [[x] for x in entries["center_of_mass"]]
        self.inertia = np.reshape(entries["inertia"], (3, 3)).tolist()
        # Basilisk rejects, when it initializes, moments that no body has; Flight replaces these before the first tick
        body.hub.IHubPntBc_B = np.eye(3).tolist()
        body.hub.sigma_BNInit = [[x] for x in entries["mrp_attitude_bn"]]
        return body

    def _control(self, tag: str, entries: Mapping[str, Any]) -> None:
        factory, law = simIncludeRW.rwFactory(), entries["mrp_control"]
        for k, wheel in enumerate(entries["reaction_wheels"]):
            nominal = float(round(wheel["max_momentum"]))  # the factory takes those of its types only
            options = {"maxMomentum": nominal, "Omega": wheel["rw_speed_init"], "label": f"{entries['id']}W{k}"}
            device = factory.create(wheel["rw_type"], wheel["rw_direction"], RWModel=messaging.BalancedWheels, **options)
            if wheel["max_momentum"] != nominal:
                device.Js *= wheel["max_momentum"] / nominal
        self.wheels = reactionWheelStateEffector.ReactionWheelStateEffector()
        factory.addToSpacecraft(tag, self.wheels, self.body)
        self.messages = [factory.getConfigMessage()]
        vehicle = messaging.VehicleConfigMsgPayload()
        vehicle.ISCPntB_B = entries["inertia"]
        self.messages.append(messaging.VehicleConfigMsg().write(vehicle))
        self.feedback = mrpFeedback.mrpFeedback()
        self.feedback.K, self.feedback.Ki, self.feedback.P = law["k"], law["ki"], law["p"]
        self.feedback.integralLimit = law["integral_limit"]
        self.feedback.vehConfigInMsg.subscribeTo(self.messages[1])
        self.feedback.guidInMsg.subscribeTo(self.pointing.attGuidOutMsg)
        self.feedback.rwParamsInMsg.subscribeTo(self.messages[0])
        self.feedback.rwSpeedsInMsg.subscribeTo(self.wheels.rwSpeedOutMsg)
        self.motors = rwMotorTorque.rwMotorTorque()
        self.motors.controlAxes_B = np.eye(3).ravel().tolist()
        self.motors.vehControlInMsg.subscribeTo(self.feedback.cmdTorqueOutMsg)
        self.motors.rwParamsInMsg.subscribeTo(self.messages[0])
        self.wheels.rwMotorCmdInMsg.subscribeTo(self.motors.rwMotorTorqueOutMsg)
        self.wheel_power = []
        for wheel, message in zip(entries["reaction_wheels"], self.wheels.rwOutMsgs, strict=True):
            node = ReactionWheelPower.ReactionWheelPower()
            node.basePowerNeed, node.mechToElecEfficiency = wheel["power"], wheel["efficiency"]
            node.rwStateInMsg.subscribeTo(message)
            self.wheel_power.append(node)

    def state(self) -> dict[str, Any]:
        """Contents of the messages after a tick; SI units."""
        body, pointing, store = (
            self.body.scStateOutMsg.read(),
            self.pointing.attGuidOutMsg.read(),
            self.battery.batPowerOutMsg.read(),
        )
        return {
            "r": body.r_BN_N,
            "v": body.v_BN_N,
            "sigma": body.sigma_BN,
            "omega": body.omega_BN_B,
            "Omega": self.wheels.rwSpeedOutMsg.read().wheelSpeeds[:3],
            "u": [message.read().u_current for message in self.wheels.rwOutMsgs],
            "sigma_BR": pointing.sigma_BR,
            "omega_BR": pointing.omega_BR_B,
            "integral": self.feedback.int_sigma,
            "charge": store.storageLevel,
            "net_power": store.currentNetPower,
            "solar_power": self.panel.nodePowerOutMsg.read().netPower,
            "wheel_power": sum(node.nodePowerOutMsg.read().netPower for node in self.wheel_power),
            "illumination": self.eclipse.eclipseOutMsgs[0].read().shadowFactor,
        }

    def rounded_position(self) -> Array:
        """Position as the benchmark's greedy rule sees it: through elements in degrees, then in single precision."""
        message = self.body.scStateOutMsg.read()
        elements = orbitalMotion.rv2elem(MU_EARTH, np.array(message.r_CN_N), np.array(message.v_CN_N))
        for name in ("i", "Omega", "omega", "f"):
            setattr(elements, name, getattr(elements, name) / macros.D2R * macros.D2R)
        return orbitalMotion.elem2rv(MU_EARTH, elements)[0].astype(np.float32)


class Flight:
    """All satellites of a scenario after a tick, the one at time zero to begin with."""

    def __init__(self, scenario: Scenario) -> None:
        """Begin at time zero, with all ticks up to it."""
        self.tick, self.scenario = 0, scenario
        self.base = SimulationBaseClass.SimBaseClass()
        process = self.base.CreateNewProcess("aeos_bench")
        process.addTask(self.base.CreateNewTask("world", macros.sec2nano(1.0)))
        bodies = simIncludeGravBody.gravBodyFactory()
        bodies.createEarth().isCentralBody = True
        bodies.createSun()
        self.spice = bodies.createSpiceInterface(time=EPOCH)
        self.spice.zeroBase = "Earth"
        self.base.AddModelToTask("world", self.spice)
        planets = self.spice.planetStateOutMsgs[0], self.spice.planetStateOutMsgs[1]
        orbits = {orbit["id"]: orbit for orbit in scenario["constellation"]["orbits"]}
        satellites = [one | {"orbit": orbits[one["orbit"]]} for one in scenario["constellation"]["satellites"]]
        self.crafts = [Craft(self.base, process, bodies, planets, one) for one in satellites]
        self.places_P = np.array([place_P(*task["coordinate"]) for task in scenario["taskset"]]).reshape(-1, 3)
        for craft in self.crafts:
            for place in self.places_P:
                craft.mapping.addPointToModel(place)
        self.base.InitializeSimulation()
        for craft in self.crafts:
            craft.body.hub.IHubPntBc_B = craft.inertia
        self.run_to(0)

    def run_to(self, tick: int) -> None:
        """Run all ticks up to this one."""
        self.base.ConfigureStopTime(macros.sec2nano(float(tick)))
        self.base.ExecuteSimulation()
        self.tick = tick

    def act(self, choice: Array, toggle: Array) -> None:
        """Set the places to point at, and toggle sensors."""
        for craft, task, flip in zip(self.crafts, choice.tolist(), toggle.tolist(), strict=True):
            if flip:
                craft.sensor.powerStatus = 1 - craft.sensor.powerStatus
            if task < 0:
                craft.target.specifyLocationPCPF([[0.0], [0.0], [0.0]])
            else:
                craft.target.specifyLocation(*np.radians(self.scenario["taskset"][task]["coordinate"]), 0.0)

    @property
    def PN(self) -> Array:
        """Rotation from inertial to Earth-fixed axes, [3, 3]."""
        return np.array(self.spice.planetStateOutMsgs[0].read().J20002Pfix)

    @property
    def positions(self) -> Array:
        """Positions of the satellites, [S, 3] m, inertial."""
        return np.array([craft.body.scStateOutMsg.read().r_BN_N for craft in self.crafts])

    @property
    def sensors_on(self) -> Array:
        """Which sensors are on, [S]."""
        return np.array([craft.sensor.powerStatus == 1 for craft in self.crafts])

    @property
    def access(self) -> Array:
        """[S, K]: places in the cone and above their horizon."""
        return self.access_of(np.ones((len(self.crafts), len(self.places_P)), dtype=bool))

    def access_of(self, pairs: Array) -> Array:
        """Access [S, K] to the ``pairs`` pairs only, since reading messages takes most of the time; False for the others."""
        access = np.zeros_like(pairs)
        for s, k in np.argwhere(pairs):
            access[s, k] = bool(self.crafts[s].mapping.accessOutMsgs[int(k)].read().hasAccess)
        return access

    def above(self, margin: float) -> Array:
        """[S, K]: places above the horizon of satellites, or less than ``margin`` meters below its plane."""
        places = self.places_P @ self.PN
        return np.array([(places * (r - places)).sum(1) > -margin * R_EARTH for r in self.positions])


# --- tasks ---


class Progress:
    """Seconds of uninterrupted sight of each task, and the tick in which it succeeded (-1: not yet)."""

    def __init__(self, scenario: Scenario) -> None:
        """Begin without any progress."""
        tasks, satellites = scenario["taskset"], scenario["constellation"]["satellites"]
        self.release, self.due, self.duration = (
            np.array([t[k] for t in tasks]) for k in ("release_time", "due_time", "duration")
        )
        types = np.array([task["sensor_type"] for task in tasks])
        self.matches = np.array([one["sensor"]["type"] for one in satellites])[:, None] == types
        self.count, self.most, self.success = (np.full(len(tasks), x) for x in (0, 0, -1))

    def open(self, tick: int) -> Array:
        """Return which tasks are released, not overdue, and have not succeeded, [T]."""
        return (self.success < 0) & (self.release <= tick) & (tick <= self.due)

    def add(self, flight: Flight, access: Array) -> None:
        """Count a tick, before the actions that follow it."""
        sight = (access & self.matches & flight.sensors_on[:, None]).any(0) & self.open(flight.tick)
        self.count = np.where(sight, self.count + 1, 0)
        self.most = np.maximum(self.most, self.count)
        self.success = np.where((self.count >= self.duration) & (self.success < 0), flight.tick, self.success)


def greedy_rule() -> Callable[[Flight, Array], Array]:
    """Return the benchmark's greedy rule: the nearest task, kept while it is within 60 degrees of nadir.

    It is a function of a flight and of which tasks are open, [T], and returns the task of each satellite, -1 for none, [S]. It
    remembers the tasks of the second before, so every flight needs another one.
    """
    previous: list[int] = []

    def reached(d: Any, r: Any) -> Any:
        return (d < R_EARTH) & ((d * d + r * r - R_EARTH**2) / (2 * d * r) > math.cos(math.pi / 3))

    def choose(flight: Flight, is_open: Array) -> Array:
        candidates, n = np.flatnonzero(is_open), len(flight.crafts)
        choice = np.full(n, -1)
        if len(candidates):
            positions = np.stack([craft.rounded_position() for craft in flight.crafts])
            places, radius = flight.places_P[candidates] @ flight.PN, np.linalg.norm(positions, axis=1)
            distance = np.linalg.norm(places - positions[:, None], axis=2)
            for s, (d, r) in enumerate(zip(distance, radius, strict=True)):
                if reached(d.min(), r):  # else a task that is kept is lost too
                    old: Array = np.flatnonzero(candidates == previous[s]) if previous else np.array([], dtype=int)
                    choice[s] = candidates[old[0] if len(old) and reached(d[old[0]], r) else d.argmin()]
        previous[:] = choice.tolist()
        return choice

    return choose
