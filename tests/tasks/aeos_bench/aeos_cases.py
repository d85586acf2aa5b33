"""A small case of AEOS-Bench in the form of its files."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

WHEELS = [
    {
        "rw_type": "Honeywell_HR16",
        "rw_direction": axis,
        "max_momentum": 50.0,
        "rw_speed_init": 500.0,
        "power": 6.0,
        "efficiency": 0.5,
    }
    for axis in ([1, 0, 0], [0, 1, 0], [0, 0, 1])
]

SATELLITE: dict[str, Any] = {
    "id": 0,
    "inertia": [100.0, 0, 0, 0, 110.0, 0, 0, 0, 90.0],
    "mass": 120.0,
    "center_of_mass": [0, 0, 0],
    "orbit": 0,
    "solar_panel": {"direction": [0, 1, 0], "area": 0.4, "efficiency": 0.3},
    "sensor": {"type": 1, "enabled": False, "half_field_of_view": 0.3, "power": 5.0},
    "battery": {"capacity": 20000.0, "percentage": 0.5},
    "reaction_wheels": WHEELS,
    "mrp_control": {"k": 8.0, "ki": 0.004, "p": 25.0, "integral_limit": 0.01},
    "true_anomaly": 30.0,
    "mrp_attitude_bn": [0, 0, 0],
}

ORBIT = {
    "id": 0,
    "eccentricity": 0.001,
    "semi_major_axis": 7.0e6,
    "inclination": 53.0,
    "right_ascension_of_the_ascending_node": 10.0,
    "argument_of_perigee": 90.0,
}


def constellation(count: int) -> dict[str, Any]:
    """Satellites a tenth of a turn apart."""
    satellites = [copy.deepcopy(SATELLITE) | {"id": k, "true_anomaly": 36.0 * k} for k in range(count)]
    return {"orbits": [dict(ORBIT)], "satellites": satellites}


def tasks(count: int) -> list[dict[str, Any]]:
    """Tasks all over the world, for the whole hour."""
    return [
        {
            "id": k,
            "release_time": 0,
            "due_time": 3600,
            "duration": 15,
            "coordinate": [60.0 - 120.0 * k / count, (137.5 * k) % 360.0 - 180.0],
            "sensor_type": 1,
        }
        for k in range(count)
    ]


def write(folder: Path, satellites: object, jobs: object) -> Path:
    """Write a case to a folder and return it."""
    folder.mkdir(exist_ok=True, parents=True)
    (folder / "constellation.json").write_text(json.dumps(satellites))
    (folder / "taskset.json").write_text(json.dumps(jobs))
    return folder
