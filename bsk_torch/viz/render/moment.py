"""State of one episode that a frame of a video shows, read without changing the episode."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.astro.orbit import Elements, elements_to_rv, rv_to_elements
from bsk_torch.recording.recording import Array
from bsk_torch.recording.scenes import NONE, QUANTITIES, aimed_at, causes_of, stations_of, targets_of
from bsk_torch.vec3 import Vec3

if TYPE_CHECKING:
    from bsk_torch.env.base import Tasking
    from bsk_torch.env.satellite_group import SatelliteGroup
    from bsk_torch.sim.simulator import Simulator

DEAD = "dead"
"""Mode of a satellite that has died."""

IMAGING = ("image", "image_rso")
"""Modes in which a satellite looks at the target that it has chosen last."""

LOW = "battery"
"""The resource of which little is bad; of the others it is much."""

POINTS = 121
"""Points of a revolution."""


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
        targets_P: The targets that can be chosen now or have been imaged, cells of areas, or the objects of a catalog, [T, 3].
        imaged: Which of them have been imaged or recorded, [T].
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
    in_orbit, r_TP_P, imaged, worth, aims_P = _targets(env, row, modes)
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
        commands = [command_of(simulator, name) for name in simulator.mode_names]
        rows = slice(first, first + simulator.count)
        for column, mode, dead in zip(
            simulator.columns, simulator.mode[rows].tolist(), satellite.task.dead[rows].tolist(), strict=True
        ):
            modes[column] = DEAD if dead else commands[mode]
    return [modes[column] for column in range(env.fleet.size)]


def command_of(simulator: Simulator, mode: str) -> str:
    """Return the name of the command that enters a mode: ``"desat"`` for ``"desat_nadir"``, and mostly the mode's own."""
    wider = (name for name, command in simulator.type.commands.items() if mode in command.modes and len(command.modes) > 1)
    return next(wider, mode)


def _targets(env: Tasking, row: int, modes: list[str]) -> tuple[bool, Tensor, Tensor, Tensor, Tensor]:
    """Whether targets are in orbit, their places [T, 3], which are imaged [T], relative priorities [T], where satellites look."""
    targets, aims = targets_of(env, row), torch.full((env.fleet.size, 3), torch.nan, dtype=torch.float64)
    in_orbit, offered, r_P = targets.places == "orbit", getattr(env.scenario, "available", None), targets.r
    imaged = env.rewarder.recorded(row).marks.get("done")
    if imaged is not None and len(imaged) != len(r_P):  # of another scenario of several
        imaged = None
    if in_orbit:
        first = env.fleet.simulators[0]
        r_P = r_P @ first.world.PN[row * first.count].cpu().mT
    elif targets.places != "ground" or (offered is None and imaged is None):
        return False, aims[:0], torch.zeros(0, dtype=torch.bool), aims[:0, 0], aims
    if imaged is None:
        imaged = env.rewarder.imaged[row].cpu() if hasattr(env.rewarder, "imaged") else torch.zeros(len(r_P), dtype=torch.bool)
    shown = torch.ones_like(imaged) if offered is None else offered[row].cpu() | imaged

    def aim(satellite: SatelliteGroup) -> Tensor:
        target = aimed_at(satellite)
        return torch.where(env.scenario.sees(satellite, target), target, NONE)

    target = env.fleet.each(aim)[row].cpu()
    looks = torch.tensor([mode in IMAGING for mode in modes]) & (target >= 0)
    aims[looks] = r_P[target[looks]]
    worth = (targets.priority / targets.priority.max().clamp(min=1e-12)).clamp(min=0.0)
    return in_orbit, r_P[shown], imaged[shown], worth[shown], aims


def _largest(name: str, part: SatelliteGroup) -> Tensor:
    """The largest magnitude of a quantity of each satellite of a type, [N]; types may have different numbers of wheels."""
    return getattr(part.dynamics, name).abs().reshape(part.simulator.state.rows, -1).amax(1)


def _levels(env: Tasking, row: int) -> dict[str, float]:
    levels = {}
    for name, title in QUANTITIES.items():
        if any(hasattr(type(part.dynamics), name) for part in env.fleet.satellites):
            values = env.fleet.each(partial(_largest, name), missing=math.nan)[row][env.present[row]]
            values = values[torch.isfinite(values)]
            levels[title] = float(values.min() if title == LOW else values.max())
    return levels
