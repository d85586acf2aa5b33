"""Fly real orbits, and compare positions, access windows, eclipses and the Sun with Skyfield, ERFA and brahe.

    python scripts/validation/real_orbits.py --out benchmarks/results/real_orbits.json

`real_orbits.tle` holds the orbits: three sets of Space-Track of 2026-04-13, and seven of the verification cases of SGP4 (Vallado,
Crawford, Hujsak and Kelso, "Revisiting Spacetrack Report #3", AIAA 2006-6753). Each episode begins at the epoch of its set.
The twenty satellites and hundred cities of `bsk_torch.formats.SAMPLES` follow, all from the same epoch: positions and windows.
Skyfield and ERFA are needed; brahe is compared if it is installed.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import erfa
import numpy as np
import torch
from scipy.optimize import brentq
from skyfield.api import EarthSatellite, load, wgs84

from bsk_torch import act, dyn, fsw, obs, rand, sats, scene
from bsk_torch.astro.element_sets import ElementSet
from bsk_torch.astro.ephemeris import date_in_words, parse_utc, sun_position
from bsk_torch.data import UniqueImageReward
from bsk_torch.env import SatelliteTasking
from bsk_torch.files import write_file
from bsk_torch.formats import SAMPLES
from bsk_torch.formats.places import read_csv
from bsk_torch.formats.tle import read_tle
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING

ORBITS = Path(__file__).with_suffix(".tle")
CIRCULAR = 3  # orbits at the head of the file, low and circular, which have limits
HOURS = (0.0, 1.0, 3.0, 6.0, 12.0, 24.0)
WINDOW_HOURS, ELEVATION = 6.0, 10.0
R_UMBRA, R_SUN, AU = 6378136.6, 695000e3, 149597870700.0

CITIES = {
    "Anchorage": (61.218, -149.900, 31.0),
    "Bogota": (4.711, -74.072, 2640.0),
    "Cairo": (30.044, 31.236, 23.0),
    "Cape Town": (-33.925, 18.424, 5.0),
    "Darwin": (-12.463, 130.842, 30.0),
    "Delhi": (28.614, 77.209, 216.0),
    "Helsinki": (60.170, 24.938, 26.0),
    "Honolulu": (21.307, -157.858, 6.0),
    "La Paz": (-16.500, -68.150, 3640.0),
    "Lagos": (6.524, 3.379, 41.0),
    "London": (51.507, -0.128, 11.0),
    "Mexico City": (19.433, -99.133, 2240.0),
    "Nairobi": (-1.292, 36.822, 1795.0),
    "New York": (40.713, -74.006, 10.0),
    "Punta Arenas": (-53.164, -70.917, 34.0),
    "Reykjavik": (64.147, -21.943, 61.0),
    "Singapore": (1.352, 103.820, 15.0),
    "Sydney": (-33.869, 151.209, 3.0),
    "Tokyo": (35.677, 139.650, 40.0),
    "Wellington": (-41.287, 174.776, 31.0),
}
"""Latitude and longitude, degrees on WGS84, and height, m."""

START = "2026-04-14T00:00:00Z"
"""Epoch of the flight of the samples, of the same day as their element sets."""

Places = Mapping[str, tuple[float, float, float]]


class Observer(sats.ImagingSatellite):
    """A satellite whose windows over the cities are looked for."""

    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=60.0), act.Image(n_ahead_image=1))
    dyn_type = dyn.ImagingDynModel
    fsw_type = fsw.SteeringImagerFSWModel


def flown(sets: Sequence[ElementSet], starts: Sequence[str], places: Places) -> Any:
    """The simulator of an episode for each set, with arcs of a day and windows of some hours."""
    latitude, longitude, height = zip(*places.values(), strict=True)
    env = SatelliteTasking(
        Observer("Observer", {"oe": rand.per_env(sets), "imageTargetMinimumElevation": math.radians(ELEVATION)}),
        scene.Targets.from_geodetic(latitude, longitude, height, names=list(places)),
        UniqueImageReward(),
        num_envs=len(sets),
        world_args={"utc_init": rand.per_env(list(starts)), "baseDensity": 0.0},
        time_limit=3600.0 * WINDOW_HOURS,
        seed=0,
    )
    env.reset()
    now = env.simulator.sim_time
    env.simulator.lookahead.reach(now + 3600.0 * HOURS[-1] + 600.0, now)
    return env.simulator


def statistics(values: list[float]) -> dict[str, float]:
    """Number, root mean square and largest absolute value."""
    array = np.array(values or [0.0])
    return {"count": len(values), "rms": float(np.sqrt(np.mean(array**2))), "worst": float(np.abs(array).max())}


def positions(simulator: Any, others: list[Callable[[float], np.ndarray]], at: Sequence[float] = HOURS) -> list[list[float]]:
    """Distances, m, of the flown orbits from other positions in GCRS at ET, [S][hours]."""
    arcs, found = simulator.arcs, []
    for k, other in enumerate(others):
        nodes = [LEAD_NODES + round(3600.0 * hours / NODE_SPACING) for hours in at]
        et = float(arcs.et[k])
        rows = zip(at, nodes, strict=True)
        found.append([float(np.linalg.norm(arcs.flown[k, node].numpy() - other(et + 3600.0 * hours))) for hours, node in rows])
    return found


def windows(
    simulator: Any, satellites: list[EarthSatellite], timescale: Any, places: Places
) -> tuple[list[list[float]], int, int]:
    """Differences of opening and closing times from Skyfield's, s, by orbit; windows on either side without a partner."""
    table, each, extra, missing = simulator.lookahead.access.windows["target"], list[list[float]](), 0, 0
    limit = 3600.0 * WINDOW_HOURS
    for k, satellite in enumerate(satellites):
        et, differences = float(simulator.arcs.et[k]), list[float]()
        each.append(differences)
        begin, end = (timescale.tdb_jd(2451545.0, (et + offset) / 86400.0) for offset in (0.0, limit))
        for place, (latitude, longitude, height) in enumerate(places.values()):
            here = (table.place[k] == place) & torch.isfinite(table.close[k]) & (table.open[k] < limit)
            mine = torch.stack([table.open[k][here], table.close[k][here].clamp(max=limit)], -1).numpy()
            site = wgs84.latlon(latitude, longitude, height)
            times, events = satellite.find_events(site, begin, end, altitude_degrees=ELEVATION)

            def above(second: float, satellite: EarthSatellite = satellite, site: Any = site, et: float = et) -> float:
                time = timescale.tdb_jd(2451545.0, (et + second) / 86400.0)
                return float((satellite - site).at(time).altaz()[0].degrees - ELEVATION)

            rough = [float((time.tdb - begin.tdb) * 86400.0) for time, event in zip(times, events, strict=True) if event != 1]
            # find_events stops within half a second
            crossings = [brentq(above, second - 2.0, second + 2.0, xtol=1e-3) for second in rough]
            up = bool((satellite - site).at(begin).altaz()[0].degrees > ELEVATION)
            edges = [*([0.0] if up else []), *crossings]
            edges += [limit] if len(edges) % 2 else []
            theirs = np.array(edges).reshape(-1, 2)
            for window in mine:
                near = [other for other in theirs if min(other[1], window[1]) > max(other[0], window[0])]
                extra += not near
                differences += [w - o for other in near[:1] for w, o in zip(window, other, strict=True) if 1.0 < o < limit - 1.0]
            missing += sum(all(min(o[1], m[1]) <= max(o[0], m[0]) for m in mine) for o in theirs)
    return each, extra, missing


