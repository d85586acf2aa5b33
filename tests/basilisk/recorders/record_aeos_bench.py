"""Record flights of AEOS-Bench's satellites on Basilisk, in the order of the benchmark's tick.

Usage::

    python tests/basilisk/recorders/record_aeos_bench.py                        # every file, into tests/basilisk/recordings
    python tests/basilisk/recorders/record_aeos_bench.py aeos_bench_random      # only this one
    python tests/basilisk/recorders/record_aeos_bench.py --list

See ``recording.py`` for what it needs; bsk_rl has no part in it. Scenarios are in the benchmark's JSON form. They are drawn from
the distributions of the benchmark (AEOS-Bench, NeurIPS 2025, arXiv 2510.26297), with tasks near the ground tracks, so that a
short flight sees some.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
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
from numpy.random import RandomState
from recording import Array, record_files, versions

EPOCH = "2019 Jan 01 00:00:00.000000 (UTC)"
R_EARTH = 6378136.6  # m, sphere
MU_EARTH = 398600.436e9  # m^3/s^2
NUDGE = 1e-14  # change of the initial attitude that tells how far a flight can be trusted
MOMENTA = {"Honeywell_HR12": (12.0, 25.0, 50.0), "Honeywell_HR14": (25.0, 50.0, 75.0), "Honeywell_HR16": (50.0, 75.0, 100.0)}
ORBIT = ("semi_major_axis", "eccentricity", "inclination", "right_ascension_of_the_ascending_node", "argument_of_perigee")

Scenario = dict[str, Any]
Rule = Callable[["Flight", Array], tuple[Array, Array]]
"""Returns the task of each satellite, -1 for none, and whether to toggle its sensor; given the tasks that are open."""


def place_P(latitude: float, longitude: float) -> Array:
    """Point of the sphere in the Earth-fixed frame, m, from degrees."""
    lat, lon = math.radians(latitude), math.radians(longitude)
    return R_EARTH * np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


# --- Basilisk ---


class Craft:
    """The modules of one satellite, added to its task in the benchmark's order."""

    def __init__(self, base: Any, process: Any, bodies: Any, planets: tuple[Any, Any], given: Mapping[str, Any]) -> None:
        earth, sun = planets
        tag = f"satellite{given['id']}"
        process.addTask(base.CreateNewTask(tag, macros.sec2nano(1.0)))
        self.body = self._body(tag, given)
        bodies.addBodiesTo(self.body)
        state = self.body.scStateOutMsg
        self.eclipse = eclipse.Eclipse()
        self.eclipse.addSpacecraftToModel(state)
        self.eclipse.addPlanetToModel(earth)
        self.eclipse.sunInMsg.subscribeTo(sun)
        panel, sensor, store = given["solar_panel"], given["sensor"], given["battery"]
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
        self._control(tag, given)
        self.battery.addPowerNodeToModel(self.panel.nodePowerOutMsg)
        self.battery.addPowerNodeToModel(self.sensor.nodePowerOutMsg)
        for node in self.wheel_power:
            self.battery.addPowerNodeToModel(node.nodePowerOutMsg)
        modules = (self.body, self.eclipse, self.panel, self.sensor, self.battery, navigation, self.target, self.pointing)
        for k, module in enumerate((*modules, self.mapping, self.feedback, self.motors, self.wheels, *self.wheel_power)):
            if module not in (self.body, self.wheels):
                module.ModelTag = f"{tag}module{k}"
            base.AddModelToTask(tag, module)

    def _body(self, tag: str, given: Mapping[str, Any]) -> Any:
        elements, orbit = orbitalMotion.ClassicElements(), given["orbit"]
        elements.a, elements.e = orbit[ORBIT[0]], orbit[ORBIT[1]]
        elements.i, elements.Omega, elements.omega = (orbit[key] * macros.D2R for key in ORBIT[2:])
        elements.f = given["true_anomaly"] * macros.D2R
        body = spacecraft.Spacecraft()
        body.ModelTag = tag
        body.hub.r_CN_NInit, body.hub.v_CN_NInit = orbitalMotion.elem2rv(MU_EARTH, elements)
        body.hub.mHub, body.hub.r_BcB_B = given["mass"], [[x] for x in given["center_of_mass"]]
        self.inertia = np.reshape(given["inertia"], (3, 3)).tolist()
        # Basilisk refuses, when it initializes, moments that no body has; Flight replaces these before the first tick
        body.hub.IHubPntBc_B = np.eye(3).tolist()
        body.hub.sigma_BNInit = [[x] for x in given["mrp_attitude_bn"]]
        return body

    def _control(self, tag: str, given: Mapping[str, Any]) -> None:
        factory, law = simIncludeRW.rwFactory(), given["mrp_control"]
        for k, wheel in enumerate(given["reaction_wheels"]):
            options = {"maxMomentum": wheel["max_momentum"], "Omega": wheel["rw_speed_init"], "label": f"{given['id']}W{k}"}
            factory.create(wheel["rw_type"], wheel["rw_direction"], RWModel=messaging.BalancedWheels, **options)
        self.wheels = reactionWheelStateEffector.ReactionWheelStateEffector()
        factory.addToSpacecraft(tag, self.wheels, self.body)
        self.kept = [factory.getConfigMessage()]
        vehicle = messaging.VehicleConfigMsgPayload()
        vehicle.ISCPntB_B = given["inertia"]
        self.kept.append(messaging.VehicleConfigMsg().write(vehicle))
        self.feedback = mrpFeedback.mrpFeedback()
        self.feedback.K, self.feedback.Ki, self.feedback.P = law["k"], law["ki"], law["p"]
        self.feedback.integralLimit = law["integral_limit"]
        self.feedback.vehConfigInMsg.subscribeTo(self.kept[1])
        self.feedback.guidInMsg.subscribeTo(self.pointing.attGuidOutMsg)
        self.feedback.rwParamsInMsg.subscribeTo(self.kept[0])
        self.feedback.rwSpeedsInMsg.subscribeTo(self.wheels.rwSpeedOutMsg)
        self.motors = rwMotorTorque.rwMotorTorque()
        self.motors.controlAxes_B = np.eye(3).ravel().tolist()
        self.motors.vehControlInMsg.subscribeTo(self.feedback.cmdTorqueOutMsg)
        self.motors.rwParamsInMsg.subscribeTo(self.kept[0])
        self.wheels.rwMotorCmdInMsg.subscribeTo(self.motors.rwMotorTorqueOutMsg)
        self.wheel_power = []
        for wheel, message in zip(given["reaction_wheels"], self.wheels.rwOutMsgs, strict=True):
            node = ReactionWheelPower.ReactionWheelPower()
            node.basePowerNeed, node.mechToElecEfficiency = wheel["power"], wheel["efficiency"]
            node.rwStateInMsg.subscribeTo(message)
            self.wheel_power.append(node)

    def state(self) -> dict[str, Any]:
        """What the messages say after a tick; SI units."""
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
        given = [one | {"orbit": orbits[one["orbit"]]} for one in scenario["constellation"]["satellites"]]
        self.crafts = [Craft(self.base, process, bodies, planets, one) for one in given]
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
        return np.array(self.spice.planetStateOutMsgs[0].read().J20002Pfix)

    @property
    def positions(self) -> Array:
        return np.array([craft.body.scStateOutMsg.read().r_BN_N for craft in self.crafts])

    @property
    def sensors_on(self) -> Array:
        return np.array([craft.sensor.powerStatus == 1 for craft in self.crafts])

    @property
    def access(self) -> Array:
        """[S, K]: places in the cone and above their horizon."""
        return np.array([[bool(m.read().hasAccess) for m in craft.mapping.accessOutMsgs] for craft in self.crafts])


