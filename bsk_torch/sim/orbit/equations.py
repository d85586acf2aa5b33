"""Equations of motion of the arcs, in the axes E of the Earth's equator at the middle of a segment.

``r'' = a_E(r, t) + a_S(r, t)`` with the Earth's field a_E, of degree and order 10 unless the dynamics model says otherwise, and
the Sun as a third body a_S (see :mod:`bsk_torch.astro.gravity`). The zonal field, that of the point mass and J2, is a cheap
approximation of a_E, to about 1e-4 m/s^2 in low orbits.

Basilisk turns positions into Earth-fixed axes with a matrix C that it extrapolates linearly over each step. ``C + C' dt`` is not
orthonormal: equatorial components come out longer by the factor ``1 + (w dt)^2 / 2``, where w is the Earth's rotation rate. Arcs
have no steps of that kind, so this *stretch* is part of their equations of motion; it is worth 7.5 cm an orbit for ticks of one
second and 28 m for the look-ahead.

BSK-RL's look-ahead is a Runge-Kutta propagation in steps of 30 s. Its truncation error, meters per orbit, moves windows by
milliseconds, so it is reproduced: the error of one step, divided by the length of the step, is a rate of position and velocity,
and the planned arc solves ``r' = v + e_r, v' = a(r, t) + e_v``.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.earth_rotation import Earth
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, coverage, sun_state
from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.gravity import DEGREE, J2, field, field_weights, third_body
from bsk_torch.astro.integrate import State, rk4_step
from bsk_torch.constants import MU_EARTH, R_EARTH
from bsk_torch.sim.environment.ephemeris import pole_rate
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.vec3 import Mat3, Vec3

FRAME_GROWTH = 0.5 * EARTH_ROTATION_RATE**2
"""Growth ``w^2 / 2``, 1/s^2, of the stretch with the square of the time since C was taken."""


def frame_stretch(step: float) -> float:
    """Return the mean stretch of equatorial components in steps of a length in s: ``w^2 <dt^2> / 2 = (w step)^2 / 6``.

    The stages of a Runge-Kutta step have the distances dt = 0, step/2, step/2, step from the time at which C was taken and the
    weights 1/6, 1/3, 1/3, 1/6, so that ``<dt^2> = step^2 / 3``.
    """
    return (EARTH_ROTATION_RATE * step) ** 2 / 6.0


def stretched(r: Vec3, stretch: float | Tensor) -> Vec3:
    """Return the vector S r with ``S = diag(1 + stretch, 1 + stretch, 1)``: its equatorial components are longer."""
    return Vec3(r.x * (1.0 + stretch), r.y * (1.0 + stretch), r.z)


def zonal_field(r: Vec3, stretch: float | Tensor = 0.0) -> Vec3:
    """Return the acceleration, m/s^2, by the point mass and J2 at r, m, both in equatorial axes E.

    With ``q = S r`` (see :func:`stretched`), ``k = (3/2) J2 (R / q)^2`` and ``u = q_z / q``::

        a_x = -(mu / q^3) q_x (1 + k (1 - 5 u^2))
        a_y = -(mu / q^3) q_y (1 + k (1 - 5 u^2))
        a_z = -(mu / q^3) q_z (1 + k (3 - 5 u^2))

    and the result is ``S a``, as C is applied twice, to the position and, transposed, to the acceleration. Source: Vallado,
    "Fundamentals of Astrodynamics and Applications", section 8.7.1.
    """
    q = stretched(r, stretch)
    inverse2 = 1.0 / q.dot(q)
    central = MU_EARTH * inverse2 * torch.sqrt(inverse2)
    oblate = (1.5 * J2 * R_EARTH * R_EARTH) * inverse2
    tilt = 5.0 * q.z * q.z * inverse2
    across = -central * (1.0 + oblate * (1.0 - tilt))
    along = -central * (1.0 + oblate * (3.0 - tilt))
    return stretched(Vec3(q.x * across, q.y * across, q.z * along), stretch)


def central_gradient(r: Vec3, d: Vec3) -> Vec3:
    """Return the change, m/s^2, of the point mass's acceleration from r to r + d, m, to first order in d.

    ``da = (mu / r^3) (3 (r . d) r / r^2 - d)`` (Montenbruck and Gill, "Satellite Orbits", section 7.2.1).
    """
    inverse2 = 1.0 / r.dot(r)
    return (r * (3.0 * inverse2 * r.dot(d)) - d) * (MU_EARTH * inverse2 * torch.sqrt(inverse2))


class Surroundings(NamedTuple):
    """Sun and Earth during a segment of n satellites, in the axes E at its middle.

    ``r_SN_E`` and ``v_SN_E`` [3, n] are the Sun's position, m, and velocity, m/s, at the middle, ``angle`` [n] is the angle of
    the prime meridian there, rad, and ``omega_EN_E`` [3, n] the angular rate of E, rad/s.
    """

    r_SN_E: Tensor
    v_SN_E: Tensor
    angle: Tensor
    omega_EN_E: Tensor


def surroundings(et: Tensor, EN: Mat3, earth: Earth) -> Surroundings:
    """Return the surroundings at ET [n], s, whose equatorial axes are EN, by a model of the Earth's rotation."""
    sun = [torch.stack(EN @ Vec3.of(part)) for part in sun_state(et.clamp(max=coverage()[1]))]
    return Surroundings(sun[0], sun[1], earth.meridian(et), torch.stack(list(pole_rate(EN))))