def erfa_sun(et: np.ndarray) -> np.ndarray:
    """Geometric position of the Sun in GCRS at ET [K], s, [K, 3] m."""
    earth, _ = erfa.epv00(2451545.0, et / 86400.0)
    return -earth["p"] * AU


def shadow_edges(et: float, r_at: Callable[[np.ndarray], np.ndarray], seconds: float) -> list[float]:
    """Times, s, at which a satellite enters or leaves the umbra, a cone; found by samples every 10 s and straight lines."""
    time = np.arange(0.0, seconds, 10.0)
    r, sun = r_at(time), erfa_sun(et + time)
    distance = np.linalg.norm(sun, axis=-1)
    along = -(r * sun).sum(-1) / distance
    slope = np.arcsin((R_SUN - R_UMBRA) / distance)
    width = (R_UMBRA / np.sin(slope) - along) * np.tan(slope)
    depth = np.where(along > 0.0, width - np.sqrt(np.maximum((r * r).sum(-1) - along**2, 0.0)), -1e9)
    change = np.flatnonzero((depth[1:] > 0.0) != (depth[:-1] > 0.0))
    return [float(time[k] + 10.0 * depth[k] / (depth[k] - depth[k + 1])) for k in change if min(depth[k], depth[k + 1]) > -1e8]


