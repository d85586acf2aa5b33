"""Files of AEOS-Bench: constellations and task sets in JSON, read into tables of cases."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import whole
from bsk_torch.sim.names import nearest

logger = logging.getLogger(__name__)

EARTH_RADIUS = 6378136.6
"""Radius of the sphere on which places lie, m."""

MU = 398600.436e9
"""Gravitational parameter that converts elements, m^3/s^2."""

TOP_SPEED, MOST_TORQUE = 6000.0, 0.2
"""Speed, rpm, and torque, N m, of the wheels that the benchmark uses, of all types."""

SENSORS = {1: "visible", 2: "near infrared"}

CONSTELLATION, TASKS = "constellation", "taskset"

HORIZON = 3600.0
"""Length of an episode of the benchmark, s."""


@dataclass(frozen=True)
class Cases:
    """Cases of AEOS-Bench: C of them, padded to S satellites and T tasks.

    Attributes:
        names: Names of the cases, C of them; none of cases that have been drawn.
        satellites: Arguments of satellites by their names in ``sat_args``, [C, S, ...] float64 each. Those of the first satellite
            of a case fill the places of absent ones.
        present: Which satellites exist, [C, S] bool.
        sensors: Types of the sensors, [C, S] float64; see :data:`SENSORS`.
        enabled: Which sensors are on at the start, [C, S] bool.
        places: Earth-fixed positions of the tasks, [C, T, 3] m.
        tasks: ``release``, ``due`` and ``duration``, s, and the ``type`` of sensor, [C, T] float64 each. The duration of a task
            that does not exist is zero.
    """

    names: tuple[str, ...]
    satellites: Mapping[str, Tensor]
    present: Tensor
    sensors: Tensor
    enabled: Tensor
    places: Tensor
    tasks: Mapping[str, Tensor]

    def __len__(self) -> int:
        """Number of cases."""
        return len(self.present)

    @property
    def n_satellites(self) -> int:
        """Number of satellites, those that pad included."""
        return self.present.shape[1]

    @property
    def n_tasks(self) -> int:
        """Number of tasks, those that pad included."""
        return self.places.shape[1]

    def take(self, rows: Tensor) -> Cases:
        """Return the cases with the numbers ``rows`` [n]."""
        return Cases(
            names=tuple(self.names[int(row)] for row in rows) if self.names else (),
            satellites={name: values[rows] for name, values in self.satellites.items()},
            present=self.present[rows],
            sensors=self.sensors[rows],
            enabled=self.enabled[rows],
            places=self.places[rows],
            tasks={name: values[rows] for name, values in self.tasks.items()},
        )


class CaseError(ValueError):
    """A file of a case that cannot be flown; the message names the file, the entry, and the field."""


def read_cases(folder: str | Path, satellites: int | None = None, tasks: int | None = None) -> Cases:
    """Return the cases in a folder and its subfolders, in the order of their names.

    A case is a pair of files: ``constellation.json`` and ``taskset.json`` in a folder with the case's name,
    ``NAME.constellation.json`` and ``NAME.taskset.json``, or ``constellations/.../NAME.json`` and ``tasksets/.../NAME.json``.

    Args:
        folder: The folder.
        satellites: Satellites to which cases are padded (default: the most of any case).
        tasks: Tasks to which cases are padded, likewise.

    Raises:
        FileNotFoundError: For a folder without cases, and a constellation without tasks.
        CaseError: For a file that is not one of the benchmark, and a case with more satellites or tasks than the padding.
        ValueError: For a padding that is not a whole number.
    """
    pairs = list(_pairs(Path(folder)))
    if not pairs:
        raise FileNotFoundError(f"{folder}: no constellation.json, NAME.constellation.json or constellations/ in it")
    flown = [(name, _constellation(ours), _tasks(theirs)) for name, ours, theirs in pairs]
    cases = stacked(flown, satellites, tasks)
    strange, count = int((impossible(cases.satellites["inertia"]) & cases.present).sum()), int(cases.present.sum())
    if strange:
        logger.warning(
            "%s: %d of %d satellites have an inertia that no body has; they fly with it, as in the benchmark",
            folder,
            strange,
            count,
        )
    return cases


def impossible(inertia: Tensor) -> Tensor:
    """Return whether inertias [..., 9], row by row, break the triangle inequality of principal moments, [...]."""
    moments = torch.linalg.eigvalsh(inertia.unflatten(-1, (3, 3)))
    return moments[..., 0] + moments[..., 1] < moments[..., 2] * (1.0 - 1e-9)


def _pairs(folder: Path) -> Iterator[tuple[str, Path, Path]]:
    """Yield name, constellation and task set of each case in a folder."""
    for path in sorted(folder.rglob(f"*{CONSTELLATION}.json")):
        stem = path.name.removesuffix(f"{CONSTELLATION}.json")
        yield stem.rstrip(".") or path.parent.name, path, _there(path.with_name(f"{stem}{TASKS}.json"), path)
    for path in sorted(folder.rglob(f"{CONSTELLATION}s/**/*.json")):
        parts = [f"{TASKS}s" if part == f"{CONSTELLATION}s" else part for part in path.parts]
        yield path.stem, path, _there(Path(*parts), path)


def _there(path: Path, partner: Path) -> Path:
    if not path.exists():
        raise FileNotFoundError(f"{path}: the tasks of {partner} are missing")
    return path


# -- fields -------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Entry:
    """An object of a file, whose fields are read with messages that tell where they are."""

    values: Any
    where: str

    def __post_init__(self) -> None:
        """Raise a CaseError for anything but an object."""
        if not isinstance(self.values, dict):
            raise CaseError(f"{self.where} is {str(self.values)[:60]!r}; it must be an object")

    def get(self, name: str) -> Any:
        """Return a field."""
        if name not in self.values:
            raise CaseError(f"{self.where} lacks {name!r}; {nearest(name, self.values)}")
        return self.values[name]

    def number(self, name: str, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a number."""
        value = self.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high or not math.isfinite(value):
            raise CaseError(f"{self.where}: {name}={value!r} must be a number in [{low:g}, {high:g}]")
        return float(value)

    def vector(self, name: str, size: int = 3) -> list[float]:
        """Return a list of numbers."""
        value = self.get(name)
        if not isinstance(value, list) or len(value) != size:
            raise CaseError(f"{self.where}: {name}={value!r} must be a list of {size} numbers")
        return [Entry({name: x}, self.where).number(name) for x in value]

    def entry(self, name: str) -> Entry:
        """Return an object."""
        return Entry(self.get(name), f"{self.where}.{name}")

    def entries(self, name: str, size: int | None = None) -> list[Entry]:
        """Return a list of objects."""
        value = self.get(name)
        if not isinstance(value, list) or (size is not None and len(value) != size):
            raise CaseError(f"{self.where}: {name} must be a list of {'' if size is None else f'{size} '}objects")
        return [Entry(part, f"{self.where}.{name}[{k}]") for k, part in enumerate(value)]


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise CaseError(f"{path}: no JSON: {error}") from None


