"""Random problems for the differential tester: a seed gives satellites, world, scenario, rewards, options and actions.

A :class:`Case` holds names and numbers only, no object of either library: every value that a library would draw is given, so that
both fly the same episode. :mod:`differential_flight` builds it from the classes of a library.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MU = 3.986004415e14
"""Gravitational parameter of the Earth, m^3/s^2, from which positions follow where an orbit is not given by elements."""

R_EARTH = 6378136.6
"""Equatorial radius of the Earth, m."""

MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")

DRAG_ALTITUDE = 400e3
"""Perigee, m, below which orbits are integrated in every tick: drag matters there."""


class Part(NamedTuple):
    """An entry of a description: a class by name, with its arguments."""

    name: str
    args: tuple[Any, ...] = ()
    options: dict[str, Any] = {}  # noqa: RUF012


class Drawn(NamedTuple):
    """A value that a function draws from NumPy's generator, uniformly between two bounds."""

    low: float
    high: float


@dataclass(frozen=True)
class Orbit:
    """An orbit: semi-major axis, m, eccentricity, and the four angles i, Omega, omega, f, rad; ``elements`` if given as such."""

    a: float
    e: float
    angles: tuple[float, float, float, float]
    elements: bool

    @property
    def perigee(self) -> float:
        """Smallest altitude, m."""
        return self.a * (1.0 - self.e) - R_EARTH

    @property
    def period(self) -> float:
        """Period, s."""
        return float(2.0 * np.pi * np.sqrt(self.a**3 / MU))

    def state(self) -> tuple[Array, Array]:
        """Position, m, and velocity, m/s, in N."""
        i, node, perigee, f = self.angles
        p = self.a * (1.0 - self.e**2)
        r, mu_h = p / (1.0 + self.e * np.cos(f)), np.sqrt(MU / p)
        cos, sin = np.cos, np.sin
        x = np.array(
            [
                cos(node) * cos(perigee) - sin(node) * sin(perigee) * cos(i),
                sin(node) * cos(perigee) + cos(node) * sin(perigee) * cos(i),
                sin(perigee) * sin(i),
            ]
        )
        y = np.array(
            [
                -cos(node) * sin(perigee) - sin(node) * cos(perigee) * cos(i),
                -sin(node) * sin(perigee) + cos(node) * cos(perigee) * cos(i),
                cos(perigee) * sin(i),
            ]
        )
        return r * (cos(f) * x + sin(f) * y), mu_h * (-sin(f) * x + (self.e + cos(f)) * y)


@dataclass(frozen=True)
class Craft:
    """A satellite.

    Attributes:
        name: Its name.
        base: Class of :mod:`bsk_rl.sats`.
        dyn: Dynamics models, the first of which wins.
        fsw: Flight-software models, likewise.
        observations: Entries of its ``observation_spec``.
        actions: Entries of its ``action_spec``.
        orbit: Where it starts; a function of the library that draws it, or None for the default.
        sat_args: Its other arguments.
        options: Keyword arguments of its constructor.
        called: The name that it is given, if it is renamed.
    """

    name: str
    base: str
    dyn: tuple[str, ...]
    fsw: tuple[str, ...]
    observations: tuple[Part, ...]
    actions: tuple[Part, ...]
    orbit: Orbit | Part | None
    sat_args: dict[str, Any]
    options: dict[str, Any] = field(default_factory=dict)
    called: str = ""

    @property
    def choices(self) -> int:
        """Number of discrete actions; 0 where actions are real numbers."""
        if self.actions[0].name in CONTINUOUS:
            return 0
        return sum(part.options.get("n_ahead_image", 1) for part in self.actions)


@dataclass(frozen=True)
class Case:
    """A problem, and what is done in it.

    Attributes:
        seed: What it was drawn from.
        family: Kind of problem.
        view: "single", "joint" or "agents": SatelliteTasking, GeneralSatelliteTasking or ConstellationTasking.
        crafts: The satellites.
        world_args: Arguments of the world.
        env: Options of the environment.
        scenario: Its class; targets are given.
        targets: Their positions, m Earth-fixed, and priorities, [T, 4].
        rewarders: Classes of rewards.
        communicator: Class of the communication method.
        chances: Uniform numbers, one column for each satellite and number of an action, [K, S, 5].
        follows: Whether a satellite is given an action, [K, S]; idle ones are in general.
        randomizer: Function of the library that draws arguments of all satellites.
        seeds: Seeds of the episodes, which share the actions.
        program: Whether draws are left to the library, and all that it returns is compared.
    """

    seed: int
    family: str
    view: str
    crafts: tuple[Craft, ...]
    world_args: dict[str, Any]
    env: dict[str, Any]
    scenario: Part
    targets: Array
    rewarders: tuple[Part, ...]
    communicator: Part | None
    chances: Array
    follows: NDArray[np.bool_]
    randomizer: Part | None = None
    seeds: tuple[int, ...] = (0,)
    program: bool = False

    @property
    def integrated(self) -> bool:
        """Whether the orbits are to be integrated in every tick."""
        return bool(self.env["integrated"])


CONTINUOUS = {"ImpulsiveThrust", "ImpulsiveThrustHill", "AttitudeSetpoint"}
"""Actions that are real numbers."""


