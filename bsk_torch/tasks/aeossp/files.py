"""Files of aeossp_standard: cases in YAML, solutions in JSON.

The format is that of the benchmark *aeossp_standard* of github.com/Mtrya/astro-reason (MIT license), commit ffd1e89.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from annotated_types import Gt, Interval, Len
from numpy.typing import NDArray

from bsk_torch.files import write_file
from bsk_torch.formats.tle import read_tle
from bsk_torch.sim.names import nearest
from bsk_torch.untrusted import MOST_JSON, Word, parse_json, parse_yaml, read_bytes

Content = TypeVar("Content")

MISSION, SATELLITES, TASKS = "mission.yaml", "satellites.yaml", "tasks.yaml"
"""Files of a case."""

MOST_ACTIONS = 2**17

LONGEST_HORIZON = 7 * 86400
"""Longest horizon that is read, s; the benchmark's has twelve hours."""

Sensor = Literal["visible", "infrared"]
Above = Annotated[float, Gt(0.0)]
NotNegative = Annotated[float, Interval(ge=0.0)]
Step = Annotated[int, Interval(ge=1, le=3600)]


# -- what files hold ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CaseSatellite:
    """A satellite of a case, with numbers as the file has them.

    Attributes:
        name: Its ``satellite_id``.
        line1: First line of the element set.
        line2: Second line.
        sensor: Type of its sensor.
        slew_rate: Largest rate of a slew, deg/s.
        slew_acceleration: Largest angular acceleration, deg/s^2.
        settling_s: Time after each slew, s.
        off_nadir: Largest angle from the direction to Earth's center, deg.
        capacity_wh: Capacity of the battery, Wh.
        initial_wh: Its charge at the start, Wh.
        idle_w: Constant load, W.
        imaging_w: Further load during an observation, W.
        slew_w: Further load during slew and settling, W.
        charge_w: Power of the panels in sunlight, W.
    """

    name: str
    line1: str
    line2: str
    sensor: Sensor
    slew_rate: float
    slew_acceleration: float
    settling_s: float
    off_nadir: float
    capacity_wh: float
    initial_wh: float
    idle_w: float
    imaging_w: float
    slew_w: float
    charge_w: float


@dataclass(frozen=True)
class Requests:
    """The T tasks of a case, in the order of the file.

    Attributes:
        names: Their ``task_id``.
        titles: Names of the places.
        latitude: Geodetic latitudes on WGS84, deg, [T].
        longitude: Longitudes, deg, [T].
        altitude: Heights above the ellipsoid, m, [T].
        release_s: Earliest starts, s from the start of the horizon, [T] int64.
        due_s: Latest ends, likewise.
        duration_s: Lengths of the observations, s, [T] int64.
        sensor: Types of sensor, T of them.
        weight: Weights, [T].
    """

    names: tuple[str, ...]
    titles: tuple[str, ...]
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]
    altitude: NDArray[np.float64]
    release_s: NDArray[np.int64]
    due_s: NDArray[np.int64]
    duration_s: NDArray[np.int64]
    sensor: tuple[Sensor, ...]
    weight: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class Case:
    """A case of the benchmark.

    Attributes:
        name: Its ``case_id``.
        start: Start of the horizon, UTC.
        horizon_s: Length of the horizon, s.
        step_s: Step of the grid on which actions begin and end, and on which their geometry is sampled, s.
        resource_step_s: Step of the battery, s.
        satellites: The satellites.
        requests: The tasks.
    """

    name: str
    start: datetime
    horizon_s: int
    step_s: int
    resource_step_s: int
    satellites: tuple[CaseSatellite, ...]
    requests: Requests


@dataclass(frozen=True)
class Observations:
    """The n observations of a solution, in its order.

    Attributes:
        satellite: Numbers of the satellites in the case, [n] int64.
        task: Numbers of the tasks, [n] int64.
        start_s: Starts, s from the start of the horizon, [n] int64, on the case's grid.
        end_s: Ends, likewise.
    """

    satellite: NDArray[np.int64]
    task: NDArray[np.int64]
    start_s: NDArray[np.int64]
    end_s: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.satellite)

    def take(self, rows: NDArray[np.generic]) -> Observations:
        """Return the observations at ``rows``, a mask [n] or numbers [m]."""
        return Observations(self.satellite[rows], self.task[rows], self.start_s[rows], self.end_s[rows])


