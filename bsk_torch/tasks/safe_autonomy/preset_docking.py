"""CWDocking-v1: dock with a chief by thrusters, slowly enough at every distance.

The task ``docking_v0`` of AFRL's safe-autonomy-sims (``gym/docking`` of commit 6d71f7e, March 2025, after release 4.2.3; K.
Dunlap, M. Mote, K. Delsing and K. L. Hobbs, "Run time assured reinforcement learning for safe satellite docking", Journal of
Aerospace Information Systems 20(1), 2023). Numbers are those of its program, which differ from those of its description in
places: the docking radius is 0.2 m, the normal component of the initial position is not negative, and directions are denser at
the poles.

A deputy of 12 kg starts 100 to 150 m from the chief at up to 0.8 m/s, and moves by the equations of Clohessy and Wiltshire with
a mean motion of 0.001027 rad/s (:mod:`bsk_torch.tasks.safe_autonomy.dyn`). A decision is a force for 1 s.

Observation, 8 numbers in the chief's Hill frame (radial, along-track, normal):

======================================  ==========================================================================
``rho_H`` (3), ``rho_dot_H`` (3)        position, m, and velocity, m/s, relative to the chief
``relative_speed``                      length of the velocity, m/s
``speed_limit``                         safe speed, m/s: 0.2 + 2 * 0.001027 (distance - 0.5 m)
======================================  ==========================================================================

Action: force along the three axes, -1 to 1 N each.

Reward: 2 (exp(-a d') - exp(-a d)) for approaching from distance d to d', with a = ln 2 / 100 m, minus 0.01 times the sum of the
components of the change of velocity, m/s, minus the excess over the safe speed, m/s. Docking, below 0.2 m and the safe speed,
earns 2 - t / 2000 s; a crash (below 0.2 m at the safe speed or above), a distance of more than 10 km, and the time limit cost 1.

Termination: docking or a crash. Truncation: at 2001 s, beyond 10 km, and when the excesses over the safe speed sum up to more
than 5 m/s.

Random at reset: position and velocity.

Several deputies (``deputies=2`` or more) are agents of the task ``multidocking_v0`` of the same program (``pettingzoo/docking``):
they observe what one deputy does, and each earns its own reward. Differences: exceeding the safe speed costs 0.01 plus 0.01
times the excess, of which 5 end an episode; the time limit is 2000 s; deputies collide below 0.5 m, at the end of a decision,
which costs nothing; and the episode ends for all as soon as it does for one, so that the first to dock ends it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch import act, data, obs, rand, sats
from bsk_torch._checks import whole
from bsk_torch.constants import MU_EARTH
from bsk_torch.data.base import Log
from bsk_torch.env import ConstellationTasking, SatelliteTasking
from bsk_torch.sim import fsw
from bsk_torch.sim.names import one_of
from bsk_torch.sim.state import FINITE
from bsk_torch.tasks.safe_autonomy.act import HeldThrust
from bsk_torch.tasks.safe_autonomy.assurance import DOCKING, Assurance, Backup, Barriers
from bsk_torch.tasks.safe_autonomy.dyn import MEAN_MOTION, DockingDynModel
from bsk_torch.tasks.safe_autonomy.lit_points import squares

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario

CHIEF_ORBIT = ((MU_EARTH / MEAN_MOTION**2) ** (1 / 3), 0.0, 0.0, 0.0, 0.0, 0.0)
"""Elements of the chief's circular orbit, m and rad: the tasks define its mean motion only."""

LIMIT = 2000.0
"""Time after which docking is late, s."""


def interventions(fleet: SatelliteFleet) -> dict[str, Tensor]:
    """Return the counter of interventions of run-time assurance, [N, S]; nothing without it."""
    if not all("interventions" in satellite.simulator.memory for satellite in fleet.satellites):
        return {}
    return {"interventions": fleet.each(attrgetter("simulator.memory.interventions"))}


def collided(rho: Tensor, least: float) -> Tensor:
    """Return which deputies at ``rho`` [N, S, 3] m are closer than ``least`` to another one, [N, S] bool."""
    oneself = torch.eye(rho.shape[1], dtype=torch.bool, device=rho.device)
    return ((squares(rho.unsqueeze(2) - rho.unsqueeze(1)) < least**2) & ~oneself).any(-1)