# --- tasks and rules ---


class Progress:
    """Seconds of uninterrupted sight of each task, and the tick in which it succeeded (-1: not yet)."""

    def __init__(self, scenario: Scenario) -> None:
        tasks, satellites = scenario["taskset"], scenario["constellation"]["satellites"]
        self.release, self.due, self.duration = (
            np.array([t[k] for t in tasks]) for k in ("release_time", "due_time", "duration")
        )
        types = np.array([task["sensor_type"] for task in tasks])
        self.matches = np.array([one["sensor"]["type"] for one in satellites])[:, None] == types
        self.count, self.most, self.success = (np.full(len(tasks), x) for x in (0, 0, -1))

    def open(self, tick: int) -> Array:
        return (self.success < 0) & (self.release <= tick) & (tick <= self.due)

    def add(self, flight: Flight, access: Array) -> None:
        """Count a tick, before the actions that follow it."""
        seen = (access & self.matches & flight.sensors_on[:, None]).any(0) & self.open(flight.tick)
        self.count = np.where(seen, self.count + 1, 0)
        self.most = np.maximum(self.most, self.count)
        self.success = np.where((self.count >= self.duration) & (self.success < 0), flight.tick, self.success)


def random_rule(seed: int, every: int) -> Rule:
    """Return a rule that changes half of the tasks and toggles a third of the sensors at multiples of ``every`` seconds.

    One task in three is none or one that the Earth hides.
    """
    rng = RandomState(seed)
    held: dict[int, int] = {}

    def decide(flight: Flight, is_open: Array) -> tuple[Array, Array]:
        n, places = len(flight.crafts), flight.places_P @ flight.PN
        toggle = np.zeros(n, dtype=bool)
        if flight.tick % every == 0:
            toggle = rng.random_sample(n) < 1 / 3
            for s, r in enumerate(flight.positions):
                above = np.flatnonzero(((places * (r - places)).sum(1) > 0) & is_open)
                if rng.random_sample() < 0.5:
                    held[s] = (
                        int(rng.choice(above)) if len(above) and rng.random_sample() < 2 / 3 else rng.randint(-1, len(places))
                    )
        return np.array([held.get(s, -1) for s in range(n)]), toggle

    return decide


