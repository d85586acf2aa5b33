"""A small case for flights: three real satellites, and places below their tracks."""

from __future__ import annotations

import dataclasses
from datetime import datetime, timezone
from functools import cache
from pathlib import Path

import numpy as np

from bsk_torch.astro.earth_rotation import sidereal_time_1982
from bsk_torch.tasks.aeossp import Case, CaseSatellite, Observations, Requests
from bsk_torch.tasks.aeossp.geometry import ephemeris_time, orbit, turned

EARTH = 6_371e3
HORIZON = 1200

LINES = (
    (
        "1 28051U 03046A   26103.92936350  .00000126  00000+0  55914-4 0  9994",
        "2 28051  98.1985 143.5711 0064246 173.9227 286.4737 14.36137850171300",
    ),
    (
        "1 32783U 08021A   26103.91837750  .00000562  00000+0  82530-4 0  9990",
        "2 32783  97.7709 154.8031 0010967 327.3165  32.7367 14.79161859969302",
    ),
)
"""Element sets of two satellites of the benchmark's case test/case_0001."""

AGILE = dict(slew_rate=1.8, slew_acceleration=0.4, settling_s=2.0, off_nadir=30.0)
SLOW = dict(slew_rate=0.9, slew_acceleration=0.15, settling_s=3.5, off_nadir=30.0)
BATTERY = dict(capacity_wh=1300.0, initial_wh=800.0, idle_w=20.0, imaging_w=420.0, slew_w=360.0, charge_w=85.0)


def satellite(number: int, orbit_number: int, limits: dict[str, float], **battery: float) -> CaseSatellite:
    line1, line2 = LINES[orbit_number]
    return CaseSatellite(f"sat_{number}", line1, line2, "visible", **limits, **(BATTERY | battery))


def case_of(satellites: list[CaseSatellite], looks: list[tuple[int, int, int, float]]) -> tuple[Case, Observations]:
    """A case, and a plan of looks: satellite, start and duration, s, and the angle across from nadir in their middle, deg."""
    start = datetime(2026, 4, 14, 4, tzinfo=timezone.utc)
    no_requests = Requests((), (), *(np.zeros(0) for _ in range(6)), (), np.zeros(0))
    case = Case("small", start, HORIZON, 5, 10, tuple(satellites), no_requests)
    count = len(looks)
    number, first, duration, _ = (np.array(column) for column in zip(*looks, strict=True))
    places = np.stack([place(case, int(s), a + 0.5 * d, x) for s, a, d, x in looks])
    length = np.linalg.norm(places, axis=-1)
    requests = Requests(
        names=tuple(f"task_{k}" for k in range(count)),
        titles=("place",) * count,
        latitude=np.degrees(np.arcsin(places[:, 2] / length)),
        longitude=np.degrees(np.arctan2(places[:, 1], places[:, 0])),
        altitude=np.zeros(count),
        release_s=np.zeros(count, dtype=np.int64),
        due_s=np.full(count, HORIZON),
        duration_s=duration,
        sensor=("visible",) * count,
        weight=1.0 + np.arange(count),
    )
    plan = Observations(number, np.arange(count), first, first + duration)
    return dataclasses.replace(case, requests=requests), plan


def place(case: Case, number: int, second: float, across: float) -> np.ndarray:
    """Where the line of sight, turned from nadir across the track, meets the Earth, m, Earth-fixed."""
    at = np.array([second])
    r, v = (part[0] for part in orbit(case, number, at))
    normal = np.cross(r, v)
    line = -r / np.linalg.norm(r) * np.cos(np.radians(across)) + normal / np.linalg.norm(normal) * np.sin(np.radians(across))
    along = -(r @ line)
    point = r + line * (along - np.sqrt(EARTH**2 - r @ r + along**2))
    return turned(point[None], -sidereal_time_1982(ephemeris_time(case, at)).numpy())[0]


LOOKS = [
    (0, 300, 10, 10.0),
    (0, 340, 15, -15.0),  # 25 degrees away, 30 s later
    (0, 360, 10, 20.0),  # 35 degrees away, 5 s later
    (0, 500, 10, 0.0),
    (1, 300, 20, 10.0),
    (1, 400, 10, -20.0),
    (1, 700, 10, 38.0),  # beyond the limit of 30 degrees
    (2, 200, 10, 5.0),
    (2, 240, 15, -12.0),
    (2, 900, 60, 0.0),
]
"""Satellite, start, duration, angle across."""


@cache
def small() -> tuple[Case, Observations]:
    """The case, and a plan of which some observations cannot be delivered."""
    crew = [satellite(0, 0, AGILE), satellite(1, 1, SLOW), satellite(2, 0, AGILE, initial_wh=9.0, charge_w=5.0, idle_w=10.0)]
    return case_of(crew, LOOKS)


def write_case(folder: Path, case: Case) -> None:
    """Write the files of a case."""
    stamp = "%Y-%m-%dT%H:%M:%SZ"
    end = case.start.timestamp() + case.horizon_s

    def text(second: float) -> str:
        return datetime.fromtimestamp(case.start.timestamp() + second, timezone.utc).strftime(stamp)

    folder.mkdir(parents=True)
    (folder / "mission.yaml").write_text(
        f"mission:\n  case_id: {case.name}\n  horizon_start: '{text(0)}'\n"
        f"  horizon_end: '{datetime.fromtimestamp(end, timezone.utc).strftime(stamp)}'\n  action_time_step_s: {case.step_s}\n"
        f"  geometry_sample_step_s: {case.step_s}\n  resource_sample_step_s: {case.resource_step_s}\n"
        "  propagation: {model: sgp4}\n"
    )
    (folder / "satellites.yaml").write_text(
        "satellites:\n"
        + "".join(
            f"- satellite_id: {s.name}\n  norad_catalog_id: {int(s.line1[2:7])}\n  tle_line1: '{s.line1}'\n"
            f"  tle_line2: '{s.line2}'\n  sensor: {{sensor_type: {s.sensor}}}\n"
            f"  attitude_model: {{max_slew_velocity_deg_per_s: {s.slew_rate}, max_slew_acceleration_deg_per_s2: "
            f"{s.slew_acceleration}, settling_time_s: {s.settling_s}, max_off_nadir_deg: {s.off_nadir}}}\n"
            f"  resource_model: {{battery_capacity_wh: {s.capacity_wh}, initial_battery_wh: {s.initial_wh}, idle_power_w: "
            f"{s.idle_w}, imaging_power_w: {s.imaging_w}, slew_power_w: {s.slew_w}, sunlit_charge_power_w: {s.charge_w}}}\n"
            for s in case.satellites
        )
    )
    requests = case.requests
    (folder / "tasks.yaml").write_text(
        "tasks:\n"
        + "".join(
            f"- {{task_id: {name}, name: place, latitude_deg: {requests.latitude[k]!r}, longitude_deg: "
            f"{requests.longitude[k]!r}, altitude_m: 0.0, release_time: '{text(int(requests.release_s[k]))}', due_time: "
            f"'{text(int(requests.due_s[k]))}', required_duration_s: {requests.duration_s[k]}, required_sensor_type: visible, "
            f"weight: {requests.weight[k]!r}}}\n"
            for k, name in enumerate(requests.names)
        )
        .replace("np.float64(", "")
        .replace("),", ",")
        .replace(")}", "}")
    )