class Polar(rand.Distribution):
    """Vectors [n, 3] of uniform length, with uniform angles as in the published programs.

    ``r (sin(phi) cos(theta), sin(phi) sin(theta), cos(phi))`` with phi in [-pi/2, pi/2) and theta in [0, 2 pi).
    """

    def __init__(self, low: float, high: float) -> None:
        """Draw lengths in [``low``, ``high``)."""
        self.low, self.high = low, high

    @override
    def draw(self, key: rand.Key) -> Tensor:
        r, phi, theta = key.uniform(3).unbind(-1)
        r, phi, theta = self.low + (self.high - self.low) * r, math.pi * (phi - 0.5), 2.0 * math.pi * theta
        across = r * torch.sin(phi)
        return torch.stack([across * torch.cos(theta), across * torch.sin(theta), r * torch.cos(phi)], -1)


class DockingReward(data.GlobalReward):
    """Reward of CWDocking-v1; see the module. Satellites must have :class:`bsk_torch.tasks.safe_autonomy.DockingDynModel`.

    Counters: ``docked``; ``speeding``, the decisions after which a deputy exceeds the safe speed; and with run-time assurance
    ``interventions``.
    """

    approach, half_distance = 2.0, 100.0
    price, speeding_price, speeding_fee = 0.01, 1.0, 0.0
    grace = 0.5
    farthest = 10e3
    most_excess = 5.0

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self.memory.declare("excess_speed", 0.0, fleet.size, low=0.0, high=FINITE)
        self.memory.declare("speeding", 0, fleet.size, low=0)
        self.memory.declare("docked", False, fleet.size)
        fleet.want("docked", "force_H")  # others only if they are observed: a kernel rounds lengths otherwise than torch

    @override
    def read_log(self) -> Log:
        names = ("distance", "relative_speed", "speed_limit", "docked", "force_H")
        return {name: self.fleet.each(attrgetter(f"dynamics.{name}")) for name in names}

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        rate = math.log(2.0) / self.half_distance
        closeness, was = torch.exp(-rate * after["distance"]), torch.exp(-rate * before["distance"])
        excess = (after["relative_speed"] - after["speed_limit"]).clamp(min=0.0)
        fine = self.speeding_price * excess + self.speeding_fee * (excess > 0.0)
        mass = self.fleet.each(lambda satellite: satellite.simulator.argument("mass"))
        memory, docked, moved = self.memory, after["docked"] > 0.0, (self.step_duration > 0.0).unsqueeze(1)
        memory["excess_speed"] = memory["excess_speed"] + torch.where(moved, fine, 0.0)
        memory["speeding"] = memory["speeding"] + (moved & (excess > 0.0))
        memory["docked"] = memory["docked"] | docked
        time = self.fleet.sim_time.unsqueeze(1)
        late = time > LIMIT + self.grace * self.fleet.h  # half a tick, since times are rounded
        reward = self.approach * (closeness - was) - self.price * after["force_H"].abs().sum(-1) / mass - fine
        reward = reward + torch.where(docked, 2.0 - time / LIMIT, 0.0)
        return reward - late.double() - (after["distance"] > self.farthest).double()

    @override
    def counts(self) -> dict[str, Tensor]:
        return {"docked": self.memory["docked"].long(), "speeding": self.memory["speeding"], **interventions(self.fleet)}

    def is_terminated(self) -> Tensor:
        """See :meth:`bsk_torch.data.GlobalReward.is_terminated`: docked deputies."""
        return self.memory["docked"]

    @override
    def is_truncated(self) -> Tensor:
        distance = self.fleet.each(attrgetter("dynamics.distance"))
        return (distance > self.farthest) | (self.memory["excess_speed"] > self.most_excess)


