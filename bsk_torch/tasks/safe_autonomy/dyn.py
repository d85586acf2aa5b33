"""Motion relative to a chief in its Hill frame H, linear and in closed form: an alternative to orbits of two bodies.

A satellite with such a model stays on the orbit of the chief in N. The position rho and the velocity rho' of the deputy relative
to it, as seen in H (x radial, y along the track, z normal), are further state, which obeys the equations of Clohessy and
Wiltshire with the force F of its thrusters, constant over a tick::

    x'' = 3 n^2 x + 2 n y' + F_x / m,  y'' = -2 n x' + F_y / m,  z'' = -n^2 z + F_z / m

A tick is the exact solution (:func:`bsk_torch.astro.clohessy_wiltshire.transition` and ``pushed``), whatever its length. Defaults
are those of AFRL's safe-autonomy-simulation 2.2.1 (``sims/spacecraft/defaults.py`` and ``sims/inspection/sun.py``), which
integrates the same equations numerically.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field, vec
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.readout.observables import Now, observable, vital
from bsk_torch.vec3 import Vec3

MEAN_MOTION = 0.001027
"""Mean motion of the published tasks, rad/s."""

FARTHEST = 1e6
"""Largest distance between deputy and chief at reset, m."""


def move(bus: Bus) -> None:
    """Move the deputy over a tick; see the module for the equations."""
    n, t = bus.mean_motion, bus.h
    angle = n * t
    s, c, half = torch.sin(angle), torch.cos(angle), torch.sin(0.5 * angle)
    one_c = 2.0 * half * half  # 1 - c, without cancellation
    r, v = bus.rho_H, bus.rho_dot_H
    a = bus.force_H * bus.inverse_mass
    curl = 2.0 * (angle - s) / (n * n)
    bus.rho_H = Vec3(
        (4.0 - 3.0 * c) * r.x + (s * v.x + 2.0 * one_c * v.y) / n + one_c / (n * n) * a.x + curl * a.y,
        r.y
        + 6.0 * (s - angle) * r.x
        + (-2.0 * one_c * v.x + (4.0 * s - 3.0 * angle) * v.y) / n
        - curl * a.x
        + (4.0 * one_c / (n * n) - 1.5 * t * t) * a.y,
        c * r.z + s / n * v.z + one_c / (n * n) * a.z,
    )
    bus.rho_dot_H = Vec3(
        3.0 * n * s * r.x + c * v.x + 2.0 * s * v.y + (s * a.x + 2.0 * one_c * a.y) / n,
        -6.0 * n * one_c * r.x - 2.0 * s * v.x + (4.0 * c - 3.0) * v.y - 2.0 * one_c / n * a.x + (4.0 * s / n - 3.0 * t) * a.y,
        -n * s * r.z + c * v.z + s / n * a.z,
    )


LINEAR_MOTION = Component(
    slot="linear_motion",
    after="hub",
    update=move,
    args=(
        Arg(
            "relative_position",
            (100.0, 0.0, 0.0),
            "m",
            "initial position in the chief's Hill frame",
            "vector",
            -FARTHEST,
            FARTHEST,
        ),
        Arg("relative_velocity", (0.0, 0.0, 0.0), "m/s", "initial velocity as seen in H", "vector", -1e3, 1e3),
        Arg("meanMotion", MEAN_MOTION, "rad/s", "mean motion of the chief", low=1e-5, high=2e-3),
        Arg("speedLimitNear", 0.2, "m/s", "safe speed at speedLimitDistance", low=0.0, high=1e3),
        Arg("speedLimitSlope", 2.0, "-", "increase of the safe speed with distance, over the mean motion", low=0.0, high=1e3),
        Arg("speedLimitDistance", 0.0, "m", "distance of speedLimitNear", low=0.0, high=FARTHEST),
    ),
    state=(
        vec("rho_H", "m", "position of the deputy relative to the chief, in H", exact=True),
        vec("rho_dot_H", "m/s", "its velocity as seen in H", exact=True),
        vec("force_H", "N", "force of the thrusters, in H", exact=True),
    ),
    params=(Field("mean_motion", 1, "rad/s", exact=True), Field("inverse_mass", 1, "1/kg", exact=True)),
    reads=("mass",),
    initial=lambda args: {"rho_H": args["relative_position"], "rho_dot_H": args["relative_velocity"]},
    prepare=lambda args: {"mean_motion": args["meanMotion"], "inverse_mass": 1.0 / args["mass"]},
)


def limit_of(now: Now) -> Tensor:
    """Return the safe speed at the distance of the deputy, m/s."""
    args = now.args
    return args.speedLimitNear + args.speedLimitSlope * args.meanMotion * (now.rho_H.norm() - args.speedLimitDistance)


class LinearMotionDynModel(DynamicsModel):
    """A deputy close to a chief. Its action is :class:`bsk_torch.tasks.safe_autonomy.HeldThrust`.

    The orbit ``oe`` of the satellite is that of the chief, and serves only the models of the world: Sun, eclipses and stations.
    """

    components: ClassVar[tuple[Component, ...]] = (LINEAR_MOTION,)

    @observable
    def rho_H(now: Now) -> Vec3:
        """Position of the deputy relative to the chief, [N, 3] m in the chief's Hill frame H."""
        return now.rho_H

    @observable
    def rho_dot_H(now: Now) -> Vec3:
        """Velocity of the deputy relative to the chief as seen in H, [N, 3] m/s."""
        return now.rho_dot_H

    @observable
    def force_H(now: Now) -> Vec3:
        """Force of the thrusters in H over the last tick, [N, 3] N."""
        return now.force_H

    @observable
    def distance(now: Now) -> Tensor:
        """Distance from the chief, ``|rho|``, [N] m."""
        return now.rho_H.norm()

    @observable
    def relative_speed(now: Now) -> Tensor:
        """Speed relative to the chief, ``|rho'|``, [N] m/s."""
        return now.rho_dot_H.norm()

    @observable
    def speed_limit(now: Now) -> Tensor:
        """Safe speed ``speedLimitNear + speedLimitSlope meanMotion (|rho| - speedLimitDistance)``, [N] m/s."""
        return limit_of(now)