def greedy_rule() -> Rule:
    """Return the benchmark's greedy rule: the nearest task, kept while it is within 60 degrees of nadir; sensors stay on."""
    held: list[int] = []

    def reached(d: Any, r: Any) -> Any:
        return (d < R_EARTH) & ((d * d + r * r - R_EARTH**2) / (2 * d * r) > math.cos(math.pi / 3))

    def decide(flight: Flight, is_open: Array) -> tuple[Array, Array]:
        candidates, n = np.flatnonzero(is_open), len(flight.crafts)
        choice = np.full(n, -1)
        if len(candidates):
            positions = np.stack([craft.rounded_position() for craft in flight.crafts])
            places, radius = flight.places_P[candidates] @ flight.PN, np.linalg.norm(positions, axis=1)
            distance = np.linalg.norm(places - positions[:, None], axis=2)
            for s, (d, r) in enumerate(zip(distance, radius, strict=True)):
                if reached(d.min(), r):  # else a task that is kept is lost too
                    old = np.flatnonzero(candidates == held[s]) if held else []
                    choice[s] = candidates[old[0] if len(old) and reached(d[old[0]], r) else d.argmin()]
        held[:] = choice.tolist()
        return choice, ~flight.sensors_on

    return decide


def again(events: Array, n: int) -> Rule:
    """Return a rule that repeats recorded actions."""
    rows, choice = {}, np.full(n, -1)
    for tick, s, task, flip in events.tolist():
        rows.setdefault(tick, []).append((s, task, flip))

    def decide(flight: Flight, is_open: Array) -> tuple[Array, Array]:
        toggle = np.zeros(n, dtype=bool)
        for s, task, flip in rows.get(flight.tick, ()):
            choice[s], toggle[s] = task, flip
        return choice.copy(), toggle

    return decide


# --- scenarios ---


def draw_satellite(rng: RandomState, k: int, p_over_I: tuple[float, float]) -> dict[str, Any]:
    """A satellite from the benchmark's distributions, whose gain of rates over inertia is within these bounds, 1/s.

    The benchmark keeps satellites that pass a test flight; the bounds stand for that test.
    """
    while True:
        moments, kind = rng.uniform(50, 200, 3), rng.choice(sorted(MOMENTA))
        momentum = float(rng.choice(MOMENTA[kind]))
        gain = rng.uniform(2, 5) * moments.max() / momentum
        ki, p = rng.uniform(0, 0.01), rng.uniform(2, 4) * gain
        ratios = p * (1 + ki * moments) / moments
        if p_over_I[0] < ratios.min() and ratios.max() < p_over_I[1] and 2 * moments.max() < moments.sum():
            break
    phi, theta = math.pi * rng.uniform(), math.pi * rng.uniform(-0.5, 0.5)
    wheels = [
        {
            "rw_type": str(kind),
            "rw_direction": axis,
            "max_momentum": momentum,
            "rw_speed_init": rng.uniform(400, 750),
            "power": rng.uniform(5, 7),
            "efficiency": rng.uniform(0.5, 0.6),
        }
        for axis in np.eye(3).tolist()
    ]
    return {
        "id": k,
        "inertia": np.diag(moments).ravel().tolist(),
        "mass": rng.uniform(50, 200),
        "center_of_mass": [0.0, 0.0, 0.0],
        "orbit": k,
        "solar_panel": {
            "direction": [math.cos(theta) * math.cos(phi), math.cos(theta) * math.sin(phi), math.sin(theta)],
            "area": rng.uniform(0.1, 0.5),
            "efficiency": rng.uniform(0.1, 0.5),
        },
        "sensor": {"type": 1, "enabled": False, "half_field_of_view": rng.uniform(0.1, 0.5), "power": rng.uniform(1, 10)},
        "battery": {"capacity": rng.uniform(8000, 30000), "percentage": rng.uniform(0.1, 1)},
        "reaction_wheels": wheels,
        "mrp_control": {"k": gain, "ki": ki, "p": p, "integral_limit": rng.uniform(0, 5) * ki},
        "true_anomaly": rng.uniform(0, 360),
        "mrp_attitude_bn": [0.0, 0.0, 0.0],
    }


