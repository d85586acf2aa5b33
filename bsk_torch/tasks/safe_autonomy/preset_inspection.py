"""CWInspection-v1: inspect the points of a chief in sunlight by thrusters.

The task ``inspection_v0`` of AFRL's safe-autonomy-sims (``gym/inspection`` of commit 6d71f7e, March 2025; D. van Wijk, K. Dunlap,
M. Majji and K. L. Hobbs, "Deep reinforcement learning for autonomous spacecraft inspection using illumination", AAS/AIAA
Astrodynamics Specialist Conference, 2023). Numbers are those of its program.

A deputy of 12 kg starts 50 to 100 m from the chief at up to 0.8 m/s, and moves by the equations of Clohessy and Wiltshire with a
mean motion of 0.001027 rad/s (:mod:`bsk_torch.tasks.safe_autonomy.dyn`). The chief is a sphere of 10 m with 99 points, at rest in
its Hill frame. A point is inspected if it is in view and lit at the end of a decision, or at the start of the episode
(:mod:`bsk_torch.tasks.safe_autonomy.lit_points`). A decision is a force for 10 s.

Observation, 11 numbers in the chief's Hill frame (radial, along-track, normal):

======================================  ==========================================================================
``rho_H`` (3), ``rho_dot_H`` (3)        position, m, and velocity, m/s, relative to the chief
``sun_angle``                           angle from the radial direction to the Sun in the orbit plane, rad
``points_inspected``                    number of inspected points
``nearest_cluster`` (3)                 direction of the nearest of the clusters of lit points not yet inspected
======================================  ==========================================================================

There is one cluster for every ten such points, found by k-means from the clusters of the decision before. The original takes
further centers at random; here, they start at the points farthest from the others.

Action: force along the three axes, -1 to 1 N each.

Reward: 0.01 for each newly inspected point, minus 0.01 times the sum of the components of the force divided by the mass, m/s^2;
1 for the last of the 99 points. A crash (within 15 m) costs 1.

Termination: a crash, or all points inspected. Truncation: at 12,240 s (two orbits), and beyond 800 m.

Random at reset: position, velocity, and the angle of the Sun.

Several deputies (``deputies=2`` or more) are agents of the task ``multi_inspection_v0`` of the same program
(``pettingzoo/inspection``), which inspect the same points: each earns the reward of all new points, and pays for its own force.
Differences: ``points_inspected`` counts those that the deputy was the first to inspect, of several at once the earlier one of the
list; initial speeds are below 1.6 mm/s; deputies collide below 10 m, at the end of a decision, which costs nothing; and the
episode ends for all as soon as it does for one. The number of points and the time limit are those of one deputy, since the 100
points of the program cannot be reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch import act, data, formations, obs, rand, sats
from bsk_torch._checks import whole
from bsk_torch.data.base import Log
from bsk_torch.env import ConstellationTasking, SatelliteTasking
from bsk_torch.scene.recorded import RecordedProgress, RecordedTargets
from bsk_torch.sim import fsw
from bsk_torch.tasks.safe_autonomy.act import HeldThrust
from bsk_torch.tasks.safe_autonomy.assurance import BLIND, EDGE, INSPECTION, Barriers, crew_barriers
from bsk_torch.tasks.safe_autonomy.dyn import MEAN_MOTION, LinearInspectorDynModel
from bsk_torch.tasks.safe_autonomy.lit_points import PER_CLUSTER, Clusters, clustered, in_view, lit, sphere_points
from bsk_torch.tasks.safe_autonomy.preset_docking import Collisions, Polar, assured, deputy_args, interventions, names_of

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario

FASTEST = 0.8 * 2.0 * MEAN_MOTION
"""Bound of the initial speed of several deputies, m/s."""

RADIUS, POINTS = 10.0, 100
"""Radius of the chief, m, and number of points for which its grid is made, which has 99."""


class LitPointsReward(data.GlobalReward):
    """Reward of CWInspection-v1; see the module.

    Satellites must have :class:`bsk_torch.tasks.safe_autonomy.LinearInspectorDynModel`. Several deputies share the points,
    which the Sun of the first one lights, and each is rewarded for all of them. Counters of each deputy: ``inspected``, the
    points that it was the first to inspect; ``speeding`` and ``blinded``, the decisions after which it exceeds the safe speed,
    or has the Sun within 30 degrees of its line of sight to the chief; and with run-time assurance ``interventions``.
    """

    point, success, price = 0.01, 1.0, 0.01

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self.points = sphere_points(POINTS, RADIUS).to(fleet.device)
        count, most = len(self.points), -(-len(self.points) // PER_CLUSTER)
        self.memory.declare("inspected", False, count)
        self.memory.declare("rewarded", 0, low=0, high=count)
        self.memory.declare("centers", 0.0, most, 3, low=-RADIUS, high=RADIUS)
        self.memory.declare("clusters", 0, low=0, high=most)
        self.memory.declare("nearest_cluster", 0.0, fleet.size, 3, low=-1.0, high=1.0)
        for name in ("found", "speeding", "blinded"):
            self.memory.declare(name, 0, fleet.size, low=0)
        fleet.want("force_H")  # others only if they are observed: a kernel rounds lengths otherwise than torch
        fleet.beginnings.append(self._begin)

    @property
    def inspected(self) -> Tensor:
        """Inspected points, [N, P] bool."""
        return self.memory["inspected"]

    @override
    def recorded(self, env: int) -> RecordedProgress:
        points = RecordedTargets(places="points", r=self.points.cpu(), priority=torch.ones(len(self.points), dtype=torch.float64))
        return RecordedProgress(targets=points, marks={"done": self.inspected[env].cpu()})

    @override
    def read_log(self) -> Log:
        names = ("rho_H", "sun_hat_H", "distance", "relative_speed", "speed_limit", "force_H")
        return {name: self.fleet.each(attrgetter(f"dynamics.{name}")) for name in names}

    def _begin(self, envs: Tensor) -> None:
        """Inspect the points in view at the start of the episodes ``envs`` [n]."""
        self._inspect(self.read_log(), torch.zeros_like(self.memory["inspected"][:, 0]).index_fill(0, envs, True))

    def _inspect(self, log: Log, where: Tensor) -> None:
        """Inspect the lit points in view, and find the clusters of the others, in the episodes ``where`` [N]."""
        memory, rho, sun = self.memory, log["rho_H"], log["sun_hat_H"][:, 0]
        inspected, light = memory["inspected"], lit(self.points, RADIUS, sun)
        views = in_view(self.points, RADIUS, rho) & (light & ~inspected & where.unsqueeze(1)).unsqueeze(1)
        first = views & (views.cumsum(1) == 1)
        memory["found"] = memory["found"] + first.sum(-1)
        memory["inspected"] = inspected = inspected | views.any(1)
        remaining = light & ~inspected
        before = Clusters(memory["centers"], memory["clusters"])
        after = clustered(self.points, remaining, before)
        # without points left, the clusters of before are those that the next decision starts from
        valid = where & remaining.any(1)
        memory["centers"] = torch.where(valid.view(-1, 1, 1), after.centers, before.centers)
        memory["clusters"] = torch.where(valid, after.number, before.number)
        nearest = after.nearest(rho)
        memory["nearest_cluster"] = torch.where(where.view(-1, 1, 1), nearest, memory["nearest_cluster"])

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        memory, moved = self.memory, self.step_duration > 0.0
        self._inspect(after, moved)
        total = memory["inspected"].sum(1)
        new = torch.where(moved, total - memory["rewarded"], 0)
        memory["rewarded"] = memory["rewarded"] + new
        mass = self.fleet.each(lambda satellite: satellite.simulator.argument("mass"))
        x, y, z = (after["rho_H"] * after["sun_hat_H"]).unbind(-1)
        sight = -(x + y + z) / after["distance"]
        wrong = {"speeding": after["relative_speed"] > after["speed_limit"], "blinded": sight > math.cos(BLIND)}
        for name, mask in wrong.items():
            memory[name] = memory[name] + (mask & moved.unsqueeze(1))
        shared = self.point * new + self.success * (total == len(self.points))
        return shared.double().unsqueeze(1) - self.price * after["force_H"].abs().sum(-1) / mass

    @override
    def counts(self) -> dict[str, Tensor]:
        return {
            "inspected": self.memory["found"],
            **{name: self.memory[name] for name in ("speeding", "blinded")},
            **interventions(self.fleet),
        }

    def is_terminated(self) -> Tensor:
        """See :meth:`bsk_torch.data.GlobalReward.is_terminated`: all points are inspected."""
        return self.memory["inspected"].all(1, keepdim=True).expand(-1, self.fleet.size)

    @override
    def is_truncated(self) -> Tensor:
        return self.fleet.each(attrgetter("dynamics.distance")) > EDGE


class CrewLitPointsReward(Collisions, LitPointsReward):
    """Reward of CWInspection-v1 with several deputies; see the module. There is a further counter ``collided``."""

    least = 10.0

    def is_terminated(self) -> Tensor:
        """See :meth:`bsk_torch.data.GlobalReward.is_terminated`: all, if all points are inspected, or one crashed or collided."""
        ends = self.memory["collided"] | ~self.fleet.each(lambda satellite: satellite.dynamics.distance_valid())
        return super().is_terminated() | ends.any(1, keepdim=True)


class SharedSun(formations.Formation):
    """Gives the angle of the Sun to all deputies of an episode."""

    def __init__(self, angle: float | rand.Distribution) -> None:
        """Draw, or use, ``angle``, rad."""
        self.angle = angle if isinstance(angle, rand.Distribution) else rand.Uniform(angle, angle)

    @override
    def draw(self, key: rand.Key, names: Sequence[str]) -> formations.Settings:
        drawn = torch.as_tensor(self.angle.draw(key.named("sunAngle")), dtype=torch.float64)
        return {"sunAngle": (range(len(names)), drawn.unsqueeze(1).expand(-1, len(names)))}


def points_found(satellite: sats.BoundSatellite) -> Tensor:
    """Return the number of points that the deputy was the first to inspect, [N]."""
    columns = satellite.fleet.columns[satellite.type_index]
    return satellite.fleet.memory["found"][:, columns].flatten().double()


def points_inspected(satellite: sats.BoundSatellite) -> Tensor:
    """Return the number of inspected points, [N]."""
    return satellite.simulator.of_env(satellite.fleet.memory["inspected"].sum(1).double())


def nearest_cluster(satellite: sats.BoundSatellite) -> Tensor:
    """Return the direction of the nearest cluster of lit points that are not inspected, [N, 3]; zero without any."""
    columns = satellite.fleet.columns[satellite.type_index]
    return satellite.fleet.memory["nearest_cluster"][:, columns].flatten(0, 1)


def properties(points: Callable[[sats.BoundSatellite], Tensor]) -> obs.SatProperties:
    """Return the observation of a deputy, with a function that counts ``points``."""
    motion = (dict(prop=name) for name in ("rho_H", "rho_dot_H", "sun_angle"))
    counted = dict(prop="points_inspected", fn=points)
    return obs.SatProperties(*motion, counted, dict(prop="nearest_cluster", fn=nearest_cluster))


class InspectionDeputy(sats.Satellite):
    """The deputy of CWInspection-v1."""

    observation_spec: ClassVar[tuple[obs.Observation, ...]] = (properties(points_inspected),)
    action_spec: ClassVar[Sequence[act.ContinuousAction]] = (HeldThrust(),)
    dyn_type = LinearInspectorDynModel
    fsw_type = fsw.FSWModel


def cw_inspection(
    *, deputies: int = 1, assurance: str | None = None, sat_args: dict[str, object] | None = None, **options: object
) -> SatelliteTasking | ConstellationTasking:
    """Return CWInspection-v1; see the module.

    Args:
        deputies: Number of deputies; with two or more, each is an agent of a :class:`~bsk_torch.ConstellationTasking`.
        assurance: Filter of forces, ``"asif"`` (:class:`bsk_torch.tasks.safe_autonomy.assurance.Barriers`), or None. That of
            several deputies also keeps them apart (:func:`bsk_torch.tasks.safe_autonomy.assurance.crew_inspection`).
        sat_args: Arguments of the deputy that replace those of the preset.
        **options: Arguments of the environment that replace those of the preset.
    """
    arguments = deputy_args() | dict(
        relative_position=Polar(50.0, 100.0),
        sunAngle=rand.Uniform(0.0, 2.0 * math.pi),
        speedLimitDistance=15.0,
        keepOutRadius=15.0,
    )
    common: dict[str, Any] = dict(sim_rate=10.0, time_limit=12236.0, failure_penalty=-1.0)
    filters = {None: None, "asif": Barriers(INSPECTION) if whole("deputies", deputies, 1) == 1 else crew_barriers}
    settings: dict[str, Any] = dict(action_spec=assured(filters, assurance))
    if deputies == 1:
        deputy = InspectionDeputy("Deputy", arguments | (sat_args or {}), **settings)
        return SatelliteTasking(deputy, **(common | dict(rewarder=LitPointsReward()) | options))
    arguments = arguments | dict(relative_velocity=Polar(0.0, FASTEST)) | (sat_args or {})
    crew = common | dict(rewarder=CrewLitPointsReward(), sat_arg_randomizer=SharedSun(arguments.pop("sunAngle")))
    settings["observation_spec"] = (properties(points_found),)
    satellites = [InspectionDeputy(name, arguments, **settings) for name in names_of(deputies)]
    return ConstellationTasking(satellites, **(crew | options))
