"""RSOInspection-v1 and MultiInspection-v1: fly around a spacecraft by velocity changes until its surface is inspected.

RSOInspection-v1 is the task ``rso_inspection`` of BSK-RL's benchmark suite. MultiInspection-v1, which exists only in this
package, is the same task with three inspectors that must not collide.

A resident space object (RSO), a sphere of 1 m with 100 points, flies with its axes along its Hill frame. Inspectors start 250 to
750 m away, with fuel for 10 m/s. A decision is a velocity change followed by a drift with the instrument pointed at the RSO. A
point is inspected if it is in view (within 30 degrees of its normal, and 250 m) and lit (the Sun within 60 degrees of its
normal).

Observation of an inspector, 61 numbers:

======================================  ==========================================================================
``dv_available_normd``                  remaining delta-v, divided by 10 m/s
``resource_reward_weight``              price of 1 m/s
``r_DC_Hc_normd`` (3)                   position relative to the RSO, in its Hill frame, divided by 500 m
``v_DC_Hc_normd`` (3)                   velocity as seen in that frame, divided by 5 m/s
``rso_imaged_regions`` (6)              fraction of inspected points in each of six regions
``imaged_regions`` (32)                 the same for 32 regions around evenly spread directions
``sun_hat_Hc`` (3)                      direction of the Sun in the RSO's Hill frame
``eccentricity_Hs_normd`` (3),          orbit of the RSO, in the Hill frame of the Earth's motion about the Sun: eccentricity
``h_Hs_normd`` (3), ``r_Hs_normd`` (3)  vector, angular momentum and position, divided by 0.04184, 5e10 m^2/s and 7e6 m
``eclipse`` (2)                         time until the next eclipse begins and ends, divided by 5700 s
``time``                                time since reset, divided by the time limit
======================================  ==========================================================================

In MultiInspection-v1, there are 7 more for each of the two other inspectors: position (divided by 500 m) and velocity (divided by
5 m/s) relative to the inspector in the RSO's Hill frame, and whether it is alive.

With ``actions="thrust"``, the action of an inspector consists of a velocity change of at most 1 m/s in the RSO's
Hill frame (radial, along-track, normal) and the time to drift, 10 to 11,400 s. With ``actions="waypoints"``, it is one of 96
transfers: to the directions of the 32 regions, 60 m from the RSO, in 600, 1,200 or 2,000 s (:class:`bsk_torch.act.HillWaypoint`).
The RSO is an agent with one action, 0: point along the Hill frame; its observation is 1.

With ``tumble=0.01``, the RSO turns freely, as a box of 1.0 x 0.6 x 2.2 m with 120 kg, from a random attitude and rates of up to
0.01 rad/s about each axis; its points turn with it, and its action 0 is to drift. Inspectors observe 6 more numbers, its attitude
``rso_sigma_BH`` (3) and its rate ``rso_omega_BH`` (3, divided by 0.01 rad/s) relative to its Hill frame.

Reward of an inspector: the number of newly inspected points divided by 100, minus 0.1 for each m/s. When 90 % of the lit points
have been inspected, all satellites including the RSO receive 1; this requires that 40 points have been lit or that an orbit of
5,700 s has passed. The reward of a death is -1.

Termination: when the inspection is complete, or all agents have died. Inspectors die at 1,000 m from the RSO (which then also
dies), with an empty tank, and within 4 m of another spacecraft (which also dies). The time limit of 57,000 s truncates.

Eclipses are observed with ``obs.Eclipse(sampled=True)``: up to 30 s late, and, where none comes, at one second
after reset.

Random at reset: orbit of the RSO (500 to 1,100 km above a sphere of 6,371 km, eccentric), positions and velocities (up to 1 m/s)
of inspectors, epoch, attitudes and wheel speeds of inspectors.

Ticks last 5 s. Orbits are solved in advance (``orbit="arc"``), which is nearly twice as fast as ``"integrated"``, the default of
the models. After 24,000 s, positions relative to the RSO differ by half a millimeter, and the same points are inspected. The
gains of the attitude control are stable with these ticks, unlike those of the benchmark; in both, the instrument records at
any attitude error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch import act, data, formations, obs, rand, sats
from bsk_torch._checks import number, whole
from bsk_torch.astro.orbit import hill_frame, hill_rate
from bsk_torch.astro.relative import fibonacci_sphere
from bsk_torch.env import ConstellationTasking
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.inspection.models import RSODynModel, RSOInspectorDynModel, RSOInspectorFSWModel
from bsk_torch.tasks.inspection.obs import rso_imaged_regions
from bsk_torch.tasks.inspection.reward import RSOInspectionReward
from bsk_torch.tasks.inspection.scene import SphericalRSO
from bsk_torch.vec3 import Vec3

CHIEF = "RSO"
"""Name of the RSO."""

ORBIT = 5700.0
"""Length of an orbit for norms and time limits, s."""

FUEL, LONGEST_THRUST = 10.0, 1.0
"""Velocity change in a full tank, and the maximum of a single maneuver, m/s."""

REGIONS = 32
"""Regions observed in addition to the default six, and directions of waypoints."""

NEAR, SLOW = 500.0, 5.0
"""Norms of relative positions, m, and velocities, m/s."""

BODY_RADIUS, LOWEST, HIGHEST = 6371e3, 500e3, 1100e3
"""Radius of the reference sphere of altitudes, and bounds of the RSO's altitude, m."""