class Draw:
    """A random stream with the draws that problems are made of."""

    def __init__(self, seed: int) -> None:
        """Begin the stream of a seed."""
        self.rng = np.random.default_rng((seed, 20260))

    def chance(self, probability: float) -> bool:
        """Whether something happens."""
        return bool(self.rng.random() < probability)

    def uniform(self, low: float, high: float) -> float:
        """A number."""
        return float(self.rng.uniform(low, high))

    def log(self, low: float, high: float) -> float:
        """A positive number whose logarithm is uniform."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def whole(self, low: int, high: int) -> int:
        """A whole number from ``low`` to ``high``, both included."""
        return int(self.rng.integers(low, high + 1))

    def one(self, *options: Any) -> Any:
        """One of the options."""
        return options[int(self.rng.integers(len(options)))]

    def weighted(self, **weights: float) -> str:
        """One of the names, by weight."""
        names = list(weights)
        total = np.array(list(weights.values()))
        return names[int(self.rng.choice(len(names), p=total / total.sum()))]

    def some(self, options: Sequence[Any], low: int, high: int | None = None) -> list[Any]:
        """At least ``low`` of the options, in random order."""
        count = self.whole(min(low, len(options)), min(len(options), high or len(options)))
        return [options[k] for k in self.rng.permutation(len(options))[:count]]

    def vector(self, scale: float) -> list[float]:
        """Three numbers up to a scale."""
        return self.rng.uniform(-scale, scale, 3).tolist()

    def duration(self, sim_rate: float) -> float:
        """Length of a task, s: a whole number of ticks now and then, any number otherwise."""
        seconds = self.log(20.0, 400.0)
        return max(1.0, round(seconds / sim_rate)) * sim_rate if self.chance(0.6) else seconds

    def epoch(self) -> str:
        """An epoch between 2000 and 2022."""
        year, month, day = self.whole(2000, 2021), self.one(*MONTHS), self.whole(1, 28)
        hour, minute, second, milli = (self.whole(0, high) for high in (23, 59, 59, 999))
        return f"{year} {month} {day:02d} {hour:02d}:{minute:02d}:{second:02d}.{milli:03d} (UTC)"

    def orbit(self) -> Orbit:
        """An orbit of one of many kinds."""
        kind = self.weighted(low=4, drag=1, high=1.5, slightly=1.5, eccentric=1, molniya=0.4, distant=0.6)
        angles = self.rng.uniform(0.0, 2.0 * np.pi, 4)
        angles[0] = self.one(0.0, np.pi / 2, self.uniform(0.0, np.pi), self.uniform(0.0, np.pi), np.radians(97.5))
        altitude = {
            "low": self.uniform(420e3, 1000e3),
            "drag": self.uniform(230e3, 400e3),
            "high": self.uniform(1000e3, 3000e3),
            "slightly": self.uniform(450e3, 700e3),
            "eccentric": self.uniform(450e3, 900e3),
            "molniya": self.uniform(500e3, 1000e3),
            "distant": self.uniform(8000e3, 36000e3),
        }[kind]
        e = {"slightly": self.uniform(0.001, 0.03), "eccentric": self.uniform(0.05, 0.3), "molniya": self.uniform(0.5, 0.72)}.get(
            kind, 0.0
        )
        perigee = R_EARTH + altitude
        return Orbit(perigee / (1.0 - e), e, tuple(angles.tolist()), self.chance(0.4))  # type: ignore[arg-type]


# -- satellites ---------------------------------------------------------------------------------------------------------

STATE = (
    ("sigma_BN", 1.0),
    ("omega_BN_B", 0.03),
    ("omega_BP_P", 0.03),
    ("omega_BH_H", 0.03),
    ("r_BN_N", 1e7),
    ("v_BN_N", 1e4),
    ("r_BN_P", 1e7),
    ("v_BN_P", 1e4),
    ("beta_angle", np.pi),
)
"""Properties of all satellites, with norms."""

POWER = (("battery_charge", 1e5), ("battery_charge_fraction", 1.0), ("wheel_speeds", 600.0), ("wheel_speeds_fraction", 1.0))
STORAGE = (("storage_level", 1e8), ("storage_level_fraction", 1.0))
BORESIGHT = (("c_hat_P", 1.0), ("c_hat_H", 1.0))

TARGET = (
    ("priority", 1.0),
    ("r_LP_P", R_EARTH),
    ("r_LB_H", 8e5),
    ("opportunity_open", 300.0),
    ("opportunity_mid", 300.0),
    ("opportunity_close", 300.0),
    ("target_angle", np.pi),
    ("target_angle_rate", 0.03),
)
PASS = (("opportunity_open", 5700.0), ("opportunity_mid", 5700.0), ("opportunity_close", 5700.0), ("r_LP_P", R_EARTH))

RELATIVE = (
    ("r_DC_N", 1e3),
    ("v_DC_N", 1.0),
    ("r_DC_Hc", 1e3),
    ("v_DC_Hc", 1.0),
    ("rso_sigma_BH", 1.0),
    ("rso_omega_BH", 0.01),
)


def entries(draw: Draw, properties: Sequence[tuple[str, float]], low: int = 1) -> tuple[dict[str, Any], ...]:
    """Some of the properties as arguments of an observation; the norm is left out now and then."""
    return tuple(
        dict(prop=name) if draw.chance(0.3) else dict(prop=name, norm=float(norm)) for name, norm in draw.some(properties, low)
    )


def body_args(draw: Draw) -> dict[str, Any]:
    """Arguments of a rigid body."""
    args: dict[str, Any] = dict(sigma_init=draw.rng.uniform(0.0, 1.0, 3).tolist(), omega_init=draw.vector(draw.log(1e-5, 3e-2)))
    if draw.chance(0.3):
        args |= dict(mass=draw.uniform(200.0, 800.0))
    if draw.chance(0.2):
        args |= dict(width=draw.uniform(1.0, 2.0), depth=draw.uniform(1.0, 2.0), height=draw.uniform(1.0, 2.0))
    if draw.chance(0.1):
        args |= dict(min_orbital_radius=R_EARTH + draw.one(draw.uniform(100e3, 230e3), draw.uniform(150e3, 800e3)))
    return args


def actuator_args(draw: Draw, steering: bool) -> dict[str, Any]:
    """Arguments of power, wheels, thrusters and control."""
    capacity = draw.log(5e4, 1e6)
    stored = capacity * float(draw.weighted(**{str(draw.uniform(0.3, 1.0)): 8, str(draw.uniform(0.003, 0.05)): 1, "1.0": 1}))
    args: dict[str, Any] = dict(
        batteryStorageCapacity=capacity,
        storedCharge_Init=stored,
        wheelSpeeds=draw.vector(fastest := draw.one(500.0, 1500.0, 1500.0, 4000.0, 5900.0)),
        disturbance_vector=draw.vector(draw.log(1e-6, 1e-2)) if draw.chance(0.6) else None,
    )
    optional = (
        (0.4, "maxWheelSpeed", lambda: draw.one(fastest * draw.uniform(1.0, 1.3), 6000.0, 6000.0)),
        (0.3, "u_max", lambda: draw.log(0.05, 0.5)),
        (0.4, "basePowerDraw", lambda: -draw.log(1.0, 80.0)),
        (0.3, "thrusterPowerDraw", lambda: -draw.log(1.0, 100.0)),
        (0.2, "rwBasePower", lambda: draw.uniform(0.0, 20.0)),
        (0.2, "rwMechToElecEfficiency", lambda: draw.uniform(0.0, 0.9)),
        (0.2, "rwElecToMechEfficiency", lambda: draw.uniform(0.2, 1.0)),
        (0.4, "panelArea", lambda: draw.log(0.1, 3.0)),
        (0.3, "panelEfficiency", lambda: draw.uniform(0.05, 0.4)),
        (0.2, "nHat_B", lambda: draw.one([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.0, -0.8])),
        (0.2, "dragCoeff", lambda: draw.uniform(1.0, 3.0)),
        (0.5, "desatAttitude", lambda: draw.one("sun", "nadir", None)),
        (0.2, "hs_min", lambda: draw.uniform(0.0, 2.0)),
        (0.2, "maxCounterValue", lambda: draw.whole(1, 10)),
        (0.2, "thrMinFireTime", lambda: draw.uniform(0.01, 0.2)),
    )
    gains = (
        (
            (0.3, "K1", lambda: draw.uniform(0.1, 0.4)),
            (0.3, "K3", lambda: draw.uniform(0.5, 4.0)),
            (0.3, "omega_max", lambda: np.radians(draw.uniform(1.0, 5.0))),
            (0.3, "servo_Ki", lambda: draw.uniform(1.0, 6.0)),
            (0.3, "servo_P", lambda: draw.uniform(30.0, 160.0)),
        )
        if steering
        else (
            (0.3, "K", lambda: draw.uniform(2.0, 10.0)),
            (0.3, "P", lambda: draw.uniform(20.0, 50.0)),
            (0.1, "Ki", lambda: 1e-4),
        )
    )
    for probability, name, value in (*optional, *gains):
        if draw.chance(probability):
            args[name] = value()
    return args


def storage_args(draw: Draw, scans: bool) -> dict[str, Any]:
    """Arguments of instrument, store and transmitter."""
    baud = draw.one(8e6, draw.log(1e5, 1e7))
    capacity = round(baud * (draw.log(30.0, 3000.0) if scans else draw.log(2.0, 60.0)))
    args: dict[str, Any] = dict(instrumentBaudRate=float(round(baud)), dataStorageCapacity=capacity)
    optional = (
        (0.4, "transmitterBaudRate", lambda: -float(round(draw.log(1e5, 1e8)))),
        (0.3, "transmitterPowerDraw", lambda: -draw.uniform(1.0, 60.0)),
        (0.3, "instrumentPowerDraw", lambda: -draw.uniform(1.0, 60.0)),
        (0.4, "storageInit", lambda: int(capacity * draw.one(draw.uniform(0.0, 1.0), draw.uniform(0.9, 1.0), 0.5))),
        (0.2, "storageUnitValidCheck", lambda: draw.chance(0.5)),
        (0.2, "transmitterPacketSize", lambda: -draw.one(1.0, float(round(baud / 2)))),
        (0.4, "imageAttErrorRequirement", lambda: draw.one(0.01, draw.log(0.003, 0.2))),
        (0.4, "imageRateErrorRequirement", lambda: draw.one(None, draw.log(0.001, 0.1))),
        (0.2, "imageTargetMaximumRange", lambda: draw.one(-1.0, draw.uniform(500e3, 2000e3))),
        (0.15, "inst_pHat_B", lambda: draw.one([0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.8, 0.0, 0.6])),
    )
    for probability, name, value in optional:
        if draw.chance(probability):
            args[name] = value()
    if not scans:
        args["imageTargetMinimumElevation"] = float(
            np.radians(draw.one(45.0, draw.uniform(20.0, 80.0), draw.uniform(45.0, 65.0)))
        )
    return args


def look_options(draw: Draw) -> dict[str, Any]:
    """How far a satellite looks ahead."""
    options: dict[str, Any] = {}
    if draw.chance(0.25):
        options["generation_duration"] = draw.one(600.0, 300.0, 1200.0, 60.0 * draw.whole(2, 30))
    if draw.chance(0.25):
        options["initial_generation_duration"] = draw.one(0.0, 600.0, draw.uniform(100.0, 5000.0))
    if draw.chance(0.1):
        options["max_generation_duration_beyond_initial"] = draw.one(0.0, 600.0, 6000.0)
    return options


def modes(draw: Draw, kinds: Sequence[str], sim_rate: float) -> list[Part]:
    """Some discrete actions, with durations."""
    parts = []
    for k, kind in enumerate(draw.some(kinds, 2)):
        options: dict[str, Any] = dict(duration=draw.duration(sim_rate))
        if draw.chance(0.1):
            options["name"] = f"{kind.lower()}_{k}"
        parts.append(Part(kind, (), options))
    if draw.chance(0.1):
        parts.append(
            Part(
                "DiscreteFSWAction",
                ("action_nadir_point",),
                dict(duration=draw.duration(sim_rate), reset_task=draw.chance(0.5), name="again"),
            )
        )
    return parts


def craft(draw: Draw, name: str, role: str, orbit: Orbit, mixins: tuple[str, ...], sim_rate: float) -> Craft:
    """A satellite of a role: "image", "scan", "basic" or "passive"."""
    steering = draw.chance(0.4)
    args, options, actions, observations = body_args(draw), {}, [], []
    properties = list(STATE)
    if role == "passive":
        dyn = draw.one(("DynamicsModel",), ("EclipseDynModel",), ("DisturbanceTorqueDynModel",), ("DynamicsModel",))
        if dyn == ("DisturbanceTorqueDynModel",):
            args["disturbance_vector"] = draw.vector(1e-4)
        fsw: tuple[str, ...] = ("FSWModel",)
        base = "Satellite"
        actions = modes(draw, ("NadirPoint", "Drift"), sim_rate)
    else:
        args |= actuator_args(draw, steering)
        properties += POWER
        stations = draw.chance(0.7)
        if role == "image":
            dyn = ("GroundStationDynModel",) if stations else ("ImagingDynModel",)
            fsw = (
                draw.one(("SteeringImagerFSWModel",), ("SteeringFSWModel", "ImagingFSWModel"))
                if steering
                else ("ImagingFSWModel",)
            )
            base = "ImagingSatellite"
            args |= storage_args(draw, False)
            actions = modes(draw, ("Charge", "Desat", "Drift", "NadirPoint", *(["Downlink"] if stations else [])), sim_rate)
            actions = actions if draw.chance(0.7) else []
            ahead = draw.whole(1, 12)
            image = Part(
                "Image", (), dict(n_ahead_image=ahead) | (dict(max_duration=draw.duration(sim_rate)) if draw.chance(0.3) else {})
            )
            actions.insert(draw.whole(0, len(actions)), image)
            number = draw.one(ahead, draw.whole(1, 16))
            observations.append(
                Part("OpportunityProperties", entries(draw, TARGET, 2), dict(type="target", n_ahead_observe=number))
            )
        elif role == "scan":
            dyn = ("ContinuousImagingDynModel", "GroundStationDynModel") if stations else ("ContinuousImagingDynModel",)
            fsw = ("SteeringFSWModel", "ContinuousImagingFSWModel") if steering else ("ContinuousImagingFSWModel",)
            base = "AccessSatellite"
            args |= storage_args(draw, True)
            kinds = ("Charge", "Desat", "Drift", "NadirPoint", *(["Downlink"] if stations else []))
            actions = [Part("Scan", (), dict(duration=draw.duration(sim_rate))), *modes(draw, kinds, sim_rate)]
        else:
            dyn, stations = ("BasicDynamicsModel",), False
            fsw = ("SteeringFSWModel",) if steering else ("BasicFSWModel",)
            base = draw.one("Satellite", "AccessSatellite")
            actions = modes(draw, ("Charge", "Desat", "Drift", "NadirPoint"), sim_rate)
        if role in ("image", "scan"):
            properties += STORAGE + BORESIGHT
            options |= look_options(draw)
            if stations and draw.chance(0.7):
                number = draw.whole(1, 3)
                observations.append(
                    Part("OpportunityProperties", entries(draw, PASS), dict(type="ground_station", n_ahead_observe=number))
                )
        if draw.chance(0.4):
            observations.append(Part("Eclipse", (), dict(norm=draw.one(1.0, 5700.0))))
    observations.append(Part("SatProperties", entries(draw, properties, 2)))
    if draw.chance(0.5):
        observations.append(Part("Time", (), draw.one({}, dict(norm=1000.0))))
    if draw.chance(0.15):
        options["variable_interval"] = False
    order = [observations[k] for k in draw.rng.permutation(len(observations))]
    return Craft(name, base, mixins + dyn, fsw, tuple(order), tuple(actions), orbit, args, options)


# -- problems -----------------------------------------------------------------------------------------------------------

STATIONS = (
    dict(name="Boulder", lat=40.009971, long=-105.243895, elev=1624.0),
    dict(name="Singapore", lat=1.3521, long=103.8198, elev=15.0),
    dict(name="Svalbard", lat=78.2, long=15.4, elev=450.0),
    dict(name="Santiago", lat=-33.4489, long=-70.6693, elev=570.0),
    dict(name="Troll", lat=-72.0, long=2.5, elev=1200.0),
)


def world_args(draw: Draw, crafts: Sequence[Craft]) -> dict[str, Any]:
    """Arguments of the world that the satellites need."""
    args: dict[str, Any] = dict(utc_init=draw.epoch())
    models = {model for craft in crafts for model in craft.dyn}
    if "GroundStationDynModel" in models:
        if draw.chance(0.3):
            args["groundStationsData"] = [dict(station) for station in draw.some(STATIONS, 1)]
        if draw.chance(0.3):
            args["gsMinimumElevation"] = float(np.radians(draw.uniform(3.0, 40.0)))
        if draw.chance(0.1):
            args["gsMaximumRange"] = draw.uniform(800e3, 3000e3)
    if draw.chance(0.1) and models - {"DynamicsModel", "EclipseDynModel", "DisturbanceTorqueDynModel", "LOSCommDynModel"}:
        args |= dict(baseDensity=draw.uniform(0.5, 2.0), scaleHeight=draw.uniform(7000.0, 9000.0))
    return args


def env_options(draw: Draw, period: float) -> dict[str, Any]:
    """Options of the environment."""
    sim_rate = float(draw.weighted(**{"1.0": 12, "0.5": 2, "2.0": 2, "5.0": 1, "0.25": 0.5, "10.0": 0.5, "0.1": 0.3}))
    options: dict[str, Any] = dict(sim_rate=sim_rate)
    limit = draw.one(draw.uniform(400.0, 2000.0), draw.uniform(1000.0, 8000.0), draw.uniform(0.5, 1.5) * min(period, 7000.0))
    options["time_limit"] = min(draw.one(limit, float(round(limit))), 8000.0 * sim_rate)
    if draw.chance(0.1):
        options["time_limit"] = float("inf")
    if draw.chance(0.25) or options["time_limit"] == float("inf"):
        options["max_step_duration"] = draw.one(draw.duration(sim_rate), draw.uniform(30.0, 300.0))
    if draw.chance(0.4):
        options["failure_penalty"] = draw.one(0.0, -10.0, -draw.log(0.01, 1e3))
    if draw.chance(0.3):
        options["terminate_on_time_limit"] = True
    if draw.chance(0.2):
        options["generate_obs_retasking_only"] = True
    return options


def near_tracks(draw: Draw, orbits: Sequence[Orbit], count: int, span: float) -> Array:
    """Targets [T, 4] of which most lie roughly near the tracks of satellites during the first ``span`` seconds."""
    rows = []
    turn = 7.292115e-5
    for _ in range(count):
        if draw.chance(0.3):
            direction = draw.rng.normal(size=3)
        else:
            orbit = orbits[draw.whole(0, len(orbits) - 1)]
            ahead = draw.uniform(0.0, span)
            i, node, perigee, f = orbit.angles
            mean = 2.0 * np.pi / orbit.period * ahead
            r, _ = replace(orbit, angles=(i, node, perigee, f + mean)).state()
            angle = draw.uniform(0.0, 2.0 * np.pi) if draw.chance(0.2) else -turn * ahead
            direction = r / np.linalg.norm(r) + draw.rng.normal(size=3) * 0.03
            cos, sin = np.cos(angle), np.sin(angle)
            direction = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ direction
        rows.append([*(R_EARTH * direction / np.linalg.norm(direction)), draw.uniform(0.0, 1.0)])
    return np.array(rows).reshape(-1, 4)


def draw_case(seed: int, steps: int) -> Case:
    """Draw the problem of a seed, with up to ``steps`` actions."""
    draw = Draw(seed)
    family = draw.weighted(image=6, scan=5, basic=2, passive=1, thrust=1.5, setpoint=1, mixed=1.5, inspect=1.5, close=1)
    return FAMILIES[family](draw, seed, steps, family)


def several(draw: Draw, family: str) -> tuple[str, int]:
    """View and number of satellites."""
    view = draw.weighted(single=5, joint=2, agents=3)
    if family == "mixed":
        view = draw.one("joint", "agents")
    return view, 1 if view == "single" else draw.whole(2, 4)


def fleet_orbits(draw: Draw, count: int) -> list[Orbit]:
    """Orbits of satellites: each alone, or in a train."""
    first = draw.orbit()
    if draw.chance(0.4):
        return [first, *(draw.orbit() for _ in range(count - 1))]
    i, node, perigee, f = first.angles
    gap = draw.uniform(0.005, 0.4)
    return [replace(first, angles=(i, node, perigee, f - gap * k)) for k in range(count)]


def actions_of(draw: Draw, steps: int, count: int, single: bool) -> tuple[Array, NDArray[np.bool_]]:
    """Uniform numbers of the actions, and who gets a new task although it is busy, or none although it is idle."""
    chances = draw.rng.random((steps, count, 5))
    probability = 1.0 if single else draw.one(1.0, 0.7, 0.4)
    return chances, draw.rng.random((steps, count)) < probability


def communication(draw: Draw, count: int, lines: bool) -> Part | None:
    """A communication method."""
    if count == 1:
        return None
    kinds = ["FreeCommunication", "NoCommunication", *(["LOSCommunication", "LOSMultiCommunication"] if lines else [])]
    kind = draw.one(*kinds)
    return Part(kind, (), dict(min_period=draw.uniform(10.0, 300.0)) if draw.chance(0.3) and kind != "NoCommunication" else {})


def fleet_case(draw: Draw, seed: int, steps: int, family: str) -> Case:
    """Satellites of the roles "image", "scan", "basic" and "passive"."""
    view, count = several(draw, family)
    orbits = fleet_orbits(draw, count)
    env = env_options(draw, orbits[0].period)
    lines = count > 1 and draw.chance(0.5)
    integrated = min(orbit.perigee for orbit in orbits) < DRAG_ALTITUDE or (draw.chance(0.15) and not lines)
    if lines and integrated:
        lines = False
    mixins: tuple[str, ...] = ("LOSCommDynModel",) if lines else ()
    task = draw.one("image", "scan") if family == "mixed" else family
    roles = [task if family != "mixed" or k == 0 else draw.one("image", "scan", "basic", "passive") for k in range(count)]
    if task == "image":  # bsk_rl asks all satellites that look for places for their minimum elevation of targets
        roles = ["image" if role == "scan" else role for role in roles]
    crafts = [
        craft(draw, f"Sat{k}", role, orbit, mixins, env["sim_rate"])
        for k, (role, orbit) in enumerate(zip(roles, orbits, strict=True))
    ]
    if task == "image":
        crafts = [replace(one, base="Satellite") if one.dyn[-1] == "BasicDynamicsModel" else one for one in crafts]
    if count > 1 and family != "mixed" and draw.chance(0.5):  # satellites of one type
        crafts = [
            replace(crafts[0], name=other.name, orbit=other.orbit, sat_args=crafts[0].sat_args | body_args(Draw(seed + k)))
            for k, other in enumerate(crafts)
        ]
    if lines and draw.chance(0.3):
        crafts = [replace(one, sat_args=one.sat_args | dict(losMaximumRange=draw.uniform(5e5, 5e6))) for one in crafts]
    span = min(env["time_limit"], 6000.0)
    targets, scenario, rewarders = np.zeros((0, 4)), Part("Scenario"), [Part("NoReward")]
    if task == "image":
        targets = near_tracks(draw, orbits, draw.one(draw.whole(20, 400), draw.whole(200, 1000), draw.whole(3, 20)), span)
        scenario, rewarders = Part("Targets"), [Part("UniqueImageReward")]
    elif task == "scan":
        scenario, rewarders = (
            Part("UniformNadirScanning", (), dict(value_per_second=draw.log(1e-4, 1.0))),
            [Part("ScanningTimeReward")],
        )
    if any(role != task for role in roles):  # rewards for data need the same instruments of all
        rewarders = [Part("NoReward")]
    elif task in ("image", "scan", "basic") and draw.chance(0.2):
        resource = Part(
            "ResourceReward",
            (),
            dict(reward_weight=draw.uniform(-2.0, 2.0), resource=draw.one("battery_charge_fraction", "battery_charge")),
        )
        rewarders = [resource] if task not in ("image", "scan") or draw.chance(0.3) else [*rewarders, resource]
    if view == "agents" and count > 2 and draw.chance(0.3) and len({one.actions[0].name in CONTINUOUS for one in crafts}) == 1:
        env["meta_agent_groupings"] = {"team": ["Sat0", "Sat2"]}
        if draw.chance(0.5):
            env["only_retask_idle_meta_agent_members"] = True
    if any(one.options.get("variable_interval") is False for one in crafts):
        env.setdefault("max_step_duration", draw.uniform(30.0, 300.0))
    env["integrated"] = integrated
    return Case(
        seed,
        family,
        view,
        tuple(crafts),
        world_args(draw, crafts),
        env,
        scenario,
        targets,
        tuple(rewarders),
        communication(draw, count, lines),
        *actions_of(draw, steps, count, view == "single"),
    )


def single_case(draw: Draw, seed: int, steps: int, family: str, one: Craft, env: dict[str, Any], scans: bool) -> Case:
    """One satellite that scans the ground, or has no task."""
    scenario, rewarder = Part("Scenario"), Part("NoReward")
    if scans:
        scenario, rewarder = Part("UniformNadirScanning"), Part("ScanningTimeReward")
    return Case(
        seed,
        family,
        "single",
        (one,),
        world_args(draw, [one]),
        env,
        scenario,
        np.zeros((0, 4)),
        (rewarder,),
        None,
        *actions_of(draw, steps, 1, True),
    )


def setpoint_case(draw: Draw, seed: int, steps: int, family: str) -> Case:
    """One satellite that turns to attitudes."""
    orbit = draw.orbit()
    env = env_options(draw, orbit.period)
    role = draw.one("basic", "passive", "scan")
    one = craft(draw, "Sat0", role, orbit, (), env["sim_rate"])
    one = replace(
        one,
        actions=(Part("AttitudeSetpoint", (), dict(control_period=draw.duration(env["sim_rate"])) if draw.chance(0.7) else {}),),
    )
    env["integrated"] = orbit.perigee < DRAG_ALTITUDE
    return single_case(draw, seed, steps, family, one, env, role == "scan")


def thrust_case(draw: Draw, seed: int, steps: int, family: str) -> Case:
    """One satellite that changes its velocity."""
    orbit = draw.orbit()
    env = env_options(draw, orbit.period)
    role = draw.one("basic", "passive", "scan", "scan")
    one = craft(draw, "Sat0", role, orbit, (), env["sim_rate"])
    commands = {
        "basic": ("action_charge", "action_nadir_point", "action_drift"),
        "passive": ("action_nadir_point",),
        "scan": ("action_nadir_scan", "action_charge"),
    }
    options: dict[str, Any] = dict(max_dv=draw.log(0.1, 50.0), max_drift_duration=draw.uniform(100.0, 1500.0))
    if draw.chance(0.7):
        options["fsw_action"] = draw.one(*commands[role])
    one = replace(
        one,
        fsw=("MagicOrbitalManeuverFSWModel", *one.fsw),
        actions=(Part("ImpulsiveThrust", (), options),),
        sat_args=one.sat_args | dict(dv_available_init=draw.one(100.0, draw.log(1.0, 500.0))),
        observations=(*one.observations, Part("SatProperties", (dict(prop="dv_available", norm=100.0),), dict(name="fuel"))),
    )
    env["integrated"] = orbit.perigee < DRAG_ALTITUDE + 200e3 or draw.chance(0.5)
    return single_case(draw, seed, steps, family, one, env, role == "scan")


def beside(draw: Draw, chief: Orbit, distance: float, speed: float) -> Orbit:
    """The orbit of a satellite near another: the elements of a state that differs by up to a distance, m, and a speed, m/s."""
    r, v = chief.state()
    return elements_of(r + np.array(draw.vector(distance)), v + np.array(draw.vector(speed)))


def elements_of(r: Array, v: Array) -> Orbit:
    """Return the orbit of a state."""
    h = np.cross(r, v)
    node = np.cross([0.0, 0.0, 1.0], h)
    eccentric = np.cross(v, h) / MU - r / np.linalg.norm(r)
    e = float(np.linalg.norm(eccentric))
    a = 1.0 / (2.0 / np.linalg.norm(r) - v @ v / MU)
    x = node / np.linalg.norm(node)
    y = np.cross(h / np.linalg.norm(h), x)
    i = float(np.arctan2(np.hypot(h[0], h[1]), h[2]))
    perigee = float(np.arctan2(eccentric @ y, eccentric @ x))
    latitude = float(np.arctan2(r @ y, r @ x))
    return Orbit(float(a), e, (i, float(np.arctan2(node[1], node[0])), perigee, latitude - perigee), False)


def close_case(draw: Draw, seed: int, steps: int, family: str) -> Case:
    """Satellites that fly close to each other: collisions, and a largest distance from a chief."""
    count = draw.whole(2, 3)
    chief = draw.orbit()
    while chief.angles[0] < 0.1 or chief.angles[0] > 3.0:
        chief = draw.orbit()
    env = env_options(draw, chief.period)
    orbits = [chief, *(beside(draw, chief, draw.log(50.0, 2000.0), draw.log(0.01, 2.0)) for _ in range(count - 1))]
    limits = draw.chance(0.6)
    mixins = ("ConjunctionDynModel", *(["MaxRangeDynModel"] if limits else []))
    role = draw.one("passive", "basic", "scan")
    crafts = [craft(draw, f"Sat{k}", role, orbit, mixins, env["sim_rate"]) for k, orbit in enumerate(orbits)]
    radius = draw.log(1.0, 100.0)
    for k, one in enumerate(crafts):
        args = dict(conjunction_radius=radius)
        if limits and k > 0:
            args |= dict(chief_name="Sat0", max_range_radius=draw.log(500.0, 10000.0), enforce_range_on_chief=draw.chance(0.5))
        relative = Part("RelativeProperties", entries(draw, RELATIVE), dict(chief_name="Sat0"))
        crafts[k] = replace(one, sat_args=one.sat_args | args, observations=one.observations + ((relative,) if k > 0 else ()))
    env["integrated"] = chief.perigee < DRAG_ALTITUDE or draw.chance(0.5)
    scenario, rewarder = (
        (Part("UniformNadirScanning"), Part("ScanningTimeReward")) if role == "scan" else (Part("Scenario"), Part("NoReward"))
    )
    return Case(
        seed,
        family,
        draw.one("joint", "agents"),
        tuple(crafts),
        world_args(draw, crafts),
        env,
        scenario,
        np.zeros((0, 4)),
        (rewarder,),
        None,
        *actions_of(draw, steps, count, False),
    )


def inspect_case(draw: Draw, seed: int, steps: int, family: str) -> Case:
    """Inspectors that change their velocity near a spacecraft."""
    count = draw.whole(1, 2)
    chief = draw.orbit()
    while chief.angles[0] < 0.1 or chief.angles[0] > 3.0:
        chief = draw.orbit()
    sim_rate = draw.one(1.0, 5.0, 5.0)
    env = env_options(draw, chief.period) | dict(sim_rate=sim_rate)
    env.pop("generate_obs_retasking_only", None)
    env["time_limit"] = draw.uniform(2000.0, 12000.0) * (1.0 if sim_rate == 5.0 else 0.5)
    kill = dict(conjunction_radius=draw.uniform(1.0, 5.0))
    rso = Craft(
        "RSO",
        "Satellite",
        ("ConjunctionDynModel", "RSODynModel"),
        ("FSWModel",),
        (Part("SatProperties", (dict(prop="sigma_BN"),)),),
        (Part("NadirPoint", (), dict(duration=1e9)),),
        chief,
        body_args(draw) | kill,
        dict(variable_interval=False),
    )
    crafts = [rso]
    for k in range(count):
        args = body_args(draw) | actuator_args(draw, False) | kill
        args |= dict(
            storedCharge_Init=3e5,
            batteryStorageCapacity=3e5,
            basePowerDraw=0.0,
            dv_available_init=draw.log(2.0, 50.0),
            dataStorageCapacity=10**12,
            instrumentBaudRate=1.0,
            transmitterBaudRate=0.0,
            imageAttErrorRequirement=draw.one(0.1, 1.0),
            imageRateErrorRequirement=None,
            chief_name="RSO",
            max_range_radius=draw.one(1000.0, 5000.0),
            enforce_range_on_chief=draw.chance(0.5),
        )
        observations = (
            Part("SatProperties", (dict(prop="dv_available", norm=10.0), dict(prop="beta_angle"))),
            Part("RelativeProperties", entries(draw, RELATIVE, 2), dict(chief_name="RSO")),
            Part("Eclipse", (), dict(norm=5700.0)),
            Part("Time"),
        )
        thrust = Part(
            "ImpulsiveThrustHill",
            (),
            dict(
                chief_name="RSO",
                max_dv=draw.one(1.0, 0.3),
                max_drift_duration=draw.uniform(300.0, 4000.0),
                fsw_action="action_inspect_rso",
            ),
        )
        crafts.append(
            Craft(
                f"Inspector{k}",
                "Satellite",
                ("MaxRangeDynModel", "ConjunctionDynModel", "RSOInspectorDynModel"),
                ("MagicOrbitalManeuverFSWModel", "RSOInspectorFSWModel"),
                observations,
                (thrust,),
                beside(draw, chief, draw.uniform(100.0, 400.0), draw.log(0.01, 0.3)),
                args,
            )
        )
    points = Part(
        "SphericalRSO",
        (),
        dict(
            n_points=draw.whole(20, 100),
            radius=draw.uniform(0.5, 2.0),
            theta_max=np.radians(draw.uniform(20.0, 60.0)),
            range_max=draw.one(-1.0, draw.uniform(150.0, 600.0)),
            theta_solar_max=np.radians(draw.uniform(40.0, 90.0)),
        ),
    )
    inspection = Part(
        "RSOInspectionReward",
        (),
        dict(
            inspection_reward_scale=draw.uniform(0.5, 2.0),
            completion_bonus=draw.uniform(0.0, 2.0),
            completion_threshold=draw.uniform(0.3, 0.95),
            min_time_for_completion=draw.uniform(500.0, 6000.0),
        ),
    )
    fuel = Part("ResourceReward", (), dict(reward_weight=draw.uniform(0.01, 1.0), resource="dv_available"))
    env["integrated"] = True
    rewarders = (inspection, fuel) if draw.chance(0.6) else (inspection,)
    return Case(
        seed,
        family,
        "agents",
        tuple(crafts),
        world_args(draw, crafts),
        env,
        points,
        np.zeros((0, 4)),
        rewarders,
        None,
        *actions_of(draw, steps, count + 1, False),
    )


FAMILIES = {
    "image": fleet_case,
    "scan": fleet_case,
    "basic": fleet_case,
    "passive": fleet_case,
    "mixed": fleet_case,
    "thrust": thrust_case,
    "setpoint": setpoint_case,
    "inspect": inspect_case,
    "close": close_case,
}
"""How the problems of each family are drawn."""
