"""Satellites and surroundings of an environment, for recordings."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.env import Tasking
from bsk_torch.env.action_forms import form
from bsk_torch.sim.places import FixedPlaces
from bsk_torch.tasks.aeos_bench import AEOSBench
from bsk_torch.tasks.aeos_bench.scene import PLACES as TASK_PLACES
from bsk_torch.tasks.inspection import RSOInspectionReward, RSOPoints
from bsk_torch.tasks.objects import RSOTargets
from bsk_torch.viewer.recording import Array, Craft, Instrument, Places, Scene
from bsk_torch.viz.recorders.inspection import rewarder_of as inspection_of
from bsk_torch.viz.render.moment import stations_of

if TYPE_CHECKING:
    from bsk_torch.env.satellite_group import SatelliteGroup
    from bsk_torch.sim.simulator import Simulator

CHIEF = "Chief"
"""Name of the spacecraft at the origin of a Hill frame, where only spacecraft that fly relative to it are simulated."""

RELATIVE = "rho_H"
"""Field of the state of spacecraft that are simulated relative to a chief."""

LEVEL = 0.5 * math.pi
"""Elevation of stations that see nothing."""


def is_relative(env: Tasking) -> bool:
    """Return whether the spacecraft of an environment are simulated relative to a chief, without the Earth."""
    return RELATIVE in env.satellites[0].simulator.state.layout.fields


def places_of(env: Tasking) -> Places:
    """Return what the targets of an environment are."""
    if isinstance(env.scenario, RSOTargets):
        return "orbit"
    if points_of(env) is not None:
        return "points"
    return "ground" if ground_targets(env) is not None else "none"


def crafts_of(env: Tasking) -> list[Craft]:
    """Return the satellites of an environment in the order of its names, and the chief if it is not one of them."""
    found: dict[int, Craft] = {}
    for satellite in env.satellites:
        for number, column in enumerate(satellite.simulator.columns):
            found[column] = _craft(satellite, env.fleet.names[column], number)
    chief = [Craft(name=CHIEF, kind=CHIEF, actions=[])] if is_relative(env) else []
    return [found[column] for column in sorted(found)] + chief


def _craft(satellite: SatelliteGroup, name: str, number: int) -> Craft:
    simulator, labels = satellite.simulator, list(satellite.action_description)
    discrete = form(satellite) is None
    accuracy = _argument(simulator, "imageAttErrorRequirement", number)
    axis, panel = (_argument(simulator, key, number) for key in ("inst_pHat_B", "nHat_B"))
    instrument = None
    if axis is not None and accuracy is not None:
        instrument = Instrument(axis_B=axis, half_angle=4.0 * math.atan(accuracy[0]))
    return Craft(
        name=name,
        kind=type(satellite).__name__,
        actions=labels if discrete else [],
        controls=[] if discrete else labels,
        observation=list(satellite.observation_description),
        instrument=instrument,
        panel_normal_B=panel,
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


def scene_of(env: Tasking, seed: int) -> Scene:
    """Return the surroundings of episode 0 of an environment, which has just begun."""
    relative = is_relative(env)
    points = points_of(env)
    names = next((list(places.names) for places in _stations(env)), [])
    targets, priority, cloud = _targets(env, points)
    arrays = {
        "stations_P": _array(stations_of(env.fleet.simulators)).reshape(-1, 3),
        "targets_P": targets,
        "priority": priority,
        **({} if cloud is None else {"cloud": cloud}),
    }
    owner = None
    if isinstance(env.scenario, RSOPoints):
        owner = env.scenario.rso_column
    elif points is not None:
        owner = env.fleet.size
    return Scene(
        seed=seed,
        et=float(env.fleet.simulators[0].arcs.et[0]),
        PN0=[] if relative else env.fleet.simulators[0].world.PN[0].flatten().tolist(),
        rate=EARTH_ROTATION_RATE,
        station_names=names,
        points_of=owner,
        arrays=arrays,
    )


def station_elevation(env: Tasking) -> float:
    """Return the least elevation at which the stations of an environment see satellites, rad."""
    for satellite in env.satellites:
        if next(_stations(env), None) is not None:
            found = _world_argument(satellite.simulator, "gsMinimumElevation")
            if found is not None:
                return found
    return LEVEL


def _world_argument(simulator: Simulator, name: str) -> float | None:
    found = _argument(simulator, name, 0)
    return None if found is None else found[0]


def _stations(env: Tasking) -> Any:
    for simulator in env.fleet.simulators:
        stations = None if simulator.access is None else simulator.access.kinds.get("ground_station")
        if isinstance(stations, FixedPlaces):
            yield stations


def points_of(env: Tasking) -> Tensor | None:
    """Return the inspected points of episode 0 in the frame of their spacecraft, [T, 3] m; None where there are none."""
    if isinstance(env.scenario, RSOPoints):
        return torch.tensor([list(point.r_PB_B) for point in env.scenario.points_of(0)], dtype=torch.float64)
    points = getattr(env.rewarder, "points", None)  # of a chief that is not simulated
    return points.cpu() if is_relative(env) and isinstance(points, Tensor) else None


def ground_targets(env: Tasking) -> Tensor | None:
    """Return the Earth-fixed targets of episode 0, [T, 3] m, NaN for padding; None where there are none."""
    scenario: Any = env.scenario
    if isinstance(scenario, AEOSBench):
        exists, r_P = scenario.task_exists[0], scenario.drawn(TASK_PLACES)[0]
    elif hasattr(scenario, "most_targets"):
        exists, r_P = scenario.drawn("target_exists")[0] > 0.5, scenario.r_LP_P[0]
    else:
        return None
    return torch.where(exists.unsqueeze(-1), r_P, torch.nan).cpu()


def _targets(env: Tasking, points: Tensor | None) -> tuple[Array, Array, Array | None]:
    """Positions [T, 3], priorities [T] and true clouds [T] of targets."""
    scenario: Any = env.scenario
    if points is not None:
        return _array(points), np.ones(len(points)), None
    if isinstance(scenario, RSOTargets):
        return np.full((scenario.n_targets, 3), np.nan), _array(scenario.priority[0]), None
    ground = ground_targets(env)
    if ground is None:
        return np.zeros((0, 3)), np.zeros(0), None
    priority = _array(scenario.priority[0]) if hasattr(scenario, "priority") else np.ones(len(ground))
    cloud = _array(scenario.cloud_cover[0]) if hasattr(scenario, "cloud_cover") else None
    return _array(ground), priority, cloud


def _array(value: Tensor) -> Array:
    found: Array = value.detach().double().cpu().numpy()
    return found


def inspected_of(env: Tasking) -> Tensor | None:
    """Return which points of episode 0 have been inspected, [T] bool; None where there are none."""
    rewarder = inspection_of(env)
    if isinstance(rewarder, RSOInspectionReward):
        return rewarder.inspected[0].cpu()
    found = getattr(env.rewarder, "inspected", None)
    return found.view(found.shape[0], -1)[0].cpu() > 0 if points_of(env) is not None and isinstance(found, Tensor) else None
