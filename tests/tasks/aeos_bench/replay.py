"""Flights of AEOS-Bench's satellites (``scripts/recorders/record_aeos_bench.py``), and simulators that repeat them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from bsk_torch.constants import RPM
from bsk_torch.rand import first_key
from bsk_torch.sim.simulator import Simulator
from bsk_torch.tasks.aeos_bench import AEOSBenchDynModel, AEOSBenchFSWModel
from tests.basilisk.replay import RECORDINGS
from tests.sim.simulators import make_simulator

NAMES = ("random", "odd", "stiff", "greedy")
R_EARTH = 6378136.6  # m, the sphere of the benchmark
MAX_SPEED = 6000.0  # rpm

FIELDS = {
    "r": "r_BN_N",
    "v": "v_BN_N",
    "sigma": "sigma_BN",
    "omega": "omega_BN_B",
    "Omega": "Omega_WB_B",
    "u": "motor_torque_B",
    "sigma_BR": "location_sigma_BR",
    "integral": "control_integral_B",
    "charge": "charge",
    "wheel_power": "wheel_power",
}
"""State of a simulator by the name of what is recorded."""


def satellite_args(satellite: dict[str, Any], orbits: dict[int, dict[str, Any]]) -> dict[str, Any]:
    """Arguments of a satellite of a constellation file."""
    orbit, wheels, law, battery = (
        orbits[satellite["orbit"]],
        satellite["reaction_wheels"],
        satellite["mrp_control"],
        satellite["battery"],
    )
    angles = [orbit[key] for key in ("inclination", "right_ascension_of_the_ascending_node", "argument_of_perigee")]
    panel, sensor = satellite["solar_panel"], satellite["sensor"]
    return {
        "mass": satellite["mass"],
        "inertia": satellite["inertia"],
        "checkInertia": False,
        "r_CB_B": satellite["center_of_mass"],
        "sigma_init": satellite["mrp_attitude_bn"],
        "omega_init": [0.0, 0.0, 0.0],
        "oe": [orbit["semi_major_axis"], orbit["eccentricity"], *np.radians([*angles, satellite["true_anomaly"]]).tolist()],
        "mu": 398600.436e9,
        "min_orbital_radius": 0.0,
        "rwAxes_B": [wheel["rw_direction"] for wheel in wheels],
        "rwJs": [wheel["max_momentum"] / (MAX_SPEED * RPM) for wheel in wheels],
        "wheelSpeeds": [wheel["rw_speed_init"] for wheel in wheels],
        "u_max": [0.2] * 3,
        "rwOmegaMax": [MAX_SPEED] * 3,
        "rwBasePower": [wheel["power"] for wheel in wheels],
        "rwMechToElecEfficiency": [wheel["efficiency"] for wheel in wheels],
        "rwElecToMechEfficiency": [1.0] * 3,
        "nHat_B": panel["direction"],
        "panelArea": panel["area"],
        "panelEfficiency": panel["efficiency"],
        "sensorPower": -sensor["power"],
        "sensorFieldOfView": math.radians(sensor["half_field_of_view"]),
        "batteryStorageCapacity": battery["capacity"],
        "storedCharge_Init": battery["capacity"] * battery["percentage"],
        **{name: law[key] for name, key in (("K", "k"), ("Ki", "ki"), ("P", "p"), ("integralLimit", "integral_limit"))},
    }


class Flight:
    """A recorded flight; ``satellites`` are numbers of those that take part, in each of ``num_envs`` environments."""

    def __init__(self, name: str, satellites: Sequence[int] | None = None, num_envs: int = 1, **options: Any) -> None:
        self.file = self.file_of(name)
        constellation, self.tasks = (json.loads(str(self.file[key])) for key in ("constellation", "taskset"))
        all_satellites = constellation["satellites"]
        self.satellites = list(range(len(all_satellites))) if satellites is None else list(satellites)
        self.given = [all_satellites[k] for k in self.satellites]
        self.places_P = torch.tensor([place_P(*task["coordinate"]) for task in self.tasks], dtype=torch.float64)
        orbits = {orbit["id"]: orbit for orbit in constellation["orbits"]}
        self.simulator: Simulator = make_simulator(
            AEOSBenchDynModel,
            AEOSBenchFSWModel,
            [satellite_args(one, orbits) for one in self.given],
            {"utc_init": "2019 JAN 01 00:00:00.000 (UTC)"},
            num_envs=num_envs,
            columns=tuple(range(len(self.satellites))),
            **{"sim_rate": 1.0, "dtype": torch.float64, "backend": "compiled"} | options,
        )
        self.num_envs, self.everyone = num_envs, torch.ones(num_envs * len(self.satellites), dtype=torch.bool)
        self.simulator.reset(
            torch.arange(num_envs),
            self.simulator.type.arguments.draw(first_key(num_envs)),
            torch.zeros(num_envs, dtype=torch.float64),
        )

    @staticmethod
    def file_of(name: str) -> dict[str, NDArray[Any]]:
        """All arrays of a recording."""
        with np.load(RECORDINGS / f"aeos_bench_{name}.npz") as file:
            return dict(file)

    @property
    def no_access(self) -> Tensor:
        """What access is before the tick at time zero."""
        return torch.zeros(self.num_envs, len(self.satellites), len(self.tasks), dtype=torch.bool)

    def recorded(self, name: str) -> NDArray[np.float64]:
        """What is recorded of the satellites that take part, [T, S] or [T, S, 3]."""
        return self.file[name][:, self.satellites]

    def actions(self, ticks: int) -> tuple[Tensor, Tensor]:
        """After each tick: places in P, m, zero for the Earth's center, [ticks, S, 3], and whether sensors are on, [ticks, S]."""
        place = torch.zeros(ticks, len(self.satellites), 3, dtype=torch.float64)
        on = torch.tensor([one["sensor"]["enabled"] for one in self.given]).expand(ticks, -1).clone()
        for tick, satellite, task, toggle in self.file["action"].tolist():
            if satellite in self.satellites and tick < ticks:
                k = self.satellites.index(satellite)
                place[tick:, k] = self.places_P[task] if task >= 0 else 0.0
                on[tick:, k] ^= bool(toggle)
        return place, on

    def command(self, place: Tensor, on: Tensor) -> None:
        """Point at places [num_envs or 1, S, 3] with sensors [num_envs or 1, S] on or off."""
        off_mode, on_mode = (self.simulator.mode_index(f"sensor_{word}") for word in ("off", "on"))
        self.simulator.write("r_LP_P", self.everyone, place.expand(self.num_envs, -1, -1).reshape(-1, 3))
        self.simulator.command(self.everyone, torch.where(on.expand(self.num_envs, -1).reshape(-1), on_mode, off_mode))

    def run(self, ticks: Tensor | int) -> None:
        """Run ticks, the same number in all environments or one for each [num_envs]."""
        counts = torch.as_tensor(ticks).expand(self.num_envs).repeat_interleave(len(self.satellites))
        done = self.simulator.run(counts)
        assert torch.equal(done, counts)  # nothing ends a run

    def replay(self, ticks: int) -> Iterator[int]:
        """Fly the recorded actions; yields the number of each tick, from that at time zero, before the actions that follow it."""
        places, on = self.actions(ticks)
        for tick in range(ticks):
            yield tick
            self.command(places[tick : tick + 1], on[tick : tick + 1])
            self.run(1)
        yield ticks

    def read(self, name: str) -> NDArray[np.float64]:
        """A field by its recorded name, [num_envs, S] or [num_envs, S, 3]."""
        return self.simulator.read(FIELDS.get(name, name)).unflatten(0, (self.num_envs, -1)).numpy()

    def access(self) -> Tensor:
        """Which places are in the sensor's cone and above their horizon, [num_envs, S, tasks], by the model's observables."""
        model, observer = AEOSBenchDynModel, self.simulator.observer
        r, axis, cone = (observer.read(getattr(model, name).function) for name in ("r_BN_P", "boresight_P", "sensor_cone"))
        away = self.places_P - r.unsqueeze(1)
        along = (away * axis.unsqueeze(1)).sum(-1)
        across = (away - along.unsqueeze(-1) * axis.unsqueeze(1)).norm(dim=-1)
        above = (self.places_P * away).sum(-1) < 0.0
        return ((along >= 0.0) & (across < along * cone.unsqueeze(-1)) & above).unflatten(0, (self.num_envs, -1))


def place_P(latitude: float, longitude: float) -> list[float]:
    """Point of the sphere in the Earth-fixed frame, m, from degrees."""
    lat, lon = math.radians(latitude), math.radians(longitude)
    return [R_EARTH * math.cos(lat) * math.cos(lon), R_EARTH * math.cos(lat) * math.sin(lon), R_EARTH * math.sin(lat)]
