"""Random cases with the distributions of AEOS-Bench."""

from __future__ import annotations

import functools
import importlib.resources
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from bsk_torch._checks import no_gradient, whole
from bsk_torch.rand import Key
from bsk_torch.sim.names import nearest
from bsk_torch.tasks.aeos_bench.files import HORIZON, Cases, on_sphere

POOL = "aeos_pool.npz"
"""File of the satellites that pass the benchmark's filter; ``scripts/tools/make_aeos_pool.py`` writes it."""

ORBITS = "aeos_orbits.npz"
"""File of orbits of the benchmark's test set; ``scripts/tools/make_aeos_orbits.py`` writes it."""

ORBIT_FIELDS = (
    "semi_major_axis",
    "eccentricity",
    "inclination",
    "right_ascension_of_the_ascending_node",
    "argument_of_perigee",
)
"""Elements of an orbit in the files of the benchmark: m, and degrees."""

DIGITS = 1.0, 1e-7, 1e-4, 1e-4, 1e-4
"""Units of these elements in :data:`ORBITS`."""

SATELLITES, TASKS = (1, 50), (50, 300)
"""Numbers of satellites and tasks of the benchmark's cases, both ends included."""

DURATIONS = (15, 60)
"""Durations of tasks, s, both ends included."""

ORBIT_KINDS = ("random", "real")

MOST = 1000
"""Largest number of satellites, or of tasks."""


@functools.cache
def pool() -> dict[str, Tensor]:
    """Return the arguments of the satellites of the pool, [P, ...] float64, by their names in ``sat_args``."""
    with (importlib.resources.files("bsk_torch.tasks.aeos_bench") / "tables" / POOL).open("rb") as file:
        return {name: torch.from_numpy(values.astype(np.float64)) for name, values in np.load(file).items()}


@functools.cache
def real_orbits() -> Tensor:
    """Return the orbits of the benchmark's test set above the ground, [4993, 5] float64; see :class:`AEOSBenchGenerator`.

    Source: ``data/orbits.zip`` of https://github.com/buaa-colalab/AEOSBench (Apache-2.0).
    """
    with (importlib.resources.files("bsk_torch.tasks.aeos_bench") / "tables" / ORBITS).open("rb") as file:
        elements = torch.from_numpy(np.load(file)["elements"] * np.array(DIGITS))
    return torch.cat([elements[:, :2], torch.deg2rad(elements[:, 2:])], 1)


