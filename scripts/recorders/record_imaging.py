"""Record point-imaging episodes of Basilisk, driven through bsk_rl, as numpy files that the parity tests replay.

Usage::

    python scripts/recorders/record_imaging.py                      # every file, into tests/basilisk/recordings
    python scripts/recorders/record_imaging.py imaging_full         # only this one
    python scripts/recorders/record_imaging.py --list

See ``recording.py`` for what it needs. Initial conditions are drawn here, passed explicitly and stored; so are the actions.
Targets come from a seed and numpy's frozen generator (see ``make_targets``), and only the seed is stored.

What bsk_rl 1.3.8 does, and the recordings therefore avoid or contain:

* A scenario reads ``imageTargetMinimumElevation`` from the arguments that were given, so it must be a constant.
* A query that finds no target at all raises RuntimeError; episodes must leave some unimaged.
* The search for the highest point of a pass is not bounded by the pass and loses some on eccentric orbits: orbits are circular.
* A satellite class keeps the models of its parent once they have been composed: every episode makes its own class.
* Target ids contain the address of an object, so that the order of sets changes from run to run; nothing recorded depends on it.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from bsk_rl import SatelliteTasking, act, data, obs, sats, scene
from bsk_rl.scene.targets import Target
from bsk_rl.sim import dyn, fsw
from imaging_variants import (
    BATTERY,
    EARTH_RADIUS,
    FIXED,
    LIMITED_PROPERTIES,
    MODES,
    ORBIT_PERIOD,
    POINTING,
    SATELLITE_PROPERTIES,
    STATION_PROPERTIES,
    STEERING,
    TARGET_PROPERTIES,
    VARIANTS,
    Variant,
)
from limited_instruments import (
    ELEVATION,
    LEAST_SUN,
    MOST_SUN,
    REACH,
    LimitedImager,
    LitDynModel,
    UniqueImages,
    kind_of,
)
from numpy.typing import NDArray
from recording import COLUMNS, Array, boundary_state, orbit_state, random_utc, record_files, sensitivity, streams, versions

RESOLUTION = 2.0**-24  # observations are rounded to multiples of this, so that files are small


def make_targets(seed: int, count: int) -> tuple[Array, Array]:
    """Positions [count, 3] m, uniform on the sphere, and priorities [count] of targets."""
    rng = np.random.RandomState(seed)  # its streams never change, unlike default_rng's
    r_LP_P = rng.normal(size=(count, 3))
    r_LP_P *= EARTH_RADIUS / np.sqrt((r_LP_P**2).sum(1, keepdims=True))
    return r_LP_P, rng.uniform(size=count)


class SeededTargets(scene.UniformTargets):
    """The targets of ``make_targets``, named by their number."""

    def __init__(self, seed: int, count: int) -> None:
        """See ``make_targets``."""
        super().__init__(count)
        self.seed = seed

    def regenerate_targets(self) -> None:
        """Called by bsk_rl at reset."""
        rows = zip(*make_targets(self.seed, self._n_targets), strict=True)
        self.targets = [Target(str(number), r_LP_P, float(priority)) for number, (r_LP_P, priority) in enumerate(rows)]


def entries(properties: tuple[tuple[str, float], ...]) -> list[dict[str, Any]]:
    """Properties as bsk_rl wants them."""
    return [{"prop": name, "norm": norm} for name, norm in properties]


class ImageWith(act.Image):
    """Images with one of several instruments: it changes the parameters of Basilisk's modules when an action begins."""

    def __init__(self, variant: Variant, instrument: str) -> None:
        """Offer the next targets for an instrument."""
        super().__init__(variant.ahead, variant.max_duration, f"action_image_{instrument}")
        self.instrument, self.own = instrument, variant.instruments[instrument]
        self.arguments = {**POINTING, **FIXED, **variant.fixed, **self.own}

    def image(self, target: Any, prev_action_key: str | None = None) -> str:
        """See the base class; the same target with another instrument is another action."""
        args, sim, flight = self.arguments, self.satellite.dynamics, self.satellite.fsw
        flight.locPoint.pHat_B = args["inst_pHat_B"]
        flight.insControl.attErrTolerance = args["imageAttErrorRequirement"]
        flight.insControl.rateErrTolerance = args["imageRateErrorRequirement"]
        sim.imagingTarget.minimumElevation = args[ELEVATION]
        sim.imagingTarget.maximumRange = args.get(REACH, -1.0)
        if isinstance(sim, LitDynModel):
            sim.gate.limits = args.get(LEAST_SUN, -np.pi), args.get(MOST_SUN, np.pi)
            flight.insControl.locationAccessInMsg.subscribeTo(sim.gate.passedOutMsg)
            self.satellite.target_types = kind_of(self.instrument, self.own)
        sim.instrument.nodeBaudRate = args["instrumentBaudRate"] / sim.dyn_rate
        sim.instrumentPowerSink.nodePowerOut = args["instrumentPowerDraw"]
        mine = prev_action_key is not None and prev_action_key.endswith(f"@{self.instrument}")
        return f"{super().image(target, prev_action_key.rpartition('@')[0] if mine else None)}@{self.instrument}"


