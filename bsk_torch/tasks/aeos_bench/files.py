"""Files of AEOS-Bench: constellations and task sets in JSON, read into tables of cases."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from annotated_types import Interval, Len
from torch import Tensor

from bsk_torch._checks import whole
from bsk_torch.untrusted import MOST_JSON, Count, parse_json, read_bytes

logger = logging.getLogger(__name__)

EARTH_RADIUS = 6378136.6
"""Radius of the sphere on which places lie, m."""

MU = 398600.436e9
"""Gravitational parameter that converts elements, m^3/s^2."""

TOP_SPEED, MOST_TORQUE = 6000.0, 0.2
"""Speed, rpm, and torque, N m, of the wheels that the benchmark uses, of all types."""

SENSORS = {1: "visible", 2: "near infrared"}

CONSTELLATION, TASKS = "constellation", "taskset"

MOST_SATELLITES, MOST_TASKS = 1000, 10_000
"""Most satellites and tasks of a case in a file."""

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
        ValueError: For a file that is not one of the benchmark, with file, entry and field; a case with more satellites or tasks
            than the padding; and a padding that is not a whole number.
    """
    pairs = list(_pairs(Path(folder)))
    if not pairs:
        raise FileNotFoundError(f"{folder}: no constellation.json, NAME.constellation.json or constellations/ in it")
    entries = [(name, _constellation(ours), _tasks(theirs)) for name, ours, theirs in pairs]
    cases = stacked(entries, satellites, tasks)
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
        yield stem.rstrip(".") or path.parent.name, path, _require(path.with_name(f"{stem}{TASKS}.json"), path)
    for path in sorted(folder.rglob(f"{CONSTELLATION}s/**/*.json")):
        parts = [f"{TASKS}s" if part == f"{CONSTELLATION}s" else part for part in path.parts]
        yield path.stem, path, _require(Path(*parts), path)


def _require(path: Path, partner: Path) -> Path:
    if not path.exists():
        raise FileNotFoundError(f"{path}: the tasks of {partner} are missing")
    return path


# -- content of files -----------------------------------------------------------------------------------------------------------

Real = Annotated[float, Interval(ge=-1e15, le=1e15)]
Positive = Annotated[float, Interval(ge=0.0, le=1e15)]
Three = Annotated[list[Real], Len(3, 3)]
SensorType = Literal[1, 2]


@dataclass
class OrbitEntry:
    """An orbit: elements in meters and degrees."""

    id: Count
    semi_major_axis: Annotated[float, Interval(ge=1.0, le=1e15)]
    eccentricity: Annotated[float, Interval(ge=0.0, le=0.999)]
    inclination: Real
    right_ascension_of_the_ascending_node: Real
    argument_of_perigee: Real


@dataclass
class PanelEntry:
    """A solar panel."""

    direction: Three
    area: Positive
    efficiency: Positive


@dataclass
class SensorEntry:
    """A sensor; the half of its field of view is in degrees."""

    type: SensorType
    enabled: bool
    half_field_of_view: Annotated[float, Interval(ge=1e-6, le=85.0)]
    power: Real


@dataclass
class BatteryEntry:
    """A battery, and the fraction of its charge."""

    capacity: Annotated[float, Interval(ge=1e-6, le=1e15)]
    percentage: Annotated[float, Interval(ge=0.0, le=1.0)]


@dataclass
class ControlEntry:
    """Gains of the control of the attitude."""

    k: Positive
    ki: Real
    p: Positive
    integral_limit: Positive


@dataclass
class WheelEntry:
    """A reaction wheel; its speed is in rpm."""

    rw_direction: Three
    max_momentum: Annotated[float, Interval(ge=1e-9, le=1e15)]
    rw_speed_init: Real
    power: Real
    efficiency: Real


@dataclass
class SatelliteEntry:
    """A satellite."""

    id: Count
    orbit: Count
    true_anomaly: Real
    mass: Annotated[float, Interval(ge=1e-6, le=1e15)]
    inertia: Annotated[list[Real], Len(9, 9)]
    center_of_mass: Three
    solar_panel: PanelEntry
    sensor: SensorEntry
    battery: BatteryEntry
    mrp_control: ControlEntry
    reaction_wheels: Annotated[list[WheelEntry], Len(3, 3)]
    mrp_attitude_bn: Three = field(default_factory=lambda: [0.0] * 3)


@dataclass
class TaskEntry:
    """A task: its place, degrees, and times, s."""

    id: Count
    coordinate: Annotated[list[Real], Len(2, 2)]
    release_time: Positive
    due_time: Real
    duration: Annotated[float, Interval(ge=1.0, le=255.0)]
    sensor_type: SensorType

    def __post_init__(self) -> None:
        if not -90.0 <= self.coordinate[0] <= 90.0:
            raise ValueError(f"coordinate={self.coordinate} must be latitude and longitude, degrees")
        if self.due_time < self.release_time:
            raise ValueError(f"due_time={self.due_time:g} s is before release_time={self.release_time:g} s")