# -- schemas --------------------------------------------------------------------------------------------------------------------


@dataclass
class Propagation:
    """Model of the orbits."""

    model: Literal["sgp4"]


@dataclass
class MissionEntry:
    """Horizon and steps of a case."""

    case_id: Word
    horizon_start: Word
    horizon_end: Word
    action_time_step_s: Step
    geometry_sample_step_s: Step
    resource_sample_step_s: Step
    propagation: Propagation

    def __post_init__(self) -> None:
        start, end = _instant("horizon_start", self.horizon_start), _instant("horizon_end", self.horizon_end)
        seconds = (end - start).total_seconds()
        if not 0 < seconds <= LONGEST_HORIZON:
            raise ValueError(f"horizon_end={self.horizon_end!r} must be up to {LONGEST_HORIZON} s after {self.horizon_start!r}")
        for name in ("action_time_step_s", "resource_sample_step_s"):
            if seconds % getattr(self, name):
                raise ValueError(f"{name}={getattr(self, name)} must divide the {seconds:g} s of the horizon")
        if self.geometry_sample_step_s != self.action_time_step_s:
            step = self.geometry_sample_step_s
            raise ValueError(f"geometry_sample_step_s={step} must be action_time_step_s={self.action_time_step_s}")


@dataclass
class MissionFile:
    """Content of mission.yaml."""

    mission: MissionEntry


@dataclass
class SensorEntry:
    """Sensor of a satellite."""

    sensor_type: Sensor


@dataclass
class AttitudeEntry:
    """Limits of a satellite's attitude."""

    max_slew_velocity_deg_per_s: Above
    max_slew_acceleration_deg_per_s2: Above
    settling_time_s: NotNegative
    max_off_nadir_deg: Annotated[float, Interval(ge=0.0, lt=90.0)]


@dataclass
class ResourceEntry:
    """Battery and power of a satellite."""

    battery_capacity_wh: Above
    initial_battery_wh: NotNegative
    idle_power_w: NotNegative
    imaging_power_w: NotNegative
    slew_power_w: NotNegative
    sunlit_charge_power_w: NotNegative

    def __post_init__(self) -> None:
        if self.initial_battery_wh > self.battery_capacity_wh:
            most = self.battery_capacity_wh
            raise ValueError(f"initial_battery_wh={self.initial_battery_wh:g} must be at most battery_capacity_wh={most:g}")


@dataclass
class SatelliteEntry:
    """A satellite."""

    satellite_id: Word
    norad_catalog_id: int
    tle_line1: Word
    tle_line2: Word
    sensor: SensorEntry
    attitude_model: AttitudeEntry
    resource_model: ResourceEntry

    def __post_init__(self) -> None:
        try:
            read_tle(f"{self.tle_line1}\n{self.tle_line2}")
        except ValueError as error:
            raise ValueError(f"tle_line1, tle_line2: {error}") from None


@dataclass
class SatelliteFile:
    """Content of satellites.yaml."""

    satellites: Annotated[list[SatelliteEntry], Len(1, 1000)]