def image_actions(variant: Variant) -> list[act.Image]:
    """An entry for images, or one for each instrument."""
    if not variant.instruments:
        return [act.Image(n_ahead_image=variant.ahead, max_duration=variant.max_duration)]
    return [ImageWith(variant, instrument) for instrument in variant.instruments]


def limited(variant: Variant) -> dict[str, dict[str, Any]]:
    """Arguments of the instruments whose limits give them separate windows, by the type of these windows."""
    kinds = {kind_of(name, own): own for name, own in variant.instruments.items()}
    return {kind: own for kind, own in kinds.items() if kind != "target"}


def imager_class(variant: Variant) -> type[sats.ImagingSatellite]:
    """A new satellite class, because bsk_rl caches what it composes on the class."""
    observations = [
        obs.SatProperties(*entries(SATELLITE_PROPERTIES)),
        obs.OpportunityProperties(*entries(TARGET_PROPERTIES), type="target", n_ahead_observe=variant.ahead),
        obs.Eclipse(norm=ORBIT_PERIOD),
        obs.Time(),
    ]
    if variant.stations:
        seen = obs.OpportunityProperties(*entries(STATION_PROPERTIES), type="ground_station", n_ahead_observe=variant.stations)
        observations.insert(2, seen)
    for kind in limited(variant):
        seen = obs.OpportunityProperties(*entries(LIMITED_PROPERTIES), type=kind, n_ahead_observe=variant.ahead, name=kind)
        observations.insert(-2, seen)
    modes = [getattr(act, name)(duration=duration) for name, duration in MODES]
    attributes = {
        "observation_spec": observations,
        "action_spec": [*modes, *image_actions(variant)],
        "dyn_type": LitDynModel if limited(variant) else dyn.GroundStationDynModel,
        "fsw_type": fsw.SteeringImagerFSWModel if variant.steering else fsw.ImagingFSWModel,
    }
    bases = (LimitedImager,) if limited(variant) else (sats.ImagingSatellite,)
    return type("Imager", bases, attributes | ({"own": limited(variant)} if limited(variant) else {}))


def draw_initial(rng: np.random.Generator, variant: Variant, position: int) -> dict[str, Any]:
    """Everything that differs from episode to episode, JSON-ready; ``position`` is the episode's place in the file."""
    angles = rng.uniform(0.0, (np.pi, 2 * np.pi, 2 * np.pi, 2 * np.pi))
    if variant.inclination is not None:
        angles[0] = np.radians(variant.inclination)
    return {
        "utc_init": random_utc(rng),
        **orbit_state(6871.0, 0.0, angles),
        "sigma_init": rng.uniform(0.0, 1.0, 3).tolist(),
        "omega_init": rng.uniform(-1e-3, 1e-3, 3).tolist(),
        "wheelSpeeds": rng.uniform(-1500.0, 1500.0, 3).tolist(),
        "disturbance_vector": rng.normal(scale=1e-4, size=3).tolist(),
        "storageInit": variant.stored,
        "storedCharge_Init": float(rng.uniform(0.5, 1.0) * BATTERY),
        "target_seed": int(rng.integers(2**31)),
        "time_limit": variant.limits[position] if variant.limits else variant.time_limit,
    }


