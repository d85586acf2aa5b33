"""State of one episode that a frame of a video shows, read without changing the episode."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch.astro.orbit import Elements, elements_to_rv, rv_to_elements
from bsk_torch.sim.places import FixedPlaces
from bsk_torch.tasks.objects import RSOTargets
from bsk_torch.tasks.objects.aim import AIM
from bsk_torch.tasks.objects.candidates import Candidates
from bsk_torch.vec3 import Vec3
from bsk_torch.viz.recorders.episode import QUANTITIES

if TYPE_CHECKING:
    from bsk_torch.env.base import Tasking
    from bsk_torch.env.satellite_group import SatelliteGroup
    from bsk_torch.sim.simulator import Simulator

DEAD = "dead"
"""Mode of a satellite that has died."""

IMAGING = "image"
"""Mode in which a satellite looks at the target that it has chosen last."""

IMAGING_OBJECT = "image_rso"
"""Mode in which a satellite looks at an object of a catalog."""

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

LOW = "battery"
"""The resource of which little is bad; of the others it is much."""

POINTS = 121
"""Points of a revolution."""

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, kw_only=True)
class Moment:
    """One episode with S satellites, K ground stations and T targets; positions in m, frames N (inertial) and P (Earth-fixed).

    Attributes:
        names: Name of each satellite.
        modes: What each is doing: the command of its flight software, or :data:`DEAD`.
        causes: Why each has died: the checks that fail, such as "battery"; empty for the living.
        r_N: Positions, [S, 3].
        orbits_N: One osculating revolution of each from there backwards, [S, M, 3].
        sun_N: Direction to the Sun, [3].
        PN: DCM from N to P, [3, 3].
        stations_P: Ground stations, [K, 3].
        targets_P: The targets that can be chosen now or have been imaged, or the objects of a catalog, [T, 3].
        imaged: Which of them have been imaged, [T].
        worth: Priority of each over the largest, [T].
        in_orbit: Whether the targets are in orbit.
        aims_P: Target that each satellite looks at, [S, 3]; not a number where there is none, or the Earth hides an object.
        links: Who has told whom after the last step, [S, S].
        levels: Resources by name, 0 to 1; of several satellites the worst, see :data:`LOW`.
        time: Seconds since reset.
        limit: Length of the episode, s; infinite where there is no limit.
        total: Return so far.
        counts: What is counted, by name, of all satellites together.
    """

    names: list[str]
    modes: list[str]
    causes: list[str]
    r_N: Array
    orbits_N: Array
    sun_N: Array
    PN: Array
    stations_P: Array
    targets_P: Array
    imaged: Array
    worth: Array
    in_orbit: bool
    aims_P: Array
    links: Array
    levels: dict[str, float]
    time: float
    limit: float
    total: float
    counts: dict[str, int]


@torch.no_grad()
def look(env: Tasking, row: int) -> Moment:
    """The present of episode ``row`` of an environment, with the satellites that take part in it."""
    fleet = env.fleet
    shown = torch.nonzero(env.present[row].cpu()).squeeze(-1)
    kind, number = fleet.place_of(fleet.names[int(shown[0])])
    modes, causes, world = _modes(env, row), causes_of(env, row), fleet.simulators[kind].world
    first = row * fleet.simulators[kind].count + number
    in_orbit = isinstance(env.scenario, RSOTargets)
    find = _objects if in_orbit else _targets
    r_TP_P, imaged, worth, aims_P = find(env, row, modes)
    r_N, v_N = (of_satellites(env, row, name) for name in ("r_BN_N", "v_BN_N"))
    links = torch.zeros(fleet.size, fleet.size, dtype=torch.bool)
    if env.links is not None and bool(fleet.ticks[row]):
        links = env.links[row]
    return Moment(
        names=[fleet.names[k] for k in shown.tolist()],
        modes=[modes[k] for k in shown.tolist()],
        causes=[causes[k] for k in shown.tolist()],
        r_N=array(r_N),
        orbits_N=array(revolution(r_N, v_N)),
        sun_N=array(world.sun_direction_N[first]),
        PN=array(world.PN[first]),
        stations_P=array(stations_of(fleet.simulators)),
        targets_P=array(r_TP_P),
        imaged=array(imaged),
        worth=array(worth),
        in_orbit=in_orbit,
        aims_P=array(aims_P[shown]),
        links=array(links[shown][:, shown]),
        levels=_levels(env, row),
        time=float(fleet.sim_time[row]),
        limit=float(env.time_limit[row]),
        total=float(env.returns[row]),
        counts={name: int(count[row].sum()) for name, count in env.counts().items()},
    )


def array(value: Tensor) -> Array:
    """The numbers of a tensor."""
    return value.cpu().numpy()


def of_satellites(env: Tasking, row: int, name: str, model: str = "dynamics") -> Tensor:
    """A property of dynamics or ``fsw`` for each satellite that is present, [S, ...]; not a number for those without it."""
    return env.fleet.each(lambda part: getattr(getattr(part, model), name), missing=math.nan)[row][env.present[row]]


def revolution(r_N: Tensor, v_N: Tensor) -> Tensor:
    """Positions [S, M, 3] m on the ellipses through [S, 3], from there on backwards and once around."""
    now = Elements(*(x.unsqueeze(-1) for x in rv_to_elements(Vec3.of(r_N), Vec3.of(v_N))))
    back = torch.linspace(0.0, 2.0 * math.pi, POINTS, dtype=r_N.dtype, device=r_N.device)
    r, _ = elements_to_rv(Elements(*torch.broadcast_tensors(*now[:-1], now.f - back)))
    return r.stack()


def _modes(env: Tasking, row: int) -> list[str]:
    modes = {}
    for satellite in env.satellites:
        simulator, first = satellite.simulator, row * satellite.simulator.count
        named = [command_of(simulator, name) for name in simulator.mode_names]
        mine = slice(first, first + simulator.count)
        for column, mode, dead in zip(
            simulator.columns, simulator.mode[mine].tolist(), satellite.task.dead[mine].tolist(), strict=True
        ):
            modes[column] = DEAD if dead else named[mode]
    return [modes[column] for column in range(env.fleet.size)]


def causes_of(env: Tasking, row: int) -> list[str]:
    """The checks that a dead satellite fails, for each satellite of the fleet."""
    causes = [""] * env.fleet.size
    for satellite in env.satellites:
        simulator, first = satellite.simulator, row * satellite.simulator.count
        mine = slice(first, first + simulator.count)
        failed = {name: (~passed[mine]).tolist() for name, passed in satellite.aliveness().items()}
        for k, (column, dead) in enumerate(zip(simulator.columns, satellite.task.dead[mine].tolist(), strict=True)):
            if dead:
                causes[column] = ", ".join(CAUSES.get(name, name) for name, column_failed in failed.items() if column_failed[k])
    return causes


def command_of(simulator: Simulator, mode: str) -> str:
    """Return the name of the command that enters a mode: ``"desat"`` for ``"desat_nadir"``, and mostly the mode's own."""
    wider = (name for name, command in simulator.type.commands.items() if mode in command.modes and len(command.modes) > 1)
    return next(wider, mode)