def one(satellite: sats.BoundSatellite) -> Tensor:
    """Return 1 for each satellite, [N], an observation without information."""
    return torch.ones_like(satellite.simulator.sim_time)


class EccentricOrbit(rand.Distribution):
    """Elements [n, 6] of randomly oriented orbits between 500 and 1100 km, with uniform semi-major axis, then eccentricity.

    The perigee lies above 500 km and the apogee below 1100 km.
    """

    @override
    def draw(self, key: rand.Key) -> Tensor:
        oe = rand.random_orbit().draw(key)
        u = key.named(f"{key.name} shape").uniform(2)
        a = BODY_RADIUS + LOWEST + (HIGHEST - LOWEST) * u[:, 0]
        most = torch.minimum(1.0 - (BODY_RADIUS + LOWEST) / a, (BODY_RADIUS + HIGHEST) / a - 1.0)
        return torch.cat([a.unsqueeze(1), (most * u[:, 1]).unsqueeze(1), oe[:, 2:]], 1)


class RelativeState(rand.Distribution):
    """Position, m, and velocity, m/s, in uniform directions of the RSO's Hill frame, with uniform lengths, [n, 6]."""

    bounds = (250.0, 750.0), (0.0, 1.0)
    """Bounds of the distance, m, and of the speed, m/s."""

    @override
    def draw(self, key: rand.Key) -> Tensor:
        parts = []
        for what, (low, high) in zip(("position", "velocity"), self.bounds, strict=True):
            direction = rand.UnitVector().draw(key.named(f"{key.name} {what}"))
            parts.append(direction * (low + (high - low) * key.named(f"{key.name} {what} length").uniform(1)))
        return torch.cat(parts, 1)


TUMBLING_BODY = dict(mass=120.0, width=1.0, depth=0.6, height=2.2)
"""Mass, kg, and edges, m, of a tumbling RSO: moments of inertia of 13.6, 52 and 58.4 kg m^2."""

RATE = 0.01
"""Norm of the rates of a tumbling RSO, rad/s."""