def eclipses(simulator: Any, sets: list[ElementSet]) -> tuple[list[float], int]:
    """Differences of the times of umbra, s, from SGP4's positions under ERFA's Sun, and how many times the table lacks.

    The table spans the look-ahead. A time within its span that has none within two minutes is lacking.
    """
    differences: list[float] = []
    lacking = 0
    table = simulator.lookahead.eclipses
    for k, elements in enumerate(sets):
        et, plain = float(simulator.arcs.et[k]), dataclasses.replace(elements, matched=False)

        def at(time: np.ndarray, plain: ElementSet = plain, et: float = et) -> np.ndarray:
            return plain.state_at(torch.from_numpy(et + time))[0].numpy()

        theirs = np.array(shadow_edges(et, at, 3600.0 * WINDOW_HOURS))
        mine = np.sort(np.concatenate([table.starts[k].numpy(), table.ends[k].numpy()]))
        for edge in theirs:
            near = mine[np.isfinite(mine)]
            if not len(near) or not 60.0 < edge < near[-1] + 120.0:
                continue
            difference = float(near[np.abs(near - edge).argmin()] - edge)
            if abs(difference) < 120.0:
                differences.append(difference)
            else:
                lacking += 1
    return differences, lacking


def skyfield_position(satellite: EarthSatellite, timescale: Any, et: float) -> np.ndarray:
    """Position in GCRS at ET, s, [3] m."""
    return np.asarray(satellite.at(timescale.tdb_jd(2451545.0, et / 86400.0)).position.m)


def brahe_position(lines: list[str]) -> Callable[[float], np.ndarray]:
    """SGP4 with the constants of WGS84 in GCRF, by brahe without polar motion and UT1 - UTC."""
    import brahe

    brahe.set_global_eop_provider_from_static_provider(brahe.StaticEOPProvider.from_zero())
    orbit = brahe.SGPPropagator.from_tle(*lines, 60.0)

    def position(et: float) -> np.ndarray:
        word = date_in_words(et)
        date = [int(part) for part in (word[:4], word[5:7], word[8:10], word[11:13], word[14:16])]
        epoch = brahe.Epoch.from_datetime(*date, float(word[17:23]), 0.0, brahe.TimeSystem.UTC)
        return np.asarray(orbit.state_gcrf(epoch)[:3])

    return position


def samples(timescale: Any) -> dict[str, Any]:
    """Positions and windows of the samples in six hours, by satellite."""
    sets = read_tle(SAMPLES / "earth_observation.tle")
    lines = (SAMPLES / "earth_observation.tle").read_text().splitlines()
    listed = read_csv(SAMPLES / "cities.csv")
    numbers = zip(listed.latitude, listed.longitude, listed.height, strict=True)
    places = dict(zip(listed.names, numbers, strict=True))
    satellites = [EarthSatellite(*lines[2 * k : 2 * k + 2], None, timescale) for k in range(len(sets))]
    simulator = flown(sets, [START] * len(sets), places)
    differences, extra, missing = windows(simulator, satellites, timescale, places)
    hours = np.linspace(0.0, WINDOW_HOURS, 25).tolist()
    distances = positions(simulator, [functools.partial(skyfield_position, each, timescale) for each in satellites], hours)
    return {
        "names": [each.name for each in sets],
        "places": len(places),
        "positions": [statistics(row) for row in distances],
        "windows": [statistics(found) for found in differences],
        "all": statistics([difference for found in differences for difference in found]),
        "unmatched": {"extra": extra, "missing": missing},
    }


