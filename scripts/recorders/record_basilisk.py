"""Record Basilisk, driven through bsk_rl, as numpy files that the parity tests replay.

Usage::

    python scripts/recorders/record_basilisk.py                     # every file, into tests/basilisk/recordings
    python scripts/recorders/record_basilisk.py nominal windows     # only these
    python scripts/recorders/record_basilisk.py --list

See ``recording.py`` for what it needs. Nothing is random beyond the seeds below: every initial condition is drawn here,
passed to the simulator explicitly and stored in the file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import gymnasium as gym
import numpy as np
from bsk_rl import act, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw
from numpy.typing import NDArray
from recording import COLUMNS as STATE_COLUMNS
from recording import Array, boundary_state, orbit_state, random_utc, record_files, sensitivity, streams, versions

ORBIT_PERIOD = 5700.0  # [s] the paper's normalization
EPISODE = 5 * ORBIT_PERIOD
STORAGE = 5000 * 8e6  # [bit]
BATTERY = 200 * 3600.0  # [W s]
AHEAD_LIMIT = 36000.0  # [s] how long the look-ahead queries continue; windows are generated for ``EPISODE`` at reset
WHEEL_LIMIT = 6000.0  # [rpm] speed at which the simulated wheel stops accepting torque
PAPER_MODES: tuple[tuple[str, float], ...] = (("Scan", 180.0), ("Charge", 120.0), ("Downlink", 60.0), ("Desat", 60.0))
ALL_MODES = (*PAPER_MODES, ("NadirPoint", 90.0), ("Drift", 45.5))
FIXED: dict[str, Any] = {
    "dataStorageCapacity": STORAGE,
    "instrumentBaudRate": 0.5 * 8e6,
    "transmitterBaudRate": -50 * 8e6,
    "batteryStorageCapacity": BATTERY,
    "basePowerDraw": -10.0,
    "instrumentPowerDraw": -30.0,
    "transmitterPowerDraw": -25.0,
    "thrusterPowerDraw": -80.0,
    "panelArea": 0.25,
    "imageAttErrorRequirement": 0.1,
    "imageRateErrorRequirement": 0.1,
    "maxWheelSpeed": WHEEL_LIMIT,
    "desatAttitude": "nadir",
}
COLUMNS = STATE_COLUMNS + [f"PN{i}{j}" for i in range(3) for j in range(3)] + ["sunx", "suny", "sunz"]


@dataclass(frozen=True)
class Variant:
    """One file of episodes: the distribution of its initial conditions, its environment and its policy.

    Attributes:
        seed: Seed of every draw; with the episode's index it gives one stream for the start and one for the actions.
        episodes: Number of episodes.
        time_limit: [s] Length of a surviving episode.
        weights: Dirichlet concentration per action; each episode draws its own action probabilities.
        repeat: Probability of repeating the previous action.
        sim_rate: [s] Tick length.
        modes: Action names and durations [s].
        fixed: Satellite arguments on top of ``FIXED``.
        semi_major_axis: [km].
        eccentricity: [-].
        wheels: [rpm] Range of the initial wheel speeds' magnitude.
        storage: Range of the initial storage level, as a fraction of capacity.
        battery: Range of the initial charge, as a fraction of ``BATTERY``.
        torque: [N m] Standard deviation per axis of the constant disturbance torque.
    """

    seed: int
    episodes: int = 2
    time_limit: float = ORBIT_PERIOD
    weights: tuple[float, ...] = (3.0, 3.0, 2.0, 1.0)
    repeat: float = 0.0
    sim_rate: float = 1.0
    modes: tuple[tuple[str, float], ...] = PAPER_MODES
    fixed: dict[str, Any] = field(default_factory=dict)
    semi_major_axis: float = 6871.0
    eccentricity: float = 0.0
    wheels: tuple[float, float] = (0.0, 3000.0)
    storage: tuple[float, float] = (0.0, 0.8)
    battery: tuple[float, float] = (0.5, 1.0)
    torque: float = 1e-4


# Seeds were chosen so that episodes are well conditioned (see ``sensitivity``) and so that some of them fail.
DESATS = (2.0, 3.0, 1.0, 6.0)
VARIANTS: dict[str, Variant] = {
    "nominal": Variant(1901, 3, EPISODE, weights=(4.0, 9.0, 3.0, 1.0), battery=(0.3, 1.0)),
    "low": Variant(102, time_limit=2 * ORBIT_PERIOD, semi_major_axis=6378.1366 + 270, eccentricity=1e-4),
    "eccentric": Variant(103, time_limit=2 * ORBIT_PERIOD, semi_major_axis=7500.0, eccentricity=0.08),
    "saturation": Variant(
        404,
        weights=(2.0, 2.0, 1.0, 4.0),
        fixed={"maxWheelSpeed": float("inf"), "batteryStorageCapacity": 5 * BATTERY},
        wheels=(5985.0, 5995.0),
        battery=(2.0, 4.0),
        torque=5e-4,
    ),
    "full": Variant(105, weights=(12.0, 2.0, 6.0, 1.0), storage=(0.97, 0.97), battery=(0.7, 1.0)),
    "desat_sun": Variant(106, fixed={"desatAttitude": "sun"}, weights=DESATS),
    "desat_none": Variant(107, fixed={"desatAttitude": None}, weights=DESATS),
    "integral": Variant(508, fixed={"Ki": 1e-4, "batteryStorageCapacity": 5 * BATTERY}, battery=(2.0, 4.0)),
    "integral_clip": Variant(
        111,
        1,
        ORBIT_PERIOD / 2,
        fixed={"K": 2.0, "P": 2.0, "Ki": 0.1, "u_max": 0.5, "batteryStorageCapacity": 5 * BATTERY},
        battery=(2.0, 4.0),
    ),
    "half_second": Variant(109, 1, sim_rate=0.5),
    "two_seconds": Variant(710, 1, sim_rate=2.0),
    "all_modes": Variant(613, modes=ALL_MODES, weights=(2.0,) * 6, repeat=0.2),
}
TICKS = Variant(11, 1, 1500.0, weights=(2.0, 2.0, 2.0, 6.0))
TICKS_INDEX = 11  # the first episodes of this seed meet no station or no penumbra


class ScannerDyn(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    """Continuous imager with downlink that also reports its two pointing errors [rad]."""

    @property
    def instrument_pointing_error(self) -> float:
        """Angle between the instrument and the direction to the Earth's center."""
        nadir_P = -self.r_BN_P / np.linalg.norm(self.r_BN_P)
        return float(np.arccos(np.clip(nadir_P @ self.satellite.fsw.c_hat_P, -1.0, 1.0)))

    @property
    def solar_pointing_error(self) -> float:
        """Angle between the solar array and the direction from the Earth to the Sun."""
        sun_N = sun_position(self.world)
        array_N = self.BN.T @ self.satellite.sat_args["nHat_B"]
        return float(np.arccos(np.clip(array_N @ (sun_N / np.linalg.norm(sun_N)), -1.0, 1.0)))