def full_field(r: Vec3, around: Surroundings, dt: Tensor, stretch: float | Tensor, degree: int = DEGREE) -> Vec3:
    """Return the acceleration, m/s^2, by the Earth's field of a degree and the Sun at r, m, both in the axes E of the middle.

    ``a = D^T R3(W)^T S f(S R3(W) D r) + a_S(r, r_S + v_S dt)`` at dt seconds from the middle, with the field f in Earth-fixed
    axes, the prime meridian ``W = W0 + w dt`` and the drift of the pole since the middle, ``D = I - [omega_EN dt]x``, to first
    order: it is 1e-8 rad in half an hour.
    """
    tilt = Vec3(*around.omega_EN_E.unbind(0)) * dt
    angle = around.angle + EARTH_ROTATION_RATE * dt
    cos, sin = torch.cos(angle), torch.sin(angle)
    p = rotate_z(r - tilt.cross(r), cos, sin)
    f = rotate_z(stretched(field(stretched(p, stretch), field_weights(degree)), stretch), cos, -sin)
    sun = Vec3(*around.r_SN_E.unbind(0)) + Vec3(*around.v_SN_E.unbind(0)) * dt
    return f + tilt.cross(f) + third_body(r, sun)


def step_defect(r: Vec3, v: Vec3, stretch: float | Tensor, growth: float | Tensor) -> tuple[Vec3, Vec3]:
    """Return the error per second, m/s and m/s^2, of the step of ``PLAN_STEP`` that ends at r, m, and v, m/s, in axes E.

    Let y0 be the state from which the exact solution arrives at (r, v), found by a step backwards. Then::

        e = (256 / 255) (y_1 - y_4) / PLAN_STEP

    with the results y_1 of one step and y_4 of four steps of a quarter from y0: the error of a fourth-order method's step is of
    the fifth order, so four quarter steps have 4 / 4^5 = 1/256 of it (Richardson extrapolation; Hairer, Norsett and Wanner,
    "Solving Ordinary Differential Equations I", section II.4).

    The single step's stages take the Earth's orientation of its beginning, so their stretch is ``growth * dt^2``; the exact
    solution has ``stretch``, the mean of it; see :func:`bsk_torch.sim.orbit.equations.frame_stretch`.
    """

    def step(y: State, h: float, stretch: float | Tensor, growth: float | Tensor) -> State:
        def rates(stage: int, offset: float, at: State) -> State:
            return at[1], zonal_field(at[0], stretch + growth * (offset * offset))

        return rk4_step(rates, y, h)

    before = step((r, v), -PLAN_STEP, stretch, 0.0)
    coarse, fine = step(before, PLAN_STEP, 0.0, growth), before
    for _ in range(4):
        fine = step(fine, PLAN_STEP / 4.0, stretch, 0.0)
    scale = (256.0 / 255.0) / PLAN_STEP
    return (coarse[0] - fine[0]) * scale, (coarse[1] - fine[1]) * scale