class AEOSBenchGenerator:
    """Draws a case of AEOS-Bench in each episode.

    Satellites are drawn without replacement from a pool of those that pass the benchmark's filter: in two hours, they complete 36
    tasks near the equator by the benchmark's rule. Orbits, panels, sensors, batteries and tasks are drawn as in the benchmark's
    training set, and so are their numbers. With ``orbits="real"``, orbits are drawn from real ones, as in its test set.
    """

    def __init__(
        self,
        satellites: int | tuple[int, int] = SATELLITES,
        tasks: int | tuple[int, int] = TASKS,
        orbits: Literal["random", "real"] | Tensor | Sequence[Sequence[float]] = "random",
    ) -> None:
        """Draw cases of so many satellites and tasks.

        Args:
            satellites: Number of satellites, or its range, both ends included.
            tasks: Number of tasks, likewise.
            orbits: ``"random"``: random ones, as in the training set. ``"real"``: each episode draws some of 4,993 orbits of real
                satellites without replacement, as in the test set. Or your own such list: semi-major axes, m, eccentricities,
                and inclinations, right ascensions of ascending nodes and arguments of perigee, rad, [K, 5].

        Raises:
            ValueError: For a number or an orbit that is not allowed, and for fewer orbits, or satellites in the pool, than
                satellites.
        """
        self.satellites, self.tasks = _span("satellites", satellites), _span("tasks", tasks)
        self.n_satellites, self.n_tasks = self.satellites[1], self.tasks[1]
        self.orbits = _orbits(orbits)
        available = {"the pool": len(pool()["mass"])} | ({} if self.orbits is None else {"orbits": len(self.orbits)})
        for title, count in available.items():
            if self.n_satellites > count:
                raise ValueError(f"satellites={satellites} exceeds the {count} of {title}")

    def draw(self, key: Key) -> Cases:
        """Return cases for the n environments of a key."""
        present = _count(key.named("aeos_satellites"), *self.satellites).unsqueeze(1) > torch.arange(self.n_satellites)
        shape = len(key), self.n_satellites
        number = key.named("aeos_pool").distinct(self.n_satellites, len(pool()["mass"]))
        crafts = {name: values[number] for name, values in pool().items()}
        places, tasks = self._jobs(key)
        return Cases(
            names=(),
            satellites=crafts | self._hulls(key) | {"oe": self._elements(key)},
            present=present,
            sensors=torch.ones(shape, dtype=torch.float64),
            enabled=torch.zeros(shape, dtype=torch.bool),
            places=places,
            tasks=tasks,
        )

    def _hulls(self, key: Key) -> dict[str, Tensor]:
        u = _uniform(key.named("aeos_hull"), self.n_satellites, 8)
        p, t = math.pi * u[..., 0], math.pi * (u[..., 1] - 0.5)
        capacity = _within(u[..., 6], 8e3, 30e3)
        zero = torch.zeros(*capacity.shape, 3, dtype=torch.float64)
        return {
            "nHat_B": torch.stack([t.cos() * p.cos(), t.cos() * p.sin(), t.sin()], -1),
            "panelArea": _within(u[..., 2], 0.1, 0.5),
            "panelEfficiency": _within(u[..., 3], 0.1, 0.5),
            "sensorFieldOfView": torch.deg2rad(_within(u[..., 4], 0.1, 0.5)),
            "sensorPower": -_within(u[..., 5], 1.0, 10.0),
            "batteryStorageCapacity": capacity,
            "storedCharge_Init": capacity * _within(u[..., 7], 0.1, 1.0),
            "sigma_init": zero,
            "r_CB_B": zero,
        }

    def _elements(self, key: Key) -> Tensor:
        """Return orbital elements, [n, S, 6]: a in m, e, and i, Omega, omega, f in rad."""
        u = _uniform(key.named("aeos_orbit"), self.n_satellites, 6)
        turns = 2.0 * math.pi * u[..., 3:]
        if self.orbits is None:
            shape = _within(u[..., 0], 6.8e6, 8e6), 0.005 * u[..., 1], math.pi * u[..., 2]
            return torch.cat([torch.stack(shape, -1), turns], -1)
        number = key.named("aeos_real_orbit").distinct(self.n_satellites, len(self.orbits))
        return torch.cat([self.orbits[number], turns[..., 2:]], -1)

    def _jobs(self, key: Key) -> tuple[Tensor, dict[str, Tensor]]:
        """Return places, and the other numbers of tasks."""
        u = _uniform(key.named("aeos_task"), self.n_tasks, 5)
        exists = _count(key.named("aeos_tasks"), *self.tasks).unsqueeze(1) > torch.arange(self.n_tasks)
        duration = _integer(u[..., 0], *DURATIONS)
        release = _integer(u[..., 1], torch.zeros_like(duration), HORIZON - 3.0 * duration)
        due = _integer(u[..., 2], release + 3.0 * duration, HORIZON)
        places = on_sphere(_within(u[..., 3], -90.0, 90.0), _within(u[..., 4], -180.0, 180.0))
        tasks = {"release": release, "due": due, "duration": torch.where(exists, duration, 0.0), "type": torch.ones_like(due)}
        return places, tasks


def _span(title: str, value: int | tuple[int, int]) -> tuple[int, int]:
    """Return the smallest and the largest number; ValueError for one that is not from 1 to :data:`MOST`."""
    pair = value if isinstance(value, tuple | list) else (value, value)
    if len(pair) != 2:
        raise ValueError(f"{title}={value!r} must be a number, or the smallest and the largest one")
    low, high = (whole(title, part, 1, MOST) for part in pair)
    if low > high:
        raise ValueError(f"{title}={value!r} must be the smallest number and the largest one, in this order")
    return low, high


def _orbits(value: str | Tensor | Sequence[Sequence[float]]) -> Tensor | None:
    """Return orbits [K, 5], None for random ones; ValueError for others, or ones that are not around the Earth."""
    if isinstance(value, str):
        if value not in ORBIT_KINDS:
            raise ValueError(f"orbits={value!r} must be one of {list(ORBIT_KINDS)}, or a list; {nearest(value, ORBIT_KINDS)}")
        return real_orbits() if value == "real" else None
    orbits = torch.as_tensor(no_gradient("orbits", value), dtype=torch.float64)
    if orbits.ndim != 2 or orbits.shape[1] != 5 or not bool(torch.isfinite(orbits).all()):
        raise ValueError(f"orbits has the shape {list(orbits.shape)}; it must have finite elements a, e, i, Omega, omega, [K, 5]")
    if bool(((orbits[:, 0] <= 0.0) | (orbits[:, 1] < 0.0) | (orbits[:, 1] >= 1.0)).any()):
        raise ValueError("orbits: an orbit around the Earth needs a > 0 m and 0 <= e < 1")
    return orbits


def _uniform(key: Key, rows: int, columns: int) -> Tensor:
    """Return uniform numbers in [0, 1), [n, rows, columns]; those of the first rows do not depend on the number of rows."""
    return key.uniform(rows * columns).unflatten(1, (rows, columns))


def _within(u: Tensor, low: float, high: float) -> Tensor:
    return low + (high - low) * u


def _integer(u: Tensor, low: float | Tensor, high: float | Tensor) -> Tensor:
    """Return whole numbers from ``low`` to ``high``, both included, for uniform numbers."""
    return torch.floor(u * (high - low + 1.0)) + low


def _count(key: Key, low: int, high: int) -> Tensor:
    return _integer(key.uniform(1).squeeze(1), low, high)
