"""Where satellites of a case are, which tasks they see, and whether the Sun shines on them, in numpy.

Orbits are those of SGP4 with the constants of WGS84, in its frame TEME (true equator, mean equinox). The Earth turns by the mean
sidereal time of 1982 about the third axis; UT1 is UTC, and polar motion is neglected, as in the benchmark. Angles between
directions are the same in TEME and in GCRF.

Sources: Vallado, *Fundamentals of Astrodynamics and Applications*, 4th ed., 2013, for the frames and the low-precision Sun of the
Astronomical Almanac (0.01 deg).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from bsk_torch.astro.earth_rotation import sidereal_time_1982
from bsk_torch.astro.element_sets import ElementSet
from bsk_torch.astro.ephemeris import DAY, parse_utc, utc_seconds
from bsk_torch.astro.geodetic import SEMI_MINOR_AXIS, geodetic_to_fixed
from bsk_torch.formats.tle import read_tle
from bsk_torch.tasks.aeossp.files import Case, CaseSatellite, Requests

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

EARTH_RATE = 7.292115146706979e-5
"""Rate of the Earth's rotation, rad/s (IERS)."""

SHADOW_RADIUS = 6378136.3
"""Radius of the cylinder in which the benchmark has no sunlight, m."""

CONE_TOLERANCE = 1e-6
"""By which the benchmark lets an off-nadir angle exceed its limit, deg."""


@dataclass(frozen=True)
class Tracks:
    """Positions of S satellites and T tasks on the K times of a case's grid, both ends of the horizon included."""

    r: Array  # positions of the satellites in TEME, m, [S, K, 3]
    v: Array  # their velocities, m/s
    sidereal: Array  # sidereal times, rad, [K]
    places: Array  # positions of the tasks, Earth-fixed, m, [T, 3]

    def sight(self, satellite: Numbers, task: Numbers, k: Numbers) -> Array:
        """Return unit vectors from satellites to tasks at grid times, in TEME, [..., 3] for indices [...]."""
        line = turned(self.places[task], self.sidereal[k]) - self.r[satellite, k]
        return line / np.linalg.norm(line, axis=-1, keepdims=True)

    def sight_rate(self, satellite: Numbers, task: Numbers, k: Numbers) -> Array:
        """Return the derivatives of :meth:`sight`, rad/s, likewise."""
        place = turned(self.places[task], self.sidereal[k])
        line = place - self.r[satellite, k]
        ground = EARTH_RATE * np.stack([-place[..., 1], place[..., 0], np.zeros_like(place[..., 0])], -1)
        distance = np.linalg.norm(line, axis=-1, keepdims=True)
        unit, rate = line / distance, (ground - self.v[satellite, k]) / distance
        return rate - unit * np.sum(unit * rate, axis=-1, keepdims=True)

    def sees(self, satellite: Numbers, task: Numbers, k: Numbers, off_nadir: Array) -> NDArray[np.bool_]:
        """Return whether tasks [n] are above the horizon, and at most ``off_nadir`` [n], deg, from the geocentric nadir."""
        place, r = turned(self.places[task], self.sidereal[k]), self.r[satellite, k]
        line = place - r
        above = np.sum(line * place, -1) < 0.0
        return above & (angle(-r, line) <= np.radians(off_nadir + CONE_TOLERANCE))


def tracks(case: Case) -> Tracks:
    """Return positions on the grid of a case; ValueError if SGP4 has none for a satellite."""
    seconds = np.arange(0, case.horizon_s + 1, case.step_s, dtype=np.float64)
    states = [orbit(case, number, seconds) for number in range(len(case.satellites))]
    return Tracks(
        r=np.stack([r for r, _ in states]),
        v=np.stack([v for _, v in states]),
        sidereal=sidereal_time_1982(ephemeris_time(case, seconds)).numpy(),
        places=on_ellipsoid(case.requests),
    )


@lru_cache(4096)
def elements(satellite: CaseSatellite) -> ElementSet:
    """Return the element set of a satellite, with its name and the constants of WGS84."""
    (found,) = read_tle(f"{satellite.line1}\n{satellite.line2}", gravity="wgs84")
    return dataclasses.replace(found, name=satellite.name)


def orbit(case: Case, number: int, seconds: Array) -> tuple[Array, Array]:
    """Return position, m, and velocity, m/s, of a satellite in TEME, [n, 3], at seconds [n] from the start of the horizon.

    ValueError if SGP4 has none, such as after decay.
    """
    r, v = elements(case.satellites[number]).teme_states(ephemeris_time(case, seconds))
    return r.numpy(), v.numpy()


def ephemeris_time(case: Case, seconds: Array) -> Tensor:
    """Return ET, s, of seconds [n] from the start of the horizon."""
    return parse_utc(case.start) + torch.from_numpy(seconds)


def turned(places: Array, sidereal: Array) -> Array:
    """Return Earth-fixed vectors [..., 3] in TEME."""
    c, s = np.cos(sidereal), np.sin(sidereal)
    x, y, z = places[..., 0], places[..., 1], places[..., 2]
    return np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, np.broadcast_shapes(z.shape, c.shape))], -1)


def on_ellipsoid(requests: Requests) -> Array:
    """Return Earth-fixed positions of tasks, m, [T, 3]."""
    latitude, longitude, height = map(torch.from_numpy, (requests.latitude, requests.longitude, requests.altitude))
    return geodetic_to_fixed(latitude.deg2rad(), longitude.deg2rad(), height).numpy()