def scanner_class(modes: tuple[tuple[str, float], ...], observations: list[Any]) -> type[sats.AccessSatellite]:
    """A new satellite class, because bsk_rl caches what it composes on the class."""
    attributes = {
        "observation_spec": observations,
        "action_spec": [getattr(act, name)(duration=duration) for name, duration in modes],
        "dyn_type": ScannerDyn,
        "fsw_type": fsw.ContinuousImagingFSWModel,
    }
    return type("Scanner", (sats.AccessSatellite,), attributes)


def paper_observations() -> list[Any]:
    """The twelve observations of the paper's scanning environment."""
    station = [{"prop": "opportunity_open", "norm": ORBIT_PERIOD}, {"prop": "opportunity_close", "norm": ORBIT_PERIOD}]
    return [
        obs.SatProperties(
            {"prop": "storage_level_fraction"},
            {"prop": "battery_charge_fraction"},
            {"prop": "wheel_speeds_fraction"},
            {"prop": "instrument_pointing_error", "norm": np.pi},
            {"prop": "solar_pointing_error", "norm": np.pi},
        ),
        obs.OpportunityProperties(*station, type="ground_station", n_ahead_observe=1),
        obs.Eclipse(norm=ORBIT_PERIOD),
        obs.Time(),
    ]


def sun_position(world: Any) -> Array:
    """Sun relative to the Earth, inertial axes [m]."""
    return np.array(world.gravFactory.spiceObject.planetStateOutMsgs[world.sun_index].read().PositionVector)