class OtherInspectors(obs.Observation):
    """Positions, velocities and aliveness of the other inspectors, in cyclic order after each one, [N, (I - 1) * 7].

    Positions and velocities are relative to the inspector in the RSO's Hill frame, divided by 500 m and 5 m/s; aliveness is 1 or
    0.
    """

    def __init__(self, n_inspectors: int, name: str = "others") -> None:
        """Observe the others of ``n_inspectors``."""
        super().__init__(name)
        self.n_inspectors = n_inspectors

    def get_obs(self) -> Tensor:
        """See :meth:`bsk_torch.obs.Observation.get_obs`; zeros for inspectors not simulated in trials."""
        satellite, count = self.satellite, self.simulator.state.count
        chief = satellite.others[CHIEF].dynamics
        r_C, v_C = Vec3.of(chief.r_BN_N), Vec3.of(chief.v_BN_N)
        HN, rate = hill_frame(r_C, v_C), hill_rate(r_C, v_C)
        r_N, v_N, alive = satellite.dynamics.r_BN_N, satellite.dynamics.v_BN_N, ~satellite.task.dead & satellite.present

        def behind(table: Tensor, k: int) -> Tensor:
            return table.view(-1, count, *table.shape[1:]).roll(-k, 1).flatten(0, 1)

        parts = []
        for k in range(1, count):
            rho = HN @ Vec3.of(behind(r_N, k) - r_N)
            turning = Vec3(-rho.y * rate, rho.x * rate, torch.zeros_like(rho.z))
            velocity = HN @ Vec3.of(behind(v_N, k) - v_N) - turning
            parts += [rho.stack() / NEAR, velocity.stack() / SLOW, behind(alive, k).double().unsqueeze(1)]
        missing = r_N.new_zeros(len(r_N), 7 * (self.n_inspectors - count))
        return torch.cat([*parts, missing], 1)


class Chief(sats.Satellite):
    """The RSO: it points along its Hill frame."""

    observation_spec: ClassVar[Sequence[obs.Observation]] = (obs.SatProperties(dict(prop="one", fn=one)),)
    action_spec: ClassVar[Sequence[act.Action]] = (act.NadirPoint(duration=1e9),)
    dyn_type = (dyn.ConjunctionDynModel, RSODynModel)
    fsw_type = fsw.FSWModel


class TumblingChief(Chief):
    """The RSO that turns freely."""

    action_spec: ClassVar[Sequence[act.Action]] = (act.Drift(duration=1e9),)
    fsw_type = fsw.TumblingFSWModel


class Inspector(sats.Satellite):
    """Flies around the RSO."""

    observation_spec: ClassVar[Sequence[obs.Observation]] = (
        obs.SatProperties(dict(prop="dv_available", norm=FUEL)),
        obs.ResourceRewardWeight(),
        obs.RelativeProperties(
            dict(prop="r_DC_Hc", norm=NEAR),
            dict(prop="v_DC_Hc", norm=SLOW),
            dict(prop="rso_imaged_regions", fn=rso_imaged_regions),
            dict(prop="imaged_regions", fn=partial(rso_imaged_regions, region_centers=fibonacci_sphere(REGIONS))),
            dict(prop="sun_hat_Hc"),
            dict(prop="eccentricity_Hs", norm=0.04184),
            dict(prop="h_Hs", norm=5e10),
            dict(prop="r_Hs", norm=7e6),
            chief_name=CHIEF,
        ),
        obs.Eclipse(norm=ORBIT, sampled=True),
        obs.Time(),
    )
    action_spec: ClassVar[Sequence[act.ContinuousAction]] = (
        act.ImpulsiveThrustHill(CHIEF, max_dv=LONGEST_THRUST, max_drift_duration=2 * ORBIT, fsw_action="action_inspect_rso"),
    )
    dyn_type = (dyn.MaxRangeDynModel, dyn.ConjunctionDynModel, RSOInspectorDynModel)
    fsw_type = (fsw.MagicOrbitalManeuverFSWModel, RSOInspectorFSWModel)


class WaypointInspector(Inspector):
    """Flies around the RSO from waypoint to waypoint."""

    action_spec: ClassVar[Sequence[Any]] = (
        act.HillWaypoint(
            CHIEF,
            REGIONS,
            max_dv=LONGEST_THRUST,
            keep_out=15.0,
            keep_in=900.0,
            keep_apart=15.0,
            fsw_action="action_inspect_rso",
        ),
    )