DOCKING = Component(
    slot="docking",
    after="hub",
    args=(Arg("dockingRadius", 0.2, "m", "distance at which the deputy touches the chief", low=0.0, high=1e3),),
)


class DockingDynModel(LinearMotionDynModel):
    """A deputy that docks: it touches the chief below the safe speed, or crashes."""

    components: ClassVar[tuple[Component, ...]] = (DOCKING,)

    @observable
    def docked(now: Now) -> Tensor:
        """Whether the deputy touches the chief below the safe speed, [N], as 0 or 1."""
        touches = now.rho_H.norm() < now.args.dockingRadius
        return (touches & (now.rho_dot_H.norm() < limit_of(now))).to(torch.float64)

    @vital
    def contact_valid(now: Now) -> Tensor:
        """Whether the deputy does not touch the chief at the safe speed or above, [N]."""
        touches = now.rho_H.norm() < now.args.dockingRadius
        return ~(touches & (now.rho_dot_H.norm() >= limit_of(now)))


def turn_sun(bus: Bus) -> None:
    """Turn the Sun about the orbit normal."""
    bus.sun_angle = bus.sun_angle + bus.mean_motion * bus.h


SUN = Component(
    slot="sun_angle",
    after="hub",
    update=turn_sun,
    args=(
        Arg(
            "sunAngle",
            0.0,
            "rad",
            "initial angle from the radial direction to the Sun, about the negative orbit normal",
            low=-1e3,
            high=1e3,
        ),
        Arg("keepOutRadius", 15.0, "m", "distance from the chief below which the deputy crashes", low=0.0, high=1e6),
    ),
    state=(Field("sun_angle", 1, "rad", "angle from the radial direction to the Sun", exact=True),),
    initial=lambda args: {"sun_angle": args["sunAngle"]},
)


class LinearInspectorDynModel(LinearMotionDynModel):
    """A deputy that inspects a chief in sunlight, and crashes within ``keepOutRadius``.

    The Sun lies in the chief's orbit plane, at the angle ``sunAngle + meanMotion t``: its direction in the Hill frame is
    ``(cos, -sin, 0)`` of it.
    """

    components: ClassVar[tuple[Component, ...]] = (SUN,)

    @observable
    def sun_angle(now: Now) -> Tensor:
        """Angle from the radial direction to the Sun, [N] rad; it grows without bound."""
        return now.sun_angle

    @observable
    def sun_hat_H(now: Now) -> Vec3:
        """Direction of the Sun in the chief's Hill frame, [N, 3]."""
        angle = now.sun_angle
        return Vec3(torch.cos(angle), -torch.sin(angle), torch.zeros_like(angle))

    @vital
    def distance_valid(now: Now) -> Tensor:
        """Whether the distance from the chief is at least ``keepOutRadius``, [N]."""
        return now.rho_H.norm() >= now.args.keepOutRadius