def make_env(variant: Variant, initial: dict[str, Any]) -> SatelliteTasking:
    """The environment, with every initial condition pinned."""
    others = ("utc_init", "target_seed", "time_limit")
    pinned = {name: value for name, value in initial.items() if name not in others}
    law = STEERING if variant.steering else {}
    arguments = {**FIXED, **law, **variant.fixed, **pinned, "oe": None}
    return SatelliteTasking(
        satellite=imager_class(variant)("Imager1", sat_args=arguments, **variant.satellite),
        scenario=SeededTargets(initial["target_seed"], variant.targets),
        rewarder=UniqueImages() if limited(variant) else data.UniqueImageReward(),
        time_limit=initial["time_limit"],
        world_args={"utc_init": initial["utc_init"]},
        log_level="ERROR",
        **variant.env,
    )


def windows(env: SatelliteTasking) -> Array:
    """All windows known now, in bsk_rl's order: number of their type, of the place, opening and closing time [s].

    Types are targets 0, stations 1, and those of instruments with their own limits from 2 on.
    """
    satellite, types = env.satellite, ["target", "ground_station", *getattr(env.satellite, "own", ())]
    stations = [place["object"] for place in satellite.locations_for_access_checking if place["type"] == "ground_station"]

    def row(opportunity: dict[str, Any]) -> tuple[float, float, float, float]:
        station, place = opportunity["type"] == "ground_station", opportunity["object"]
        return types.index(opportunity["type"]), stations.index(place) if station else int(place.name), *opportunity["window"]

    return np.array([row(opportunity) for opportunity in satellite.opportunities], dtype=np.float64).reshape(-1, 4)


@dataclass
class Flight:
    """An episode.

    Attributes:
        boundary: Rows at decisions, the last one after the end.
        step: Rows of steps, one fewer.
        windows: What ``windows`` returns after reset and after the end.
        horizon: [s] Up to when windows were known then.
    """

    boundary: dict[str, NDArray[Any]]
    step: dict[str, NDArray[Any]]
    windows: list[Array]
    horizon: list[float]

    def summary(self) -> str:
        """What happened, for the log."""
        step, last = self.step, self.boundary["state"][-1]
        tasked, image = step["tasked"] >= 0, step["image"] >= 0
        again = tasked[1:] & (step["tasked"][1:] == step["tasked"][:-1])
        counts = {
            "steps": len(image),
            "image actions": tasked.sum(),
            "images": (tasked & image).sum(),
            "in other modes": (~tasked & image).sum(),
            "same target again": again.sum(),
            "duplicates": self.boundary["duplicates"][-1],
            "missed": self.boundary["missed"][-1],
            "downlinks": (np.diff(self.boundary["state"][:, 17]) < 0.0).sum(),
        }
        return ", ".join(f"{value} {name}" for name, value in counts.items()) + f", end at {last[0]:.1f} s"


def counters(env: SatelliteTasking) -> dict[str, Any]:
    """What a row of ``Flight.boundary`` holds besides the observation."""
    satellite = env.satellite
    buffer = satellite.dynamics.storageUnit.storageUnitDataOutMsg.read().storedData[0]
    return {
        "state": np.append(boundary_state(env), buffer),
        "imaged": satellite.imaged,
        "missed": satellite.missed,
        "duplicates": satellite.data_store.data.duplicates,
    }


def choose(variant: Variant, opening: tuple[int, ...], rng: np.random.Generator) -> Iterator[int]:
    """Actions: the ``opening``, then random ones."""
    yield from opening
    images = variant.ahead * max(1, len(variant.instruments))
    image = (1.0 - sum(variant.others)) / images
    probability, action = [*variant.others, *[image] * images], -1
    while True:
        if action < 0 or rng.random() >= variant.repeat:
            action = int(rng.choice(len(probability), p=probability))
        yield action


def fly(variant: Variant, initial: dict[str, Any], actions: Iterator[int]) -> Flight:
    """An episode with these ``actions``."""
    env = make_env(variant, initial)
    observation, _ = env.reset(seed=variant.seed)
    boundaries, steps = [{"obs": observation, **counters(env)}], []
    known, horizon = [windows(env)], [env.satellite.window_calculation_time]
    for action in itertools.islice(actions, variant.steps):
        observation, reward, terminated, truncated, info = env.step(action)
        seen = [int(target.name) for target in env.satellite.data_store.new_data.imaged]
        steps.append(
            {
                "action": action,
                "reward": reward,
                "terminated": terminated,
                "truncated": truncated,
                "requires_retasking": info["requires_retasking"],
                "tasked": int(env.satellite.latest_target.name) if action >= len(MODES) else -1,
                "image": seen[0] if seen else -1,
            }
        )
        boundaries.append({"obs": observation, **counters(env)})
        if terminated or truncated:
            break
    known.append(windows(env))
    horizon.append(env.satellite.window_calculation_time)
    env.close()
    return Flight(columns(boundaries), columns(steps), known, horizon)