class Collisions(data.GlobalReward):
    """Adds the counter ``collided``: deputies closer than ``least``, m, to another one at the end of a decision."""

    least: ClassVar[float]

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self.memory.declare("collided", False, fleet.size)

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        collisions = collided(self.fleet.each(attrgetter("dynamics.rho_H")), self.least)
        self.memory["collided"] = self.memory["collided"] | (collisions & (self.step_duration > 0.0).unsqueeze(1))
        return super().calculate_reward(before, after)

    @override
    def counts(self) -> dict[str, Tensor]:
        return super().counts() | {"collided": self.memory["collided"].long()}


class CrewDockingReward(Collisions, DockingReward):
    """Reward of CWDocking-v1 with several deputies; see the module. There is a further counter ``collided``."""

    speeding_price, speeding_fee = 0.01, 0.01
    grace = -0.5
    least = 0.5

    def is_terminated(self) -> Tensor:
        """See :meth:`bsk_torch.data.GlobalReward.is_terminated`: all, if one has docked, crashed or collided."""
        crashed = ~self.fleet.each(lambda satellite: satellite.dynamics.contact_valid())
        ends = self.memory["docked"] | self.memory["collided"] | crashed
        return ends.any(1, keepdim=True).expand_as(ends)


class DockingDeputy(sats.Satellite):
    """The deputy of CWDocking-v1."""

    observation_spec: ClassVar[tuple[obs.Observation, ...]] = (
        obs.SatProperties(dict(prop="rho_H"), dict(prop="rho_dot_H"), dict(prop="relative_speed"), dict(prop="speed_limit")),
    )
    action_spec: ClassVar[Sequence[act.ContinuousAction]] = (HeldThrust(),)
    dyn_type = DockingDynModel
    fsw_type = fsw.FSWModel


FILTERS: dict[str | None, Assurance | None] = {
    None: None,
    "asif": Barriers(DOCKING),
    "simplex": Backup(DOCKING),
    "implicit_simplex": Backup(DOCKING, window=5.0),
}
"""Filters by the name of their run-time assurance."""


def assured(filters: Mapping[str | None, Assurance | None], assurance: str | None) -> tuple[act.ContinuousAction, ...]:
    """Return the action of a deputy with a filter; ValueError for an unknown name."""
    if assurance is not None:
        one_of("assurance", assurance, [name for name in filters if name is not None])
    return (HeldThrust(assurance=filters[assurance]),)


def deputy_args() -> dict[str, Any]:
    """Return the arguments of the deputy that it shares with other published tasks."""
    return dict(mass=12.0, meanMotion=MEAN_MOTION, oe=CHIEF_ORBIT, relative_velocity=Polar(0.0, 0.8))


def names_of(deputies: int) -> list[str]:
    """Return the names of deputies."""
    return [f"Deputy{k}" for k in range(1, deputies + 1)]


def cw_docking(
    *, deputies: int = 1, assurance: str | None = None, sat_args: dict[str, object] | None = None, **options: object
) -> SatelliteTasking | ConstellationTasking:
    """Return CWDocking-v1; see the module.

    Args:
        deputies: Number of deputies; with two or more, each is an agent of a :class:`~bsk_torch.ConstellationTasking`.
        assurance: Filter of forces, ``"asif"``, ``"simplex"`` or ``"implicit_simplex"`` (a window of 5 s); None for none.
        sat_args: Arguments of the deputy that replace those of the preset.
        **options: Arguments of the environment that replace those of the preset.
    """
    arguments = deputy_args() | dict(relative_position=Polar(100.0, 150.0), speedLimitDistance=0.5, dockingRadius=0.2)
    arguments, thrust = arguments | (sat_args or {}), assured(FILTERS, assurance)
    if whole("deputies", deputies, 1) == 1:
        single: dict[str, Any] = dict(rewarder=DockingReward(), time_limit=LIMIT + 1.0, failure_penalty=-1.0)
        return SatelliteTasking(DockingDeputy("Deputy", arguments, action_spec=thrust), **(single | options))
    crew: dict[str, Any] = dict(rewarder=CrewDockingReward(), time_limit=LIMIT, failure_penalty=-1.0)
    satellites = [DockingDeputy(name, arguments, action_spec=thrust) for name in names_of(deputies)]
    return ConstellationTasking(satellites, **(crew | options))