def draw_initial(rng: np.random.Generator, variant: Variant) -> dict[str, Any]:
    """Everything that bsk_rl would otherwise randomize at reset, as JSON-ready satellite and world arguments."""
    angles = rng.uniform(0.0, (np.pi, 2 * np.pi, 2 * np.pi, 2 * np.pi))
    return {
        "utc_init": random_utc(rng),
        **orbit_state(variant.semi_major_axis, variant.eccentricity, angles),
        "sigma_init": rng.uniform(0.0, 1.0, 3).tolist(),
        "omega_init": rng.uniform(-1e-3, 1e-3, 3).tolist(),
        "wheelSpeeds": (rng.choice((-1.0, 1.0), 3) * rng.uniform(*variant.wheels, 3)).tolist(),
        "disturbance_vector": rng.normal(scale=variant.torque, size=3).tolist(),
        "storageInit": float(np.floor(rng.uniform(*variant.storage) * STORAGE)),
        "storedCharge_Init": float(rng.uniform(*variant.battery) * BATTERY),
    }


def make_env(variant: Variant, initial: dict[str, Any], observations: list[Any], **satellite_options: Any) -> gym.Env:
    """The single-satellite environment, with every initial condition pinned."""
    pinned = {key: value for key, value in initial.items() if key != "utc_init"}
    satellite = scanner_class(variant.modes, observations)(
        "Scanner1", sat_args={**FIXED, **variant.fixed, **pinned, "oe": None}, **satellite_options
    )
    return gym.make(
        "SatelliteTasking-v1",
        satellite=satellite,
        scenario=scene.UniformNadirScanning(value_per_second=1 / EPISODE),
        rewarder=data.ScanningTimeReward(),
        time_limit=variant.time_limit,
        sim_rate=variant.sim_rate,
        failure_penalty=-1.0,
        terminate_on_time_limit=True,
        world_args={"utc_init": initial["utc_init"]},
        log_level="ERROR",
        disable_env_checker=True,
    )


def full_state(env: gym.Env) -> Array:
    """The row of ``COLUMNS`` that the messages hold while the simulation is paused."""
    world = env.unwrapped.simulator.world
    return np.concatenate([boundary_state(env), np.ravel(world.PN), sun_position(world)])


