"""Cases of AEOS-Bench in the form of its files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import torch

from bsk_torch.constants import RPM
from bsk_torch.files import write_file
from bsk_torch.tasks.aeos_bench.files import CONSTELLATION, EARTH_RADIUS, TASKS, TOP_SPEED, Cases
from bsk_torch.tasks.aeos_bench.generator import ORBIT_FIELDS

MOMENTA = {"Honeywell_HR12": (12, 25, 50), "Honeywell_HR14": (25, 50, 75), "Honeywell_HR16": (50, 75, 100)}
"""Types of wheels and their largest momenta, N m s; the type matters through the momentum only."""

OTHER_WHEEL = "Honeywell_HR16"
"""Type of wheels with another momentum."""


def case_content(cases: Cases, row: int) -> dict[str, Any]:
    """Return a case as the contents of its files, ``constellation`` and ``taskset``, with angles in degrees.

    Numbers are those of the case up to rounding: angles and momenta are converted.
    """
    one = {name: values[row].tolist() for name, values in cases.satellites.items()}
    crew = range(int(cases.present[row].sum()))
    crafts = [
        _satellite(
            {name: values[k] for name, values in one.items()}, k, cases.sensors[row, k].item(), bool(cases.enabled[row, k])
        )
        for k in crew
    ]
    orbits = []
    for k in crew:
        a, e, *angles = one["oe"][k][:5]
        orbits.append({"id": k} | dict(zip(ORBIT_FIELDS, (a, e, *map(math.degrees, angles)), strict=True)))
    return {"constellation": {"orbits": orbits, "satellites": crafts}, "taskset": _tasks(cases, row)}


def _satellite(craft: dict[str, Any], number: int, sensor: float, enabled: bool) -> dict[str, object]:
    momenta = [J * TOP_SPEED * RPM for J in craft["rwJs"]]
    wheels = zip(
        craft["rwAxes_B"], momenta, craft["wheelSpeeds"], craft["rwBasePower"], craft["rwMechToElecEfficiency"], strict=True
    )
    kinds = {round(value): kind for kind, values in MOMENTA.items() for value in values}
    return {
        "id": number,
        "inertia": craft["inertia"],
        "mass": craft["mass"],
        "center_of_mass": craft["r_CB_B"],
        "orbit": number,
        "solar_panel": {"direction": craft["nHat_B"], "area": craft["panelArea"], "efficiency": craft["panelEfficiency"]},
        "sensor": {
            "type": int(sensor),
            "enabled": enabled,
            "half_field_of_view": math.degrees(craft["sensorFieldOfView"]),
            "power": -craft["sensorPower"],
        },
        "battery": {
            "capacity": craft["batteryStorageCapacity"],
            "percentage": craft["storedCharge_Init"] / craft["batteryStorageCapacity"],
        },
        "reaction_wheels": [
            {
                "rw_type": kinds.get(round(momentum), OTHER_WHEEL),
                "rw_direction": axis,
                "max_momentum": momentum,
                "rw_speed_init": speed,
                "power": power,
                "efficiency": efficiency,
            }
            for axis, momentum, speed, power, efficiency in wheels
        ],
        "mrp_control": {"k": craft["K"], "ki": craft["Ki"], "p": craft["P"], "integral_limit": craft["integralLimit"]},
        "true_anomaly": math.degrees(craft["oe"][5]),
        "mrp_attitude_bn": craft["sigma_init"],
    }


def _tasks(cases: Cases, row: int) -> list[dict[str, object]]:
    x, y, z = (cases.places[row] / EARTH_RADIUS).unbind(-1)
    latitude, longitude = torch.rad2deg(torch.atan2(z, torch.hypot(x, y))), torch.rad2deg(torch.atan2(y, x))
    numbers = {name: values[row].tolist() for name, values in cases.tasks.items()}
    return [
        {
            "id": k,
            "release_time": int(numbers["release"][k]),
            "due_time": int(numbers["due"][k]),
            "duration": int(numbers["duration"][k]),
            "coordinate": [latitude[k].item(), longitude[k].item()],
            "sensor_type": int(numbers["type"][k]),
        }
        for k in range(cases.n_tasks)
        if numbers["duration"][k] > 0.0
    ]


def write_cases(cases: Cases, folder: str | Path) -> list[Path]:
    """Write cases in a form that :func:`read_cases` and the benchmark's programs read, and return their folders.

    A case is ``NAME/constellation.json`` and ``NAME/taskset.json``. Names of drawn cases are their numbers, from ``00000`` on.
    """
    names = cases.names or tuple(f"{k:05d}" for k in range(len(cases)))
    folders = [Path(folder) / name for name in names]
    for row, place in enumerate(folders):
        place.mkdir(parents=True, exist_ok=True)
        content = case_content(cases, row)
        for kind in (CONSTELLATION, TASKS):
            write_file(place / f"{kind}.json", json.dumps(content[kind]) + "\n")
    return folders