def check(result: dict[str, Any]) -> None:
    """End the program with an error if low circular orbits or what is common to all orbits are off by more than limits."""
    distances = [row[HOURS.index(hours)] for row in result["positions"][:CIRCULAR] for hours in (0.0, 1.0, 3.0, 6.0)]
    found = {
        "positions of low circular orbits over six hours, m": (max(distances), 3000.0),
        "windows of low circular orbits, s": (max(each["worst"] for each in result["windows"][:CIRCULAR]), 2.0),
        "positions of the samples over six hours, m": (max(each["worst"] for each in result["samples"]["positions"]), 3000.0),
        "windows of the samples, s": (result["samples"]["all"]["worst"], 2.0),
        "windows of the samples on one side only": (sum(result["samples"]["unmatched"].values()), 0),
        "eclipses, s": (result["eclipses"]["worst"], 2.0),
        "direction of the Sun, arcseconds": (result["sun_arcseconds"]["worst"], 1.0),
        "eclipses that the table lacks": (result["eclipses"]["lacking"], 0),
        "windows on one side only": (sum(result["unmatched"].values()), 0),
        "positions of SGP4 against brahe, m": (result["brahe"]["worst"] if result["brahe"] else 0.0, 1.0),
    }
    wrong = [f"{what}: {value:g} exceeds {limit:g}" for what, (value, limit) in found.items() if value > limit]
    if wrong:
        raise SystemExit("\n".join(wrong))


def main() -> None:
    """Compare, and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path)
    out = parser.parse_args().out
    torch.set_num_threads(1)
    sets, lines, timescale = read_tle(ORBITS), ORBITS.read_text().splitlines(), load.timescale(builtin=True)
    pairs = [lines[3 * k + 1 : 3 * k + 3] for k in range(len(sets))]
    satellites = [EarthSatellite(*pair, None, timescale) for pair in pairs]
    skyfield = [functools.partial(skyfield_position, satellite, timescale) for satellite in satellites]
    simulator = flown(sets, [date_in_words(each.epoch) for each in sets], CITIES)
    differences, extra, missing = windows(simulator, satellites, timescale, CITIES)
    et = np.concatenate([each.epoch + np.linspace(0.0, 86400.0, 25) for each in sets])
    suns = sun_position(torch.from_numpy(et)).numpy(), erfa_sun(et)
    ours, theirs = (sun / np.linalg.norm(sun, axis=-1, keepdims=True) for sun in suns)
    angle = np.degrees(2.0 * np.arcsin(0.5 * np.linalg.norm(ours - theirs, axis=-1))).tolist()
    frames = []
    if find_spec("brahe"):
        wide = read_tle(ORBITS, gravity="wgs84")
        for pair, elements in zip(pairs, wide, strict=True):
            orbit, plain = brahe_position(pair), dataclasses.replace(elements, matched=False)
            for hours in HOURS:
                when = torch.tensor([parse_utc(date_in_words(plain.epoch + 3600.0 * hours))], dtype=torch.float64)
                frames.append(float(np.linalg.norm(plain.state_at(when)[0][0].numpy() - orbit(float(when)))))
    edges, lacking = eclipses(simulator, sets)
    result = {
        "versions": {name: version(name) for name in ("bsk_torch", "skyfield", "pyerfa", "sgp4")},
        "hours": HOURS,
        "orbits": [each.name for each in sets],
        "positions": positions(simulator, skyfield),
        "windows": [statistics(found) for found in differences],
        "unmatched": {"extra": extra, "missing": missing},
        "samples": samples(timescale),
        "eclipses": statistics(edges) | {"lacking": lacking},
        "sun_arcseconds": statistics([3600.0 * each for each in angle]),
        "brahe": statistics(frames) if frames else None,
    }
    text = json.dumps(result, indent=1) + "\n"
    print(text) if out is None else write_file(out, text)
    check(result)


if __name__ == "__main__":
    main()
