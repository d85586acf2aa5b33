"""RSOInspection-v1 and MultiInspection-v1: inspection of another spacecraft by one inspector, or by several.

RSOInspection-v1 is the task ``rso_inspection`` of bsk_rl's benchmark suite: a resident space object (RSO), whose body turns with
its Hill frame, carries 100 points on a sphere of 1 m. An inspector flies about it by impulsive manoeuvres, and inspects a point
while it is within 250 m and 30 degrees of the point's normal, and the Sun within 60 degrees of it. MultiInspection-v1 has three
inspectors, who pay for collisions with each other, too, and share what they have seen.

Observation of an inspector, 46 numbers:

====================================  ============================================================================
``dv_available_normd``                what is left in the tank, over 10 m/s
``resource_reward_weight``            reward for 1 m/s that is left
``r_DC_Hc_normd`` (3)                 position in the Hill frame of the RSO, over 500 m
``v_DC_Hc_normd`` (3)                 velocity in that frame, over 5 m/s
``imaged_regions`` (32)               fraction of inspected points in regions about directions that are spread evenly
``sun_hat_Hc`` (3)                    direction of the Sun in that frame
``eclipse`` (2)                       time until the next eclipse begins and ends, over 5700 s
``time``                              time since reset, over the time limit
====================================  ============================================================================

Actions of an inspector, with ``actions="thrust"`` as in bsk_rl: change of velocity in the Hill frame of the RSO, at most 1 m/s,
and a drift of at most 11 400 s, four numbers. With ``actions="waypoints"``: one of 96 transfers, to 32 directions at 60 m in 600,
1200 or 2000 s; see :class:`bsk_torch.act.HillWaypoint`. The RSO has one action, to point along its Hill frame.

Reward: points that are inspected for the first time, over 100; 1 for completing the inspection; -0.1 for each m/s; -1 for who
dies. The inspection is complete when 90 points in 100 that have been lit are inspected, see
:class:`bsk_torch.data.RSOInspectionReward`.

Termination: completion; a collision, within the sum of the radii of 2 m; an inspector that is 1000 m away, with which the RSO is
lost, too; an empty tank. Time limit 57 000 s. The tick is 5 s.

Random at reset: orbit of the RSO between 500 and 1100 km, positions of inspectors at 250 to 750 m, velocities up to 1 m/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from bsk_torch import act, comm, data, formations, obs, sats, scene
from bsk_torch.astro.relative import fibonacci_sphere
from bsk_torch.env import ConstellationTasking
from bsk_torch.obs.relative_observations import rso_imaged_regions
from bsk_torch.rand import Distribution, Key
from bsk_torch.sim import dyn, fsw

ORBIT = 5700.0
"""Length of an orbit for norms and time limits, s."""

REGIONS = 32
"""Regions that are observed, and directions of waypoints."""

LOWEST, HIGHEST, EARTH = 500e3, 1100e3, 6371e3
"""Bounds of the altitude, m, above a sphere of this radius."""

DISTANCE_NORM, SPEED_NORM = 500.0, 5.0
"""Norms of observed relative positions, m, and velocities, m/s."""

ACTIONS = ("thrust", "waypoints")


@dataclass(frozen=True)
class ChiefOrbit(Distribution):
    """Elements [n, 6] of an orbit whose semi-major axis is uniform, and whose eccentricity keeps it between two altitudes."""

    def draw(self, key: Key) -> Tensor:
        """See :meth:`Distribution.draw`."""
        u = key.uniform(6).unbind(-1)
        a = EARTH + LOWEST + (HIGHEST - LOWEST) * u[0]
        most = torch.minimum(1.0 - (EARTH + LOWEST) / a, (EARTH + HIGHEST) / a - 1.0)
        return torch.stack([a, most * u[1], math.pi * (2.0 * u[2] - 1.0), *(2.0 * math.pi * x for x in u[3:])], -1)


@dataclass(frozen=True)
class RelativeState(Distribution):
    """Relative states [n, 6] of random directions: ``distance`` and ``speed`` are bounds in m and m/s."""

    distance: tuple[float, float]
    speed: tuple[float, float]

    def draw(self, key: Key) -> Tensor:
        """See :meth:`Distribution.draw`."""
        directions, u = key.normal(6).unflatten(-1, (2, 3)), key.named("lengths").uniform(2)
        bounds = torch.tensor([self.distance, self.speed], dtype=torch.float64)
        lengths = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * u
        return (torch.nn.functional.normalize(directions, dim=-1) * lengths.unsqueeze(-1)).flatten(-2)


class RSO(sats.Satellite):
    """The spacecraft that is inspected."""

    observation_spec = (obs.Time(),)
    action_spec = (act.NadirPoint(duration=1e9),)
    dyn_type = (dyn.ConjunctionDynModel, dyn.RSODynModel)
    fsw_type = fsw.FSWModel


class Inspector(sats.Satellite):
    """A spacecraft that inspects the RSO; its manoeuvres are those of bsk_rl."""

    observation_spec = (
        obs.SatProperties(dict(prop="dv_available", norm=10.0)),
        obs.ResourceRewardWeight(),
        obs.RelativeProperties(
            dict(prop="r_DC_Hc", norm=DISTANCE_NORM),
            dict(prop="v_DC_Hc", norm=SPEED_NORM),
            dict(prop="imaged_regions", fn=partial(rso_imaged_regions, region_centers=fibonacci_sphere(REGIONS))),
            dict(prop="sun_hat_Hc"),
            chief_name="RSO",
        ),
        obs.Eclipse(norm=ORBIT),
        obs.Time(),
    )
    action_spec = (act.ImpulsiveThrustHill("RSO", max_dv=1.0, max_drift_duration=2.0 * ORBIT, fsw_action="action_inspect_rso"),)
    dyn_type = (dyn.MaxRangeDynModel, dyn.ConjunctionDynModel, dyn.RSOInspectorDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, fsw.RSOInspectorFSWModel)


class WaypointInspector(Inspector):
    """The same, which chooses among transfers."""

    action_spec = (
        act.HillWaypoint(
            "RSO", REGIONS, max_dv=1.0, keep_out=15.0, keep_in=900.0, keep_apart=15.0, fsw_action="action_inspect_rso"
        ),
    )


def inspector_args() -> dict[str, Any]:
    """Return the arguments of an inspector."""
    return dict(
        imageAttErrorRequirement=1.0,
        imageRateErrorRequirement=None,
        instrumentBaudRate=1.0,
        dataStorageCapacity=1e6,
        batteryStorageCapacity=1e9,
        storedCharge_Init=1e9,
        dv_available_init=10.0,
        conjunction_radius=2.0,
        max_range_radius=1000.0,
        chief_name="RSO",
        enforce_range_on_chief=True,
        # the gains of bsk_rl's benchmark, its defaults, are unstable at ticks of 5 s; pointing does not matter in this task
        K=0.26,
        P=6.6,
    )


def rso_inspection(*, n_inspectors: int = 1, actions: str = "thrust", **options: Any) -> ConstellationTasking:
    """Return RSOInspection-v1; see the module.

    Args:
        n_inspectors: Number of inspectors.
        actions: ``"thrust"`` or ``"waypoints"``.
        **options: Arguments of the environment to override; ``sat_args`` are merged with the inspectors'.
    """
    if actions not in ACTIONS:
        raise ValueError(f"actions={actions!r} must be one of {list(ACTIONS)}")
    kind = Inspector if actions == "thrust" else WaypointInspector
    arguments = inspector_args() | options.pop("sat_args", {})
    names = [f"Inspector{k + 1}" for k in range(n_inspectors)]
    around = RelativeState((250.0, 750.0), (0.0, 1.0))
    own: dict[str, Any] = dict(
        scenario=scene.SphericalRSO(100, 1.0, math.radians(30.0), 250.0, math.radians(60.0)),
        rewarder=(
            data.RSOInspectionReward(completion_bonus=1.0),
            data.ResourceReward(reward_weight=0.1, resource_fn=lambda satellite: satellite.fsw.dv_available),
        ),
        sat_arg_randomizer=formations.relative_to_chief("RSO", ChiefOrbit(), dict.fromkeys(names, around)),
        sim_rate=5.0,
        time_limit=10.0 * ORBIT,
        orbit="integrated",
    )
    if n_inspectors > 1:
        own["communicator"] = comm.FreeCommunication()
    satellites = [RSO("RSO", dict(conjunction_radius=2.0)), *(kind(name, arguments) for name in names)]
    return ConstellationTasking(satellites, **(own | options))


def multi_inspection(*, n_inspectors: int = 3, actions: str = "thrust", **options: Any) -> ConstellationTasking:
    """Return MultiInspection-v1; see the module. Arguments are those of :func:`rso_inspection`."""
    return rso_inspection(n_inspectors=n_inspectors, actions=actions, **options)