def stations_of(simulators: Iterable[Simulator]) -> Tensor:
    """Earth-fixed positions [K, 3] of the ground stations, if anybody sees some."""
    for simulator in simulators:
        stations = None if simulator.access is None else simulator.access.kinds.get("ground_station")
        if isinstance(stations, FixedPlaces):
            return stations.r_LP_P[0]
    return torch.empty(0, 3, dtype=torch.float64)


def _targets(env: Tasking, row: int, modes: list[str]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Positions of the targets [T, 3], which have been imaged [T], relative priorities [T], and where satellites look [S, 3]."""
    nowhere = torch.full((env.fleet.size, 3), torch.nan, dtype=torch.float64)
    scenario: Any = env.scenario
    if not hasattr(scenario, "most_targets"):
        return (
            torch.empty(0, 3, dtype=torch.float64),
            torch.zeros(0, dtype=torch.bool),
            torch.empty(0, dtype=torch.float64),
            nowhere,
        )
    r_LP_P, available = scenario.r_LP_P[row].cpu(), scenario.available[row].cpu()
    imaged = env.rewarder.imaged[row].cpu() if hasattr(env.rewarder, "imaged") else torch.zeros_like(available)
    target = env.fleet.each(lambda part: getattr(part, "latest_target", none(part)))[row].cpu()
    looks = torch.tensor([mode == IMAGING for mode in modes]) & (target >= 0)
    aims = torch.where(looks.unsqueeze(-1), r_LP_P[target.clamp(min=0)], nowhere)
    shown = available | imaged
    priority = scenario.priority[row].cpu()
    return r_LP_P[shown], imaged[shown], (priority / priority.max().clamp(min=1e-12))[shown].clamp(min=0.0), aims


def _objects(env: Tasking, row: int, modes: list[str]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """What :func:`_targets` returns, of the objects of a catalog."""
    scenario: Any = env.scenario
    PN = env.fleet.simulators[0].world.PN[row * env.fleet.simulators[0].count].cpu()
    r_TP_P, aims = scenario.r_TN_N[row].cpu() @ PN.mT, torch.full((env.fleet.size, 3), torch.nan, dtype=torch.float64)
    for kind in scenario.imager_types:
        satellite, count = env.fleet.satellites[kind], env.fleet.simulators[kind].count
        target = satellite.memory[AIM].unsqueeze(1).clamp(min=0)
        seen = scenario.in_sight(satellite, Candidates(target, satellite.memory[AIM].unsqueeze(1) >= 0))
        for number, column in enumerate(env.fleet.columns[kind].tolist()):
            k = row * count + number
            if modes[column] == IMAGING_OBJECT and bool(seen[k]):
                aims[column] = r_TP_P[int(target[k])]
    imaged = env.rewarder.imaged[row].cpu() if hasattr(env.rewarder, "imaged") else torch.zeros(len(r_TP_P), dtype=torch.bool)
    priority = scenario.priority[row].cpu()
    return r_TP_P, imaged, (priority / priority.max().clamp(min=1e-12)).clamp(min=0.0), aims


def none(part: SatelliteGroup) -> Tensor:
    """Targets [N] of satellites that choose none."""
    return torch.full_like(part.simulator.ticks, NONE)


def _largest(name: str, part: SatelliteGroup) -> Tensor:
    """The largest magnitude of a quantity of each satellite of a type, [N]; types may have different numbers of wheels."""
    return getattr(part.dynamics, name).abs().reshape(part.simulator.state.rows, -1).amax(1)


def _levels(env: Tasking, row: int) -> dict[str, float]:
    levels = {}
    for name, title in QUANTITIES.items():
        there = [part for part in env.fleet.satellites if hasattr(type(part.dynamics), name)]
        if there:
            values = env.fleet.each(partial(_largest, name), missing=math.nan)[row][env.present[row]]
            values = values[torch.isfinite(values)]
            levels[title] = float(values.min() if title == LOW else values.max())
    return levels