@dataclass
class TaskEntry:
    """A task."""

    task_id: Word
    name: Word
    latitude_deg: Annotated[float, Interval(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[float, Interval(ge=-180.0, le=180.0)]
    altitude_m: Annotated[float, Interval(ge=-1000.0, le=10000.0)]
    release_time: Word
    due_time: Word
    required_duration_s: Annotated[int, Gt(0)]
    required_sensor_type: Sensor
    weight: Above = 1.0

    def __post_init__(self) -> None:
        release, due = _instant("release_time", self.release_time), _instant("due_time", self.due_time)
        if due <= release:
            raise ValueError(f"due_time={self.due_time!r} must be after release_time={self.release_time!r}")
        if self.required_duration_s > (due - release).total_seconds():
            window = (due - release).total_seconds()
            raise ValueError(f"required_duration_s={self.required_duration_s} is more than the {window:g} s of its window")


@dataclass
class TaskFile:
    """Content of tasks.yaml."""

    tasks: Annotated[list[TaskEntry], Len(1, 20_000)]


@dataclass
class ActionEntry:
    """An action of a solution."""

    type: Literal["observation"]
    satellite_id: Word
    task_id: Word
    start_time: Word
    end_time: Word


@dataclass
class SolutionFile:
    """Content of a solution; the benchmark reads one without ``actions`` as an empty plan."""

    actions: Annotated[list[ActionEntry], Len(0, MOST_ACTIONS)] | None = None


# -- cases ----------------------------------------------------------------------------------------------------------------------


def read_case(folder: str | Path) -> Case:
    """Return the case in a folder with mission.yaml, satellites.yaml and tasks.yaml.

    Raises:
        OSError: If a file is missing, or cannot be read.
        ValueError: For other content; the message has the file, the line or the entry, its value, and what is allowed.
    """
    folder = Path(folder)
    mission = _read(folder / MISSION, MissionFile).mission
    satellites = _read(folder / SATELLITES, SatelliteFile).satellites
    _check_unique(folder / SATELLITES, "satellites", "satellite_id", [entry.satellite_id for entry in satellites])
    start = _instant("horizon_start", mission.horizon_start)
    horizon_s = int((_instant("horizon_end", mission.horizon_end) - start).total_seconds())
    return Case(
        name=mission.case_id,
        start=start,
        horizon_s=horizon_s,
        step_s=mission.action_time_step_s,
        resource_step_s=mission.resource_sample_step_s,
        satellites=tuple(_satellite(entry) for entry in satellites),
        requests=_read_requests(folder / TASKS, start, horizon_s, mission.action_time_step_s),
    )


def _satellite(entry: SatelliteEntry) -> CaseSatellite:
    attitude, resource = entry.attitude_model, entry.resource_model
    return CaseSatellite(
        name=entry.satellite_id,
        line1=entry.tle_line1,
        line2=entry.tle_line2,
        sensor=entry.sensor.sensor_type,
        slew_rate=attitude.max_slew_velocity_deg_per_s,
        slew_acceleration=attitude.max_slew_acceleration_deg_per_s2,
        settling_s=attitude.settling_time_s,
        off_nadir=attitude.max_off_nadir_deg,
        capacity_wh=resource.battery_capacity_wh,
        initial_wh=resource.initial_battery_wh,
        idle_w=resource.idle_power_w,
        imaging_w=resource.imaging_power_w,
        slew_w=resource.slew_power_w,
        charge_w=resource.sunlit_charge_power_w,
    )


def _read_requests(path: Path, start: datetime, horizon_s: int, step_s: int) -> Requests:
    entries = _read(path, TaskFile).tasks
    _check_unique(path, "tasks", "task_id", [entry.task_id for entry in entries])
    seconds = []
    for k, entry in enumerate(entries):
        try:
            row = [_second(name, getattr(entry, name), start, horizon_s, step_s) for name in ("release_time", "due_time")]
            if entry.required_duration_s % step_s:
                raise ValueError(f"required_duration_s={entry.required_duration_s} must be a multiple of {step_s} s")
        except ValueError as error:
            raise ValueError(f"{path}: tasks[{k}] ({entry.task_id!r}): {error}") from None
        seconds.append([*row, entry.required_duration_s])
    release_s, due_s, duration_s = np.array(seconds, dtype=np.int64).T
    return Requests(
        names=tuple(entry.task_id for entry in entries),
        titles=tuple(entry.name for entry in entries),
        latitude=np.array([entry.latitude_deg for entry in entries]),
        longitude=np.array([entry.longitude_deg for entry in entries]),
        altitude=np.array([entry.altitude_m for entry in entries]),
        release_s=release_s,
        due_s=due_s,
        duration_s=duration_s,
        sensor=tuple(entry.required_sensor_type for entry in entries),
        weight=np.array([entry.weight for entry in entries]),
    )


def _read(path: Path, schema: type[Content]) -> Content:
    try:
        return parse_yaml(read_bytes(path, MOST_JSON), schema)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _check_unique(path: Path, entries: str, field: str, names: Sequence[str]) -> None:
    first: dict[str, int] = {}
    for k, name in enumerate(names):
        if first.setdefault(name, k) != k:
            raise ValueError(f"{path}: {entries}[{k}].{field}={name!r} is that of {entries}[{first[name]}], too")


def _instant(field: str, text: str) -> datetime:
    """Return a time in UTC; ValueError if it is no time of ISO 8601 with a zone."""
    try:
        instant = datetime.fromisoformat(text.replace("Z", "+00:00"))
        if instant.tzinfo is not None:
            return instant.astimezone(timezone.utc)
    except (ValueError, OverflowError):
        pass
    raise ValueError(f"{field}={text!r:.60} must be a time of ISO 8601 with its zone, such as '2026-04-14T04:00:00Z'")


def _second(field: str, text: str, start: datetime, horizon_s: int, step_s: int) -> int:
    """Return a time in seconds from the start of the horizon; ValueError unless it is on the grid within the horizon."""
    after = _instant(field, text) - start
    if after % timedelta(seconds=step_s) or not timedelta(0) <= after <= timedelta(seconds=horizon_s):
        raise ValueError(
            f"{field}={text!r:.60} must be a multiple of {step_s} s, and at most {horizon_s} s, after {start.isoformat()}"
        )
    return int(after.total_seconds())


# -- solutions ------------------------------------------------------------------------------------------------------------------


def read_solution(path: str | Path, case: Case) -> Observations:
    """Return the observations in a solution of a case.

    Whether they are valid is checked by :func:`bsk_torch.tasks.aeossp.rules.check`.

    Raises:
        OSError: If the file cannot be read.
        ValueError: For other content, unknown satellites and tasks, and times without a zone, off the grid or outside the
            horizon; the message has the file, the entry, its value, and what is allowed.
    """
    satellites = {satellite.name: k for k, satellite in enumerate(case.satellites)}
    tasks = {name: k for k, name in enumerate(case.requests.names)}
    rows = []
    try:
        for k, entry in enumerate(parse_json(read_bytes(path, MOST_JSON), SolutionFile).actions or ()):
            try:
                for field, name, known in (("satellite_id", entry.satellite_id, satellites), ("task_id", entry.task_id, tasks)):
                    if name not in known:
                        raise ValueError(f"{field}={name!r:.60} is not in the case; {nearest(name, known)}")
                times = [
                    _second(field, getattr(entry, field), case.start, case.horizon_s, case.step_s)
                    for field in ("start_time", "end_time")
                ]
            except ValueError as error:
                raise ValueError(f"actions[{k}]: {error}") from None
            rows.append([satellites[entry.satellite_id], tasks[entry.task_id], *times])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Observations(*np.array(rows, dtype=np.int64).reshape(-1, 4).T)


def write_solution(path: str | Path, case: Case, observations: Observations) -> None:
    """Write observations as a solution, in the order of their starts; OSError if the file cannot be written."""
    order = np.lexsort((observations.satellite, observations.start_s))
    rows = observations.take(order)
    actions = [
        {
            "type": "observation",
            "satellite_id": case.satellites[satellite].name,
            "task_id": case.requests.names[task],
            "start_time": iso(case, start),
            "end_time": iso(case, end),
        }
        for satellite, task, start, end in zip(
            *(column.tolist() for column in (rows.satellite, rows.task, rows.start_s, rows.end_s)), strict=True
        )
    ]
    write_file(path, json.dumps({"actions": actions}, indent=1) + "\n")


def iso(case: Case, second: float) -> str:
    """Return the time ``second`` seconds after the start of the horizon, in UTC, as files have it."""
    return (case.start + timedelta(seconds=second)).isoformat().replace("+00:00", "Z")