TaskList = Annotated[list[TaskEntry], Len(1, MOST_TASKS)]


@dataclass
class Constellation:
    """Content of a file of satellites."""

    orbits: list[OrbitEntry]
    satellites: Annotated[list[SatelliteEntry], Len(1, MOST_SATELLITES)]


@dataclass
class TaskSet:
    """Content of a file of tasks; it may also be their list alone."""

    tasks: TaskList


def _read(path: Path, schema: Any) -> Any:
    try:
        content = read_bytes(path, MOST_JSON)
        return parse_json(content, TaskList if schema is TaskSet and content.lstrip().startswith(b"[") else schema)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


# -- constellations -----------------------------------------------------------------------------------------------------------

Satellites = list[dict[str, Any]]
"""Arguments of each satellite of a case by name, with ``sensor_type`` and ``sensor_enabled``."""


def _constellation(path: Path) -> Satellites:
    """Return the arguments of the satellites of a file, sorted by their ids."""
    content: Constellation = _read(path, Constellation)
    orbits = {orbit.id: orbit for orbit in content.orbits}
    ids = [entry.id for entry in content.satellites]
    if len(set(ids)) < len(ids):
        raise ValueError(f"{path}: satellites have the ids {ids}; give each satellite its id")
    for k, entry in enumerate(content.satellites):
        if entry.orbit not in orbits:
            raise ValueError(f"{path}: satellites[{k}].orbit={entry.orbit} is not among the ids of orbits, {sorted(orbits)}")
    return [_satellite(entry, orbits[entry.orbit]) for entry in sorted(content.satellites, key=lambda entry: entry.id)]


def _satellite(entry: SatelliteEntry, orbit: OrbitEntry) -> dict[str, object]:
    panel, sensor, control, wheels = entry.solar_panel, entry.sensor, entry.mrp_control, entry.reaction_wheels
    degrees = [orbit.inclination, orbit.right_ascension_of_the_ascending_node, orbit.argument_of_perigee, entry.true_anomaly]
    return {
        "mass": entry.mass,
        "inertia": entry.inertia,
        "r_CB_B": entry.center_of_mass,
        "sigma_init": entry.mrp_attitude_bn,
        "oe": [orbit.semi_major_axis, orbit.eccentricity, *map(math.radians, degrees)],
        "rwAxes_B": [wheel.rw_direction for wheel in wheels],
        "rwJs": [wheel.max_momentum / (TOP_SPEED * math.pi / 30.0) for wheel in wheels],
        "wheelSpeeds": [wheel.rw_speed_init for wheel in wheels],
        "rwBasePower": [wheel.power for wheel in wheels],
        "rwMechToElecEfficiency": [wheel.efficiency for wheel in wheels],
        "nHat_B": panel.direction,
        "panelArea": panel.area * math.hypot(*panel.direction),  # Basilisk takes the normal as it is given
        "panelEfficiency": panel.efficiency,
        "sensorPower": -sensor.power,
        "sensorFieldOfView": math.radians(sensor.half_field_of_view),
        "batteryStorageCapacity": entry.battery.capacity,
        "storedCharge_Init": entry.battery.capacity * entry.battery.percentage,
        "K": control.k,
        "Ki": control.ki,
        "P": control.p,
        "integralLimit": control.integral_limit,
        "sensor_type": float(sensor.type),
        "sensor_enabled": float(sensor.enabled),
    }


# -- tasks --------------------------------------------------------------------------------------------------------------------

Tasks = list[dict[str, float]]
"""``latitude`` and ``longitude``, degrees, ``release``, ``due``, ``duration`` and ``type`` of each task of a case."""


def _tasks(path: Path) -> Tasks:
    """Return the tasks of a file, sorted by their ids."""
    content: TaskSet | list[TaskEntry] = _read(path, TaskSet)
    entries = content.tasks if isinstance(content, TaskSet) else content
    return [
        {
            "latitude": entry.coordinate[0],
            "longitude": entry.coordinate[1],
            "release": entry.release_time,
            "due": entry.due_time,
            "duration": entry.duration,
            "type": float(entry.sensor_type),
        }
        for entry in sorted(entries, key=lambda entry: entry.id)
    ]


# -- tables -------------------------------------------------------------------------------------------------------------------


def stacked(cases: Sequence[tuple[str, Satellites, Tasks]], satellites: int | None, tasks: int | None) -> Cases:
    """Return cases, by name, with their satellites and tasks, as tables."""
    most = [max(len(part[k]) for part in cases) for k in (1, 2)]
    limits = {"satellites": satellites, "tasks": tasks}
    sizes = [
        biggest if size is None else whole(title, size, 1) for biggest, (title, size) in zip(most, limits.items(), strict=True)
    ]
    for name, *parts in cases:
        for title, part, size in zip(limits, parts, sizes, strict=True):
            if len(part) > size:
                raise ValueError(f"case {name!r} has {len(part)} {title}, more than {title}={size}")

    def table(rows: Sequence[Sequence[object]], size: int) -> Tensor:
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