def columns(rows: list[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Rows as arrays by name."""
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def describe(variant: Variant) -> dict[str, str]:
    """JSON entries that make a file readable on its own."""
    names = ("targets", "ahead", "stations", "steering", "max_duration", "satellite", "seed")
    environment = {name: value for name, value in asdict(variant).items() if name in names} | variant.env
    environment |= {"instruments": variant.instruments} if variant.instruments else {}
    properties = {"satellite": SATELLITE_PROPERTIES, "target": TARGET_PROPERTIES, "ground_station": STATION_PROPERTIES}
    properties |= dict.fromkeys(limited(variant), LIMITED_PROPERTIES)
    described = {
        "fixed": {**FIXED, **(STEERING if variant.steering else {}), **variant.fixed},
        "env": environment | {"modes": MODES, "properties": properties, "eclipse_norm": ORBIT_PERIOD},
        "columns": [*COLUMNS, "buffer"],
        "versions": versions(),
    }
    return {name: json.dumps(value) for name, value in described.items()}


def tabulate(flights: list[Flight]) -> dict[str, NDArray[Any]]:
    """The windows of all episodes, one row each; ``window_time`` is 0 for those known after reset, 1 after the end."""
    tables = [(episode, when, table) for episode, flight in enumerate(flights) for when, table in enumerate(flight.windows)]
    whole = np.concatenate([table for *_, table in tables])
    lengths = [len(table) for *_, table in tables]
    return {
        "window_episode": np.repeat([episode for episode, *_ in tables], lengths).astype(np.uint8),
        "window_time": np.repeat([when for _, when, _ in tables], lengths).astype(np.uint8),
        "window_station": whole[:, 0].astype(np.uint8 if whole[:, 0].max() > 1 else bool),
        "window_place": whole[:, 1].astype(np.int16),
        "window_open": whole[:, 2],
        "window_close": whole[:, 3],
        "horizon": np.array([flight.horizon for flight in flights], dtype=np.float64),
    }


def record_episode(variant: Variant, position: int) -> tuple[dict[str, Any], Flight, Array]:
    """Initial conditions, flight and sensitivity of the episode at a ``position`` of the file."""
    number, opening = variant.episodes[position], variant.opening[position] if variant.opening else ()
    initial = draw_initial(streams(variant.seed, number)[0], variant, position)

    def play(start: dict[str, Any]) -> Flight:
        return fly(variant, start, choose(variant, opening, streams(variant.seed, number)[1]))

    flight = play(initial)
    return initial, flight, sensitivity(lambda nudged: play(nudged).boundary["state"], initial, flight.boundary["state"])


def record_episodes(name: str) -> dict[str, Any]:
    """Decision-boundary episodes of one variant."""
    variant, episodes = VARIANTS[name], []
    for position, number in enumerate(variant.episodes):
        episodes.append(record_episode(variant, position))
        _, flight, change = episodes[-1]
        print(f"  {name}[{number}] {flight.summary()}, sigma sensitivity {change[7:10].max():.0e}", flush=True)
    initials, flights, changes = zip(*episodes, strict=True)
    totals = [np.append(*(part.sum(0) for part in make_targets(ic["target_seed"], variant.targets))) for ic in initials]
    arrays = {
        "ic": json.dumps(initials),
        "length": np.array([len(flight.step["action"]) for flight in flights]),
        "target_sum": np.array(totals),
        "sensitivity": np.stack(changes),
        **{key: np.concatenate([flight.boundary[key] for flight in flights]) for key in flights[0].boundary},
        **{key: np.concatenate([flight.step[key] for flight in flights]) for key in flights[0].step},
        **tabulate(flights),
        **describe(variant),
    }
    arrays["obs"] = np.rint(arrays["obs"] / RESOLUTION) * RESOLUTION
    return arrays


RECORDERS: dict[str, Callable[[str], dict[str, Any]]] = dict.fromkeys(VARIANTS, record_episodes)


if __name__ == "__main__":
    record_files(RECORDERS)