class TickLog:
    """Recorders that run last in every dynamics tick, when all that the flight software will read is written."""

    def __init__(self, env: gym.Env) -> None:
        """Attach to an environment that has just been reset (its tick at t = 0 is not recorded)."""
        simulator, dynamics = env.unwrapped.simulator, env.unwrapped.satellite.dynamics
        stations = [station.accessOutMsgs[-1] for station in simulator.world.groundStations]
        self.state = dynamics.scObject.scStateOutMsg.recorder()
        self.wheels = [message.recorder() for message in dynamics.rwStateEffector.rwOutMsgs]
        self.battery = dynamics.powerMonitor.batPowerOutMsg.recorder()
        self.storage = dynamics.storageUnit.storageUnitDataOutMsg.recorder()
        self.eclipse = simulator.world.eclipseObject.eclipseOutMsgs[dynamics.eclipse_index].recorder()
        self.access = [message.recorder() for message in stations]
        for recorder in (self.state, *self.wheels, self.battery, self.storage, self.eclipse, *self.access):
            simulator.AddModelToTask(dynamics.task_name, recorder, ModelPriority=-10)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All ticks so far, one row each."""
        return {
            "t": np.array(self.state.times()) * 1e-9,
            "r": np.array(self.state.r_BN_N),
            "v": np.array(self.state.v_BN_N),
            "sigma": np.array(self.state.sigma_BN),
            "omega": np.array(self.state.omega_BN_B),
            "Omega": np.stack([wheel.Omega for wheel in self.wheels], 1),
            "u": np.stack([wheel.u_current for wheel in self.wheels], 1),
            "battery": np.array(self.battery.storageLevel),
            "storage": np.array(self.storage.storageLevel),
            "illum": np.array(self.eclipse.shadowFactor),
            "access": np.stack([station.hasAccess for station in self.access], 1).astype(np.uint8),
        }


@dataclass
class Flight:
    """An episode: rows at decision boundaries, rows at ticks, and the complete satellite arguments.

    ``boundary["obs"]`` and ``boundary["state"]`` have one row more than the other entries.
    """

    boundary: dict[str, NDArray[Any]]
    ticks: dict[str, NDArray[Any]]
    arguments: dict[str, Any]

    def saturated(self) -> int:
        """Ticks at which at least one wheel was at its speed limit and rejected torque."""
        at_limit = np.abs(self.ticks["Omega"]) >= WHEEL_LIMIT * 2 * np.pi / 60
        return int(((self.ticks["u"] == 0) & at_limit).any(1).sum())

    def summary(self) -> str:
        """Length and end, for the log."""
        last = self.boundary["state"][-1]
        reason = "time limit" if self.boundary["truncated"][-1] else "failure"
        levels = f"battery {last[16] / BATTERY:.2f}, storage {last[17] / STORAGE:.3f}"
        return f"{len(self.boundary['action'])} steps, {reason} at {last[0]:.1f} s, {levels}"


def fly(variant: Variant, initial: dict[str, Any], rng: np.random.Generator) -> Flight:
    """Random actions from ``rng`` until the episode ends."""
    env = make_env(variant, initial, paper_observations())
    observation, _ = env.reset(seed=variant.seed)
    ticks = TickLog(env)
    log: dict[str, list[Any]] = {"obs": [observation], "state": [full_state(env)]}
    log |= {key: [] for key in ("reward", "action", "terminated", "truncated")}
    probability, action, done = rng.dirichlet(variant.weights), -1, False
    while not done:
        if action < 0 or rng.random() >= variant.repeat:
            action = int(rng.choice(len(variant.modes), p=probability))
        observation, reward, terminated, truncated, _ = env.step(action)
        row = (observation, full_state(env), reward, action, terminated, truncated)
        for key, value in zip(log, row, strict=True):
            log[key].append(value)
        done = terminated or truncated
    arguments = env.unwrapped.satellite.sat_args
    env.close()
    return Flight({key: np.array(rows) for key, rows in log.items()}, ticks.arrays(), arguments)


def conditioning(variant: Variant, index: int, initial: dict[str, Any], flight: Flight) -> Array:
    """See :func:`recording.sensitivity`."""

    def again(nudged: dict[str, Any]) -> Array:
        return fly(variant, nudged, streams(variant.seed, index)[1]).boundary["state"]

    return sensitivity(again, initial, flight.boundary["state"])


def describe(variant: Variant) -> dict[str, str]:
    """JSON entries that make a file readable on its own."""
    environment = {key: value for key, value in asdict(variant).items() if key in ("time_limit", "sim_rate", "modes", "seed")}
    environment |= {"failure_penalty": -1.0, "terminate_on_time_limit": True, "value_per_second": 1 / EPISODE}
    entries = {
        "fixed": {**FIXED, **variant.fixed},
        "env": environment,
        "columns": COLUMNS,
        "versions": versions(),
    }
    return {key: json.dumps(value) for key, value in entries.items()}


def record_episodes(name: str) -> dict[str, Any]:
    """Decision-boundary episodes of one variant."""
    variant, initials, flights, changes = VARIANTS[name], [], [], []
    for index in range(variant.episodes):
        start, choices = streams(variant.seed, index)
        initials.append(draw_initial(start, variant))
        flights.append(fly(variant, initials[-1], choices))
        changes.append(conditioning(variant, index, initials[-1], flights[-1]))
        print(f"  {name}[{index}] {flights[-1].summary()}, sigma sensitivity {changes[-1][7:10].max():.0e}", flush=True)
    return {
        "ic": json.dumps(initials),
        "length": np.array([len(flight.boundary["action"]) for flight in flights]),
        "saturated_ticks": np.array([flight.saturated() for flight in flights]),
        "sensitivity": np.stack(changes),
        **{key: np.concatenate([flight.boundary[key] for flight in flights]) for key in flights[0].boundary},
        **describe(variant),
    }


def record_ticks(_: str) -> dict[str, Any]:
    """Every tick of one episode, with the actions that caused it."""
    start, choices = streams(TICKS.seed, TICKS_INDEX)
    flight = fly(TICKS, draw_initial(start, TICKS), choices)
    paused, ticks = flight.boundary["state"], flight.ticks
    rows = np.searchsorted(ticks["t"], paused[1:, 0] - 1e-6)
    assert np.array_equal(ticks["r"][rows], paused[1:, 1:4]), "ticks and decision boundaries disagree"
    assert np.array_equal(ticks["storage"][rows], paused[1:, 17]), "ticks and decision boundaries disagree"
    names = [TICKS.modes[action][0] for action in flight.boundary["action"]]
    spans = list(zip(paused[:-1, 0].tolist(), paused[1:, 0].tolist(), names, strict=True))
    init = json.dumps(flight.arguments, default=np.ndarray.tolist)
    return {"init": init, "actions": json.dumps(spans), **ticks, **describe(TICKS)}


def window_initials() -> list[dict[str, Any]]:
    """The initial conditions of nominal.npz, then an orbit without eclipse and an equatorial one."""
    nominal = VARIANTS["nominal"]
    initials = [draw_initial(streams(nominal.seed, index)[0], nominal) for index in range(nominal.episodes)]
    dawn_dusk = orbit_state(6871.0, 1e-3, np.radians([97.5, 90.0, 40.0, 10.0]))
    equatorial = orbit_state(6871.0, 1e-3, np.radians([0.0, 0.0, 70.0, 200.0]))
    initials.append({**initials[0], **dawn_dusk, "utc_init": "2019 MAR 21 06:30:00.000 (UTC)"})
    initials.append({**initials[0], **equatorial, "utc_init": "2012 DEC 21 17:05:30.500 (UTC)"})
    return initials


def query_eclipses(initial: dict[str, Any], times: Array) -> tuple[list[tuple[int, float, float]], Array]:
    """Windows that reset generates (station, open, close) and the eclipse answers, asked in increasing order."""
    env = make_env(VARIANTS["nominal"], initial, [obs.Time()])
    env.reset(seed=0)
    satellite = env.unwrapped.satellite
    names = [location["object"] for location in satellite.locations_for_access_checking]
    windows = [(names.index(item["object"]), *item["window"]) for item in satellite.opportunities]
    answers = np.array([satellite.trajectory.next_eclipse(t) for t in times])
    env.close()
    return windows, answers


def look_ahead(initial: dict[str, Any], times: Array) -> Array:
    """The next station window (open, close) at each time, on an environment that flies there and asks nothing else."""
    legs = (("Charge", float(times[0])), ("Charge", float(times[1] - times[0])))
    variant = replace(VARIANTS["nominal"], modes=legs, time_limit=AHEAD_LIMIT)
    env = make_env(variant, initial, [obs.Time()], initial_generation_duration=EPISODE)
    env.reset(seed=0)
    satellite, answers = env.unwrapped.satellite, []
    for index, t in enumerate(times):
        env.step(min(index, 1))
        assert abs(env.unwrapped.simulator.sim_time - t) < 1e-6, "the satellite did not reach the time of the query"
        answers.append(satellite.find_next_opportunities(1, types="ground_station")[0]["window"])
    env.close()
    return np.array(answers)


def record_windows(_: str) -> dict[str, Any]:
    """Station windows, eclipse answers and look-ahead for five orbits."""
    initials, windows, answers, ahead = window_initials(), [], [], []
    query_times, ahead_times = np.arange(0.0, 28500.0, 61.0), np.arange(28020.0, AHEAD_LIMIT, 60.0)
    for index, initial in enumerate(initials):
        found, eclipses = query_eclipses(initial, query_times)
        windows += [(index, *row) for row in found]
        answers.append(eclipses)
        ahead.append(look_ahead(initial, ahead_times))
        print(f"  windows[{index}] {len(found)} windows, {len(np.unique(eclipses))} eclipse transitions", flush=True)
    episode, station, opens, closes = (np.array(column) for column in zip(*windows, strict=True))
    columns = {"window_orbit": episode, "window_station": station, "window_open": opens, "window_close": closes}
    return {
        "ic": json.dumps(initials),
        **columns,
        "eclipse_time": query_times,
        "eclipse_start": np.stack(answers)[..., 0],
        "eclipse_end": np.stack(answers)[..., 1],
        "ahead_time": ahead_times,
        "ahead_open": np.stack(ahead)[..., 0],
        "ahead_close": np.stack(ahead)[..., 1],
        "ahead_env": json.dumps({"time_limit": AHEAD_LIMIT, "initial_generation_duration": EPISODE}),
        **describe(VARIANTS["nominal"]),
    }


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = {
    **dict.fromkeys(VARIANTS, record_episodes),
    "ticks_seed11": record_ticks,
    "windows": record_windows,
}


if __name__ == "__main__":
    record_files(RECORDERS)