def angle(a: Array, b: Array) -> Array:
    """Return angles between vectors [..., 3], rad, [...], accurate for small ones, too."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


def sunlit(case: Case, number: int, seconds: Array) -> NDArray[np.bool_]:
    """Return whether a satellite is in sunlight at seconds [n] from the start of the horizon: outside a cylinder of shadow."""
    r, _ = orbit(case, number, seconds)
    days = utc_seconds(ephemeris_time(case, seconds)).numpy() / DAY
    anomaly, mean = np.radians(357.5291092 + 0.985600282 * days), 280.460 + 0.98564736 * days
    longitude = np.radians(mean + 1.914666471 * np.sin(anomaly) + 0.019994643 * np.sin(2.0 * anomaly))
    tilt = np.radians(23.439291 - 3.56e-7 * days)
    sun = np.stack([np.cos(longitude), np.cos(tilt) * np.sin(longitude), np.sin(tilt) * np.sin(longitude)], -1)
    along = np.sum(r * sun, -1)
    return ~((along < 0.0) & (np.linalg.norm(r - along[:, None] * sun, axis=-1) < SHADOW_RADIUS))


# -- passes ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Passes:
    """The P passes of a case: in each, a satellite can observe a task, at any of some successive starts.

    They are sorted by satellite, then by the first start.
    """

    satellite: Numbers  # numbers of the satellites, [P]
    task: Numbers  # numbers of the tasks, [P]
    first: Numbers  # grid times of the first starts, [P]
    starts: Numbers  # numbers of starts, [P]
    length: Numbers  # lengths of the observations, in steps of the grid, [P]

    def __len__(self) -> int:
        return len(self.satellite)


SEARCH_STEPS = 6
"""Steps of the grid between the times at which passes are searched for."""


def find_passes(case: Case, positions: Tracks, most_rate: Sequence[float] | None = None) -> Passes:
    """Return all passes of a case.

    Args:
        case: The case.
        positions: Its satellites and tasks.
        most_rate: Largest rate of the line of sight at which each satellite can observe, deg/s; None for no limit.
    """
    rows = [
        _passes_of(case, positions, number, None if most_rate is None else most_rate[number])
        for number in range(len(case.satellites))
    ]
    return Passes(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _passes_of(case: Case, positions: Tracks, number: int, most_rate: float | None) -> tuple[Numbers, ...]:
    requests, satellite, step = case.requests, case.satellites[number], case.step_s
    matches = np.flatnonzero([sensor == satellite.sensor for sensor in requests.sensor])
    task, k = _near(positions, number, matches, satellite.off_nadir, requests.release_s // step, requests.due_s // step)
    here = np.full_like(task, number)
    good = positions.sees(here, task, k, np.full(len(task), satellite.off_nadir))
    good &= (k * step >= requests.release_s[task]) & (k * step <= requests.due_s[task])
    if most_rate is not None:
        good &= np.linalg.norm(positions.sight_rate(here, task, k), axis=-1) <= np.radians(most_rate)
    task, k = task[good], k[good]
    begins = np.flatnonzero(np.diff(task, prepend=-1).astype(bool) | (np.diff(k, prepend=-2) != 1))
    samples = np.diff(begins, append=len(task))
    task, first = task[begins], k[begins]
    length = requests.duration_s[task] // step
    starts = samples - length
    fits = np.flatnonzero(starts > 0)
    fits = fits[np.argsort(first[fits], kind="stable")]
    return np.full(len(fits), number), task[fits], first[fits], starts[fits], length[fits]


def _near(
    positions: Tracks, number: int, tasks: Numbers, off_nadir: float, release: Numbers, due: Numbers
) -> tuple[Numbers, Numbers]:
    """Return pairs (task, grid time), sorted, among which are all at which a task is in the cone: those near the subpoint."""
    r, count = positions.r[number], len(positions.sidereal)
    coarse = np.arange(0, count, SEARCH_STEPS)
    radius = np.linalg.norm(r, axis=-1)
    swing = np.arcsin(np.minimum(radius.max() / (SEMI_MINOR_AXIS) * np.sin(np.radians(off_nadir)), 1.0))
    moved = 0.5 * SEARCH_STEPS * np.max(np.linalg.norm(np.diff(r, axis=0), axis=-1) / radius[1:]) * 1.2
    reach = swing - np.radians(off_nadir) + moved + 0.01  # 0.01 rad: the ellipsoid, the Earth's rotation, heights
    fixed = turned(r[coarse] / radius[coarse, None], -positions.sidereal[coarse])
    places = positions.places[tasks] / np.linalg.norm(positions.places[tasks], axis=-1, keepdims=True)
    hit, at = np.nonzero(places @ fixed.T > np.cos(reach))
    half = SEARCH_STEPS // 2
    within = (coarse[at] + half >= release[tasks[hit]]) & (coarse[at] - half <= due[tasks[hit]])
    hit, at = hit[within], at[within]
    k = coarse[at][:, None] + np.arange(-half, SEARCH_STEPS - half)
    task = np.broadcast_to(tasks[hit][:, None], k.shape)
    inside = (k >= 0) & (k < count)
    return task[inside], k[inside]