def _sensor_type(entry: Entry, name: str) -> float:
    value = entry.number(name)
    if value not in SENSORS:
        raise CaseError(f"{entry.where}: {name}={value:g} must be one of {SENSORS}")
    return value


# -- constellations -----------------------------------------------------------------------------------------------------------

Satellites = list[dict[str, Any]]
"""Arguments of each satellite of a case by name, with ``sensor_type`` and ``sensor_enabled``."""


def _constellation(path: Path) -> Satellites:
    """Return the arguments of the satellites of a file, sorted by their ids."""
    content = Entry(_read(path), path.as_posix())
    orbits = {int(orbit.number("id")): orbit for orbit in content.entries("orbits")}
    listed = sorted(content.entries("satellites"), key=lambda entry: entry.number("id"))
    ids = [int(entry.number("id")) for entry in listed]
    if not listed or len(set(ids)) < len(ids):
        raise CaseError(f"{path}: satellites have the ids {ids}; give each satellite its id, at least one")
    return [_satellite(entry, orbits) for entry in listed]


def _satellite(entry: Entry, orbits: Mapping[int, Entry]) -> dict[str, Any]:
    """Return the arguments of a satellite."""
    number = int(entry.number("orbit"))
    if number not in orbits:
        raise CaseError(f"{entry.where}: orbit={number} is not among the ids of orbits, {sorted(orbits)}")
    orbit, panel, sensor = orbits[number], entry.entry("solar_panel"), entry.entry("sensor")
    battery, control, wheels = entry.entry("battery"), entry.entry("mrp_control"), entry.entries("reaction_wheels", 3)
    direction, capacity = panel.vector("direction"), battery.number("capacity", 1e-6)
    angles = ("inclination", "right_ascension_of_the_ascending_node", "argument_of_perigee")
    degrees = [*(orbit.number(name) for name in angles), entry.number("true_anomaly")]
    return {
        "mass": entry.number("mass", 1e-6),
        "inertia": entry.vector("inertia", 9),
        "r_CB_B": entry.vector("center_of_mass"),
        "sigma_init": entry.vector("mrp_attitude_bn") if "mrp_attitude_bn" in entry.values else [0.0] * 3,
        "oe": [orbit.number("semi_major_axis", 1.0), orbit.number("eccentricity", 0.0, 0.999), *map(math.radians, degrees)],
        "rwAxes_B": [wheel.vector("rw_direction") for wheel in wheels],
        "rwJs": [wheel.number("max_momentum", 1e-9) / (TOP_SPEED * math.pi / 30.0) for wheel in wheels],
        "wheelSpeeds": [wheel.number("rw_speed_init") for wheel in wheels],
        "rwBasePower": [wheel.number("power") for wheel in wheels],
        "rwMechToElecEfficiency": [wheel.number("efficiency") for wheel in wheels],
        "nHat_B": direction,
        "panelArea": panel.number("area", 0.0) * math.hypot(*direction),  # Basilisk takes the normal as it is given
        "panelEfficiency": panel.number("efficiency", 0.0),
        "sensorPower": -sensor.number("power"),
        "sensorFieldOfView": math.radians(sensor.number("half_field_of_view", 1e-6, 85.0)),
        "batteryStorageCapacity": capacity,
        "storedCharge_Init": capacity * battery.number("percentage", 0.0, 1.0),
        "K": control.number("k", 0.0),
        "Ki": control.number("ki"),
        "P": control.number("p", 0.0),
        "integralLimit": control.number("integral_limit", 0.0),
        "sensor_type": _sensor_type(sensor, "type"),
        "sensor_enabled": float(sensor.get("enabled") is True),
    }