def draw_orbit(rng: RandomState, k: int) -> dict[str, Any]:
    values = (rng.uniform(6.8e6, 8e6), rng.uniform(0, 0.005), rng.uniform(0, 180), rng.uniform(0, 360), rng.uniform(0, 360))
    return {"id": k, **dict(zip(ORBIT, values, strict=True))}


def draw_tasks(
    rng: RandomState, constellation: Any, count: int, horizon: int, durations: tuple[int, int]
) -> list[dict[str, Any]]:
    """Tasks within 8 degrees of where satellites will be at a time between release and due time."""
    flight, tracks = Flight({"constellation": constellation, "taskset": []}), []
    for tick in range(0, horizon, 10):
        flight.run_to(tick)
        tracks.append(flight.positions @ flight.PN.T)
    tasks = []
    for k in range(count):
        duration = rng.randint(durations[0], durations[1] + 1)
        release = rng.randint(0, max(1, horizon - 3 * duration))
        due = rng.randint(min(release + 3 * duration, horizon - 1), horizon)
        x, y, z = tracks[rng.randint(release, due + 1) // 10][rng.randint(len(flight.crafts))]
        latitude = np.clip(math.degrees(math.atan2(z, math.hypot(x, y))) + rng.uniform(-8, 8), -89.9, 89.9)
        place = [round(float(latitude), 4), round(math.degrees(math.atan2(y, x)) + rng.uniform(-8, 8), 4)]
        times = {"release_time": release, "due_time": due, "duration": duration}
        tasks.append({"id": k, **times, "coordinate": place, "sensor_type": 1})
    return tasks


def drawn(rng: RandomState, count: int, p_over_I: tuple[float, float]) -> dict[str, Any]:
    """A constellation of satellites like those of the benchmark."""
    satellites = [draw_satellite(rng, k, p_over_I) for k in range(count)]
    return {"orbits": [draw_orbit(rng, k) for k in range(count)], "satellites": satellites}


def odd(rng: RandomState) -> dict[str, Any]:
    """A pair that the format allows, though the benchmark draws none of the kind."""
    constellation = drawn(rng, 2, (0.2, 1.0))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    for k, one in enumerate(constellation["satellites"]):
        moments = np.array([one["inertia"][j] for j in (0, 4, 8)])
        one["inertia"] = ((turn * moments) @ turn.T).ravel().tolist()
        one["center_of_mass"] = rng.uniform(-0.1, 0.1, 3).tolist()
        for wheel in one["reaction_wheels"]:
            wheel["rw_direction"] = (np.array(wheel["rw_direction"]) + rng.uniform(-0.3, 0.3, 3)).tolist()
        one["sensor"] |= {"type": 1 + k, "enabled": True, "half_field_of_view": 3.0}
        one["mrp_attitude_bn"] = (rng.uniform(0.4, 0.8, 3) * (-1) ** k).tolist()
    constellation["satellites"][1]["battery"]["percentage"] = 1.0
    return constellation


def stiff(rng: RandomState) -> dict[str, Any]:
    """Moments that no body has and an empty battery; a satellite that chatters; one whose wheels start near 6000 rpm."""
    constellation = drawn(rng, 1, (0.2, 0.6))
    impossible = constellation["satellites"][0]
    impossible["inertia"] = np.diag([55.0, 70.0, 190.0]).ravel().tolist()
    impossible["battery"]["percentage"] = 0.0002
    for k, bounds in ((1, (2.2, 5.0)), (2, (0.2, 2.0))):
        constellation["satellites"].append(draw_satellite(rng, k, bounds))
        constellation["orbits"].append(draw_orbit(rng, k))
    for wheel in constellation["satellites"][2]["reaction_wheels"]:
        wheel |= {"rw_type": "Honeywell_HR12", "max_momentum": 12.0, "rw_speed_init": 5900.0}
    return constellation


# --- files ---


@dataclass(frozen=True)
class Case:
    """A file: its constellation, tasks, rule, length in seconds, and the ticks whose states are kept."""

    seed: int
    constellation: Callable[[RandomState], dict[str, Any]]
    tasks: int
    durations: tuple[int, int]
    rule: Callable[[], Rule]
    steps: int
    kept: Callable[[int], bool]


CASES = {
    "aeos_bench_random": Case(
        19, lambda rng: drawn(rng, 3, (0.2, 2.0)), 40, (15, 60), lambda: random_rule(1, 50), 300, lambda t: t < 6 or t % 10 < 2
    ),
    "aeos_bench_odd": Case(23, odd, 40, (15, 60), lambda: random_rule(2, 30), 300, lambda t: t < 6 or t % 10 < 2),
    "aeos_bench_stiff": Case(29, stiff, 40, (15, 30), greedy_rule, 120, lambda t: True),
    "aeos_bench_greedy": Case(31, lambda rng: drawn(rng, 5, (0.2, 0.5)), 50, (15, 60), greedy_rule, 1200, lambda t: t % 60 == 0),
}


def fly(scenario: Scenario, rule: Rule, case: Case) -> tuple[dict[str, Array], Progress]:
    """States of the kept ticks, and events: (tick, satellite, task, toggle) and (tick, satellite, task, access)."""
    flight, progress = Flight(scenario), Progress(scenario)
    states: list[list[dict[str, Any]]] = []
    ticks, actions, sights = [], [], []
    seen, last = np.zeros((len(flight.crafts), len(flight.places_P)), dtype=bool), np.full(len(flight.crafts), -1)
    for tick in range(case.steps + 1):
        flight.run_to(tick)
        if case.kept(tick):
            ticks.append(tick)
            states.append([craft.state() for craft in flight.crafts])
        access = flight.access
        choice, toggle = rule(flight, progress.open(tick))
        sights += [(tick, *pair, access[tuple(pair)]) for pair in np.argwhere(access != seen)]
        actions += [(tick, s, choice[s], toggle[s]) for s in np.flatnonzero((choice != last) | toggle)]
        progress.add(flight, access)
        flight.act(choice, toggle)
        seen, last = access, choice
    arrays = {key: np.array([[one[key] for one in row] for row in states]) for key in states[0][0]}
    events = {key: np.array(rows, dtype=np.int32).reshape(-1, 4) for key, rows in (("action", actions), ("access", sights))}
    return {"tick": np.array(ticks, dtype=np.int32), **arrays, **events}, progress


def record(name: str) -> dict[str, Any]:
    """A flight, and how far one is away whose attitude starts ``NUDGE`` away: the largest difference of rates in each tick."""
    case = CASES[name]
    rng = RandomState(case.seed)
    constellation = case.constellation(rng)
    scenario = {"constellation": constellation, "taskset": draw_tasks(rng, constellation, case.tasks, case.steps, case.durations)}
    if name == "aeos_bench_odd":
        for task in scenario["taskset"]:
            task["sensor_type"] = rng.randint(1, 3)
    flown, progress = fly(scenario, case.rule(), case)
    nudged = [one | {"mrp_attitude_bn": [x + NUDGE for x in one["mrp_attitude_bn"]]} for one in constellation["satellites"]]
    rule = again(flown["action"], len(nudged))
    twin, _ = fly({"constellation": constellation | {"satellites": nudged}, "taskset": scenario["taskset"]}, rule, case)
    away = np.abs(twin["omega"] - flown["omega"]).max(-1).astype(np.float32)
    texts = {key: json.dumps(value) for key, value in scenario.items()} | {"versions": json.dumps(versions())}
    return texts | flown | {"success": progress.success, "most": progress.most, "sensitivity": away}


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = dict.fromkeys(CASES, record)


if __name__ == "__main__":
    record_files(RECORDERS)