ACTIONS: dict[str, type[Inspector]] = {"thrust": Inspector, "waypoints": WaypointInspector}
"""Inspectors by kind of action."""


def fuel(satellite: sats.BoundSatellite) -> Tensor:
    """Return the velocity change left in the tanks, m/s, [N]."""
    return satellite.fsw.dv_available


def inspector_args() -> dict[str, object]:
    """Return the arguments of inspectors except their orbits."""
    return dict(
        imageAttErrorRequirement=1.0,
        instrumentBaudRate=1.0,
        dataStorageCapacity=1e6,
        batteryStorageCapacity=1e9,
        storedCharge_Init=1e9,
        conjunction_radius=2.0,
        dv_available_init=FUEL,
        max_range_radius=1000.0,
        chief_name=CHIEF,
        enforce_range_on_chief=True,
        K=0.26,
        P=6.6,
    )


def names_of(n_inspectors: int) -> list[str]:
    """Return the names of inspectors."""
    return [f"Inspector{k}" for k in range(1, n_inspectors + 1)]


def rso_inspection(
    *,
    n_inspectors: int = 1,
    actions: str = "thrust",
    fuel_price: Any = 0.1,
    tumble: float = 0.0,
    sat_args: dict[str, object] | None = None,
    **options: Any,
) -> ConstellationTasking:
    """Return RSOInspection-v1; see the module.

    Args:
        n_inspectors: Number of inspectors.
        actions: ``"thrust"`` or ``"waypoints"``.
        fuel_price: Price of 1 m/s, which is observed: a number, a distribution to draw from in each episode, such as
            ``rand.Uniform(0.0, 0.5)``, or a function.
        tumble: Largest rate of the RSO about each axis, rad/s, up to 0.05; 0: it points along its Hill frame.
        sat_args: Arguments of the inspectors that replace those of the preset.
        **options: Arguments of :class:`~bsk_torch.ConstellationTasking` that replace those of the preset.
    """
    names = names_of(whole("n_inspectors", n_inspectors, 1))
    tumble = number("tumble", tumble, 0.0, 0.05, unit="rad/s")
    kind = ACTIONS[one_of("actions", actions, ACTIONS)]
    observed = [*kind.observation_spec, *([OtherInspectors(n_inspectors)] if n_inspectors > 1 else [])]
    chief = Chief(CHIEF, sat_args=dict(conjunction_radius=2.0))
    if tumble > 0.0:
        turning = dict(conjunction_radius=2.0, omega_init=rand.Uniform(-tumble, tumble, 3), **TUMBLING_BODY)
        chief = TumblingChief(CHIEF, sat_args=turning)
        rotation = dict(prop="rso_sigma_BH"), dict(prop="rso_omega_BH", norm=RATE)
        observed.append(obs.RelativeProperties(*rotation, chief_name=CHIEF))
    arguments = inspector_args() | (sat_args or {})
    satellites = [chief, *(kind(name, arguments, observation_spec=observed) for name in names)]
    defaults: dict[str, Any] = dict(
        scenario=SphericalRSO(
            n_points=100, radius=1.0, theta_max=math.radians(30.0), range_max=250.0, theta_solar_max=math.radians(60.0)
        ),
        rewarder=(
            RSOInspectionReward(completion_bonus=1.0),
            data.ResourceReward(reward_weight=fuel_price, resource_fn=fuel),
        ),
        sat_arg_randomizer=formations.relative_to_chief(CHIEF, EccentricOrbit(), {name: RelativeState() for name in names}),
        sim_rate=5.0,
        time_limit=10 * ORBIT,
        failure_penalty=-1.0,
        orbit="arc",
    )
    return ConstellationTasking(satellites, **(defaults | options))


def multi_inspection(*, n_inspectors: int = 3, **options: Any) -> ConstellationTasking:
    """Return MultiInspection-v1; see the module.

    Args:
        n_inspectors: Number of inspectors.
        **options: See :func:`rso_inspection`.
    """
    return rso_inspection(n_inspectors=n_inspectors, **options)