# -- tasks --------------------------------------------------------------------------------------------------------------------

Tasks = list[dict[str, float]]
"""``latitude`` and ``longitude``, degrees, ``release``, ``due``, ``duration`` and ``type`` of each task of a case."""


def _tasks(path: Path) -> Tasks:
    """Return the tasks of a file, a list or an object with the key ``tasks``, sorted by their ids."""
    values = _read(path)
    content = Entry({"tasks": values} if isinstance(values, list) else values, path.as_posix())
    listed = sorted(content.entries("tasks"), key=lambda entry: entry.number("id"))
    if not listed:
        raise CaseError(f"{path}: no tasks; a case needs at least one")
    return [_task(entry) for entry in listed]


def _task(entry: Entry) -> dict[str, float]:
    """Return a task."""
    latitude, longitude = entry.vector("coordinate", 2)
    if not -90.0 <= latitude <= 90.0:
        raise CaseError(f"{entry.where}: coordinate={[latitude, longitude]} must be latitude and longitude, degrees")
    release, due = entry.number("release_time", 0.0), entry.number("due_time")
    if due < release:
        raise CaseError(f"{entry.where}: due_time={due:g} s is before release_time={release:g} s")
    return {
        "latitude": latitude,
        "longitude": longitude,
        "release": release,
        "due": due,
        "duration": entry.number("duration", 1.0, 255.0),
        "type": _sensor_type(entry, "sensor_type"),
    }


# -- tables -------------------------------------------------------------------------------------------------------------------


def stacked(cases: Sequence[tuple[str, Satellites, Tasks]], satellites: int | None, tasks: int | None) -> Cases:
    """Return cases, by name, with their satellites and tasks, as tables."""
    most = [max(len(part[k]) for part in cases) for k in (1, 2)]
    wanted = {"satellites": satellites, "tasks": tasks}
    sizes = [
        biggest if size is None else whole(title, size, 1) for biggest, (title, size) in zip(most, wanted.items(), strict=True)
    ]
    for name, *parts in cases:
        for title, part, size in zip(wanted, parts, sizes, strict=True):
            if len(part) > size:
                raise CaseError(f"case {name!r} has {len(part)} {title}, more than {title}={size}")

    def table(rows: Sequence[Sequence[Any]], size: int) -> Tensor:
        return torch.tensor([[*row, *[row[0]] * (size - len(row))] for row in rows], dtype=torch.float64)

    crafts, jobs = [case[1] for case in cases], [case[2] for case in cases]
    arguments = {name: table([[craft[name] for craft in row] for row in crafts], sizes[0]) for name in crafts[0][0]}
    fields = {name: table([[job[name] for job in row] for row in jobs], sizes[1]) for name in jobs[0][0]}
    exists = torch.tensor([[k < len(row) for k in range(sizes[1])] for row in jobs])
    fields["duration"] = torch.where(exists, fields["duration"], 0.0)
    return Cases(
        names=tuple(case[0] for case in cases),
        present=torch.tensor([[k < len(row) for k in range(sizes[0])] for row in crafts]),
        sensors=arguments.pop("sensor_type"),
        enabled=arguments.pop("sensor_enabled") > 0.5,
        satellites=arguments,
        places=on_sphere(fields.pop("latitude"), fields.pop("longitude")),
        tasks=fields,
    )


def on_sphere(latitude: Tensor, longitude: Tensor) -> Tensor:
    """Return Earth-fixed positions [..., 3], m, of places on the benchmark's sphere, from degrees [...]."""
    latitude, longitude = torch.deg2rad(latitude), torch.deg2rad(longitude)
    across = torch.cos(latitude)
    return EARTH_RADIUS * torch.stack([across * torch.cos(longitude), across * torch.sin(longitude), torch.sin(latitude)], -1)
