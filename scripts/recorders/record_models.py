"""Record spacecraft of bsk_rl's smaller models, as numpy files that the tests replay.

Usage::

    python scripts/recorders/record_models.py                    # every file, into tests/basilisk/recordings
    python scripts/recorders/record_models.py models_pointing    # only this one
    python scripts/recorders/record_models.py --list

See ``recording.py`` for what it needs. Spacecraft without actuators, whose attitude is imposed, alone and with one with wheels;
a scanner without ground stations; and the default arguments of models.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from bsk_rl import NO_ACTION, GeneralSatelliteTasking, act, data, obs, sats, scene
from bsk_rl.sim import dyn, fsw, world
from bsk_rl.utils.functional import compose_types
from recording import Array, orbit_state, random_utc, record_files, streams, versions

STEPS_OF_ONE = ("NadirPoint", 1.0), ("Drift", 1.0)
POINTING = (*STEPS_OF_ONE, ("NadirPoint", 11.0), ("Drift", 7.0))
SCANNING = ("Scan", 60.0), ("Charge", 60.0), ("Downlink", 60.0)


@dataclass
class Kind:
    """A satellite: its models, its actions with their durations, s, and the properties that it observes."""

    dyn: tuple[str, ...]
    fsw: tuple[str, ...]
    modes: tuple[tuple[str, float], ...] = POINTING
    properties: tuple[str, ...] = ("sigma_BN", "omega_BN_B")
    tasked: float = 1.0
    """Probability that an action is chosen for it where a decision is made."""


@dataclass
class Variant:
    """A file: its satellites, their arguments in addition to those that are drawn, and the length of its episodes."""

    satellites: tuple[Kind, ...]
    seed: int
    episodes: int = 2
    steps: int = 40
    sim_rate: float = 1.0
    fixed: dict[str, Any] = field(default_factory=dict)


STORE = {"storageInit": 2_345_678, "dataStorageCapacity": 400_000_000}

BARE = Kind(("DynamicsModel",), ("FSWModel",))
LIT = Kind(("EclipseDynModel", "DisturbanceTorqueDynModel"), ("FSWModel",), properties=("omega_BH_H", "beta_angle"))
SPINNING = Kind(("BasicDynamicsModel",), ("FSWModel",), properties=("sigma_BN", "wheel_speeds", "battery_charge_fraction"))
WHEELED = Kind(
    ("BasicDynamicsModel",),
    ("BasicFSWModel",),
    modes=(("NadirPoint", 30.0), ("Charge", 24.0), ("Drift", 10.0)),
    properties=("sigma_BN", "omega_BN_B", "wheel_speeds"),
)
SCANNER = Kind(
    ("ContinuousImagingDynModel",),
    ("ContinuousImagingFSWModel",),
    modes=SCANNING,
    properties=("storage_level_fraction", "battery_charge_fraction", "wheel_speeds_fraction"),
)

VARIANTS = {
    "models_pointing": Variant((BARE,), 1401, steps=16),
    "models_spinning": Variant((SPINNING,), 1402, episodes=1, steps=12),
    "models_passive_crew": Variant((LIT, replace(BARE, tasked=0.0), WHEELED), 1403, steps=12, sim_rate=2.0),
    "models_scanner": Variant((SCANNER,), 1406, steps=10, sim_rate=2.0, fixed=STORE),
}


def satellite_class(kind: Kind) -> type[sats.Satellite]:
    """A new class, because bsk_rl caches what it composes on the class."""
    attributes = {
        "observation_spec": [obs.SatProperties(*({"prop": name} for name in kind.properties)), obs.Time()],
        "action_spec": [getattr(act, name)(f"{name}_{k}", duration=duration) for k, (name, duration) in enumerate(kind.modes)],
        "dyn_type": tuple(getattr(dyn, name) for name in kind.dyn),
        "fsw_type": tuple(getattr(fsw, name) for name in kind.fsw),
    }
    return type("Recorded", (sats.Satellite,), attributes)


def draw_initial(rng: np.random.Generator, kind: Kind) -> dict[str, Any]:
    """Arguments of a satellite that bsk_rl would randomize, as far as its models have them."""
    drawn = {
        **orbit_state(6871.0, 1e-3, rng.uniform(0.0, (np.pi, 2 * np.pi, 2 * np.pi, 2 * np.pi))),
        "sigma_init": rng.uniform(0.0, 0.5, 3).tolist(),
        "omega_init": rng.uniform(-1e-3, 1e-3, 3).tolist(),
        "wheelSpeeds": rng.uniform(-500.0, 500.0, 3).tolist(),
        "disturbance_vector": rng.normal(scale=1e-4, size=3).tolist(),
        "storedCharge_Init": float(rng.uniform(0.4, 0.9) * 288000.0),
    }
    known = satellite_class(kind).default_sat_args()
    return {name: value for name, value in drawn.items() if name in known}


def make_env(variant: Variant, utc: str, initial: list[dict[str, Any]]) -> GeneralSatelliteTasking:
    """The environment, with every initial condition pinned."""
    satellites = []
    for k, (kind, own) in enumerate(zip(variant.satellites, initial, strict=True)):
        satellites.append(satellite_class(kind)(f"Sat{k}", {**variant.fixed, **own, "oe": None}))
    return GeneralSatelliteTasking(
        satellites,
        scenario=scene.UniformNadirScanning(),
        rewarder=data.ScanningTimeReward() if SCANNER in variant.satellites else data.NoReward(),
        world_args={"utc_init": utc},
        sim_rate=variant.sim_rate,
        log_level="ERROR",
    )


def state_of(env: GeneralSatelliteTasking) -> Array:
    """Time, position, velocity, attitude and rate of every satellite, [S, 13]."""
    models = [satellite.dynamics for satellite in env.satellites]
    rows = [np.concatenate([d.r_BN_N, d.v_BN_N, d.sigma_BN, d.omega_BN_B]) for d in models]
    return np.array([[env.simulator.sim_time, *row] for row in rows])


def observed(env: GeneralSatelliteTasking) -> Array:
    """Observations of the satellites, one after another."""
    return np.concatenate([satellite.get_obs() for satellite in env.satellites])


def fly(variant: Variant, index: int) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """One episode: what it starts from, and its rows."""
    start, choices = streams(variant.seed, index)
    utc, initial = random_utc(start), [draw_initial(start, kind) for kind in variant.satellites]
    env = make_env(variant, utc, initial)
    env.reset(seed=index)
    log: dict[str, list[Any]] = {"obs": [observed(env)], "state": [state_of(env)], "action": [], "reward": []}
    for _ in range(variant.steps):
        action = [
            int(choices.integers(len(kind.modes))) if choices.random() < kind.tasked else NO_ACTION
            for kind, satellite in zip(variant.satellites, env.satellites, strict=True)
        ]
        _, reward, *_ = env.step(tuple(action))
        log["obs"].append(observed(env))
        log["state"].append(state_of(env))
        log["action"].append([-1 if choice is NO_ACTION else choice for choice in action])
        log["reward"].append(reward)
    env.close()
    return {"utc_init": utc, "satellites": initial}, log


def record(name: str) -> dict[str, Any]:
    """All episodes of a file; as many steps in each."""
    variant = VARIANTS[name]
    starts, logs = zip(*(fly(variant, index) for index in range(variant.episodes)), strict=True)
    arrays = {key: np.stack([np.array(log[key]) for log in logs]) for key in logs[0]}
    print(f"  {name}: {arrays['state'][:, -1, 0, 0].tolist()} s", flush=True)
    texts = {"ic": starts, "env": asdict(variant), "versions": versions()}
    return {**{key: json.dumps(value) for key, value in texts.items()}, **arrays}


COMPOSED = (
    (("DynamicsModel",), ("FSWModel",)),
    (("EclipseDynModel", "LOSCommDynModel"), ("FSWModel",)),
    (("AtmosphericDragDynModel", "DisturbanceTorqueDynModel"), ("FSWModel",)),
    (("BasicDynamicsModel",), ("BasicFSWModel",)),
    (("BasicDynamicsModel",), ("SteeringFSWModel",)),
    (("ContinuousImagingDynModel", "GroundStationDynModel"), ("ContinuousImagingFSWModel",)),
    (("GroundStationDynModel", "ContinuousImagingDynModel"), ("SteeringFSWModel", "ContinuousImagingFSWModel")),
    (("FullFeaturedDynModel",), ("SteeringImagerFSWModel",)),
    (("ImagingDynModel", "LOSCommDynModel"), ("ImagingFSWModel", "SteeringFSWModel")),
)
WORLDS = (("WorldModel",), ("EclipseWorldModel", "GroundStationWorldModel"), ("AtmosphereWorldModel",))


def plain(value: Any) -> Any:
    """A default as JSON; None stands for one that is drawn."""
    return None if callable(value) else np.asarray(value).tolist()


def record_defaults(_: str) -> dict[str, Any]:
    """Default arguments of composed models, the names of the classes from which they inherit, and arguments of worlds."""
    found = []
    for dynamics, software in COMPOSED:
        cls = satellite_class(Kind(dynamics, software))
        orders = [[base.__name__ for base in model.__mro__[1:]] for model in (cls.get_dyn_type(), cls.get_fsw_type())]
        sat_args = {name: plain(value) for name, value in cls.default_sat_args().items() if name != "utc_init"}
        found.append({"dyn": dynamics, "fsw": software, "orders": orders, "sat_args": sat_args})
    worlds = []
    for names in WORLDS:
        model = compose_types(*(getattr(world, name) for name in names), world.WorldModelABC, name="World")
        worlds.append({"world": names, "world_args": {name: plain(value) for name, value in model.default_world_args().items()}})
    texts = {"models": found, "worlds": worlds, "versions": versions()}
    return {key: json.dumps(value) for key, value in texts.items()}


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = {**dict.fromkeys(VARIANTS, record), "models_defaults": record_defaults}


if __name__ == "__main__":
    record_files(RECORDERS)
