"""What recordings and films read of an environment: satellites, surroundings, quantities, causes of death."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from bsk_torch.act.base import Action
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.env import Tasking
from bsk_torch.env.action_forms import form
from bsk_torch.recording.recording import Array, Craft, Instrument, Scene
from bsk_torch.scene.recorded import RecordedTargets
from bsk_torch.sim.places import FixedPlaces

if TYPE_CHECKING:
    from bsk_torch.env.satellite_group import SatelliteGroup
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.sim.simulator import Simulator

QUANTITIES = {
    "battery_charge_fraction": "battery",
    "storage_level_fraction": "data buffer",
    "wheel_speeds_fraction": "wheel speeds",
}
"""Recorded properties of the dynamics model, if the satellite has them, and their names in figures."""

CAUSES = {
    "battery_valid": "battery",
    "rw_speeds_valid": "wheel speeds",
    "data_storage_valid": "full buffer",
    "altitude_valid": "altitude",
    "fuel_remaining": "no fuel",
    "conjunction_valid": "collision",
    "range_valid": "out of range",
}
"""What a failed check of aliveness is called."""

NONE = -1
"""Target of a satellite that looks at none."""

SAME_PLANE = 1e-6
"""Nodes and inclinations, rad, that differ by less are those of one plane."""

CHIEF = "Chief"
"""Name of the spacecraft at the origin of a Hill frame, where only spacecraft that fly relative to it are simulated."""

RELATIVE = "rho_H"
"""Field of the state of spacecraft that are simulated relative to a chief."""

LEVEL = 0.5 * math.pi
"""Elevation of stations that see nothing."""


def is_relative(env: Tasking) -> bool:
    """Return whether the spacecraft of an environment are simulated relative to a chief, without the Earth."""
    return RELATIVE in env.satellites[0].simulator.state.layout.fields


def targets_of(env: Tasking, row: int = 0) -> RecordedTargets:
    """Return the targets of an episode, of the scenario or else of the rewarder."""
    targets = env.scenario.recorded_targets(row)
    if targets is None:
        targets = env.rewarder.recorded(row).targets
    nothing = torch.zeros(0, 3, dtype=torch.float64)
    return RecordedTargets(places="none", r=nothing, priority=nothing[:, 0]) if targets is None else targets


def quantities(fleet: SatelliteFleet) -> dict[str, Tensor]:
    """Return :data:`QUANTITIES` and fuel, m/s, of the satellites of episode 0, [S, width] each; NaN for those without them."""
    values = {name: [getattr(part.dynamics, name, None) for part in fleet.satellites] for name in QUANTITIES}
    values["fuel"] = [part.fsw.dv_available if part.simulator.has_tank else None for part in fleet.satellites]
    table = {}
    for name, parts in values.items():
        rows = [torch.empty(simulator.state.rows, 0, dtype=torch.float64, device=fleet.device) for simulator in fleet.simulators]
        rows = [row if part is None else part.double().reshape(len(row), -1) for row, part in zip(rows, parts, strict=True)]
        width = max(row.shape[1] for row in rows)
        if width:
            wide = [torch.nn.functional.pad(row, (0, width - row.shape[1]), value=torch.nan) for row in rows]
            table[name] = fleet.joined(wide)[0].cpu()
    return table


def causes_of(env: Tasking, row: int) -> list[str]:
    """The checks that a dead satellite fails, for each satellite of the fleet."""
    causes = [""] * env.fleet.size
    for satellite in env.satellites:
        simulator, first = satellite.simulator, row * satellite.simulator.count
        rows = slice(first, first + simulator.count)
        failed = {name: (~passed[rows]).tolist() for name, passed in satellite.aliveness().items()}
        for k, (column, dead) in enumerate(zip(simulator.columns, satellite.task.dead[rows].tolist(), strict=True)):
            if dead:
                causes[column] = ", ".join(CAUSES.get(name, name) for name, column_failed in failed.items() if column_failed[k])
    return causes


def aimed_at(satellite: SatelliteGroup) -> Tensor:
    """Return the targets that satellites of a type have chosen last, [N]; :data:`NONE` for none."""
    entries = (entry.aimed_at() for entry in satellite.actions.entries if isinstance(entry, Action))
    aims = next((aim for aim in entries if aim is not None), None)
    return getattr(satellite, "latest_target", torch.full_like(satellite.simulator.ticks, NONE)) if aims is None else aims


def stations_of(simulators: Iterable[Simulator]) -> Tensor:
    """Earth-fixed positions [K, 3] of the ground stations, if anybody sees some."""
    none = torch.empty(0, 3, dtype=torch.float64)
    return next((stations.r_LP_P[0] for stations in _stations(simulators)), none)


def _stations(simulators: Iterable[Simulator]) -> Iterator[FixedPlaces]:
    for simulator in simulators:
        stations = None if simulator.access is None else simulator.access.kinds.get("ground_station")
        if isinstance(stations, FixedPlaces):
            yield stations


def _planes(env: Tasking) -> list[int]:
    """Orbital plane of each satellite of episode 0; empty where orbits were not given as elements."""
    simulators = env.fleet.simulators
    if any("oe" not in simulator.state.arguments or simulator.argument("oe") is None for simulator in simulators):
        return []
    oe = env.fleet.each(lambda part: part.simulator.state.arguments["oe"])[0].cpu()
    _, plane = torch.unique(torch.round(oe[:, 2:4] / SAME_PLANE), dim=0, return_inverse=True)
    planes: list[int] = plane.tolist()
    return planes


def crafts_of(env: Tasking) -> list[Craft]:
    """Return the satellites of an environment in the order of its names, and the chief if it is not one of them."""
    crafts: dict[int, Craft] = {}
    for satellite in env.satellites:
        for number, column in enumerate(satellite.simulator.columns):
            crafts[column] = _craft(satellite, env.fleet.names[column], number)
    chief = [Craft(name=CHIEF, kind=CHIEF, actions=[])] if is_relative(env) else []
    return [crafts[column] for column in sorted(crafts)] + chief


def _craft(satellite: SatelliteGroup, name: str, number: int) -> Craft:
    simulator, labels = satellite.simulator, list(satellite.action_description)
    discrete = form(satellite) is None
    accuracy = _argument(simulator, "imageAttErrorRequirement", number)
    axis, panel = (_argument(simulator, key, number) for key in ("inst_pHat_B", "nHat_B"))
    instrument = None
    if axis is not None and accuracy is not None:
        instrument = Instrument(axis_B=axis, half_angle=4.0 * math.atan(accuracy[0]))
    least = _argument(simulator, "imageTargetMinimumElevation", number)
    return Craft(
        name=name,
        kind=type(satellite).__name__,
        actions=labels if discrete else [],
        controls=[] if discrete else labels,
        observation=list(satellite.observation_description),
        instrument=instrument,
        panel_normal_B=panel,
        tasks=[entry.name for entry in satellite.actions.entries],
        least_elevation=None if least is None else least[0],
    )


def _argument(simulator: Simulator, name: str, number: int) -> list[float] | None:
    """An argument of a satellite of episode 0; None where its type has none of that name."""
    try:
        value = simulator.argument(name)
    except KeyError:
        return None
    if value is None:
        return None
    row: list[float] = value[min(number, len(value) - 1)].double().flatten().tolist()
    return row


def scene_of(env: Tasking, seed: int, targets: RecordedTargets) -> Scene:
    """Return the surroundings of episode 0 of an environment, which has just begun, with its targets."""
    relative = is_relative(env)
    arrays = {
        "stations_P": _array(stations_of(env.fleet.simulators)).reshape(-1, 3),
        "targets_P": np.full(targets.r.shape, np.nan) if targets.places == "orbit" else _array(targets.r),
        "priority": _array(targets.priority),
        **({} if targets.cloud is None else {"cloud": _array(targets.cloud)}),
    }
    bearer = env.fleet.size if targets.owner is None else targets.owner  # the chief, where the owner is not simulated
    return Scene(
        seed=seed,
        et=float(env.fleet.simulators[0].arcs.et[0]),
        PN0=[] if relative else env.fleet.simulators[0].world.PN[0].flatten().tolist(),
        rate=EARTH_ROTATION_RATE,
        station_names=next((list(places.names) for places in _stations(env.fleet.simulators)), []),
        points_of=bearer if targets.places == "points" else None,
        planes=_planes(env),
        target_names=list(targets.names),
        viewers=list(targets.viewers),
        reach=targets.reach,
        arrays=arrays,
    )


def station_elevation(env: Tasking) -> float:
    """Return the least elevation at which the stations of an environment see satellites, rad."""
    if next(_stations(env.fleet.simulators), None) is None:
        return LEVEL
    least = (_argument(satellite.simulator, "gsMinimumElevation", 0) for satellite in env.satellites)
    return next((value[0] for value in least if value is not None), LEVEL)


def _array(value: Tensor) -> Array:
    array: Array = value.detach().double().cpu().numpy()
    return array
