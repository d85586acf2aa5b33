"""What arcs are made of: the equations of motion, the error of bsk_rl's look-ahead, and the heavy parts of Picard iteration.

The heavy parts work on packs [K, 3, n].
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import (
    EARTH_ROTATION_RATE,
    POLE_DECLINATION_RATE,
    POLE_RIGHT_ASCENSION_RATE,
    earth_angles,
    sun_state,
)
from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.gravity import DEGREE, J2, field, field_weights, third_body
from bsk_torch.astro.integrate import State, rk4_step
from bsk_torch.constants import MU_EARTH, R_EARTH
from bsk_torch.sim.compiler import just_in_time
from bsk_torch.vec3 import Mat3, Vec3

SPACING = 60.0
"""Seconds between the nodes of an arc."""

SPAN = 3600.0
"""Seconds solved at once."""

PER_SPAN = round(SPAN / SPACING)

LEAD = 4
"""Flown nodes before the beginning of an arc, so that polynomials are not one-sided there."""

PLAN_STEP = 30.0
"""Step, s, of bsk_rl's look-ahead propagation."""

ORDER = 44
"""Degree of the interpolated accelerations; with the rounds below arcs are solved to 0.03 mm."""

ROUNDS = (3, 2, 1, 1)
"""Calls of :func:`relax` before the full field is first looked up, and after each time that it is."""

PLAN_ROUNDS = 3

PER_ROUND = 4
"""Picard iterations in one call of :func:`relax`."""

FULL = field_weights(DEGREE)


def frame_stretch(step: float) -> float:
    """Mean stretch of equatorial components by Basilisk's linear extrapolation of the Earth's orientation over a step.

    ``(omega dt)^2 / 2`` averaged over the Runge-Kutta stages.
    """
    return (EARTH_ROTATION_RATE * step) ** 2 / 6.0


def frame_growth() -> float:
    """Growth of the stretch, 1/s^2, with the square of the time since the Earth's orientation was taken."""
    return 0.5 * EARTH_ROTATION_RATE**2


def pole_matrix(et: Tensor) -> Mat3:
    """DCM from N to axes with z along the Earth's pole and x toward its node, at ET [n] (IAU_EARTH without its spin)."""
    alpha, delta, _ = earth_angles(et)
    ca, sa, cd, sd = torch.cos(alpha), torch.sin(alpha), torch.cos(delta), torch.sin(delta)
    zero = torch.zeros_like(ca)
    return Mat3(Vec3(-sa, ca, zero), Vec3(-sd * ca, -sd * sa, cd), Vec3(cd * ca, cd * sa, sd))


def pole_rate(pole: Mat3) -> Vec3:
    """Angular rate, rad/s, of the axes of :func:`pole_matrix` in those axes."""
    ascension = POLE_RIGHT_ASCENSION_RATE
    return Vec3(torch.full_like(pole.z.z, -POLE_DECLINATION_RATE), pole.y.z * ascension, pole.z.z * ascension)


def stretched(r: Vec3, stretch: float | Tensor) -> Vec3:
    """The vector with its equatorial components stretched."""
    return Vec3(r.x * (1.0 + stretch), r.y * (1.0 + stretch), r.z)


def zonal_field(r: Vec3, stretch: float | Tensor = 0.0) -> Vec3:
    """Acceleration by the point mass and J2 in pole axes (Vallado, section 8.7.1); see :func:`frame_stretch`."""
    q = stretched(r, stretch)
    inverse2 = 1.0 / q.dot(q)
    central = MU_EARTH * inverse2 * torch.sqrt(inverse2)
    oblate = (1.5 * J2 * R_EARTH * R_EARTH) * inverse2
    tilt = 5.0 * q.z * q.z * inverse2
    across = -central * (1.0 + oblate * (1.0 - tilt))
    along = -central * (1.0 + oblate * (3.0 - tilt))
    return stretched(Vec3(q.x * across, q.y * across, q.z * along), stretch)


class Surroundings(NamedTuple):
    """What surrounds a satellite during a span, in the pole axes of its middle.

    Sun at the middle [3, n] each; meridian angle at the middle [n]; angular rate of the pole's axes [3, n].
    """

    r_sun: Tensor
    v_sun: Tensor
    angle: Tensor
    pole_rate: Tensor


def surroundings(et: Tensor, pole: Mat3) -> Surroundings:
    """Surroundings at ET [n], to which ``pole`` belongs."""
    sun = [torch.stack(pole @ Vec3.of(part)) for part in sun_state(et)]
    return Surroundings(sun[0], sun[1], earth_angles(et)[2], torch.stack(list(pole_rate(pole))))


def full_field(r: Vec3, around: Surroundings, dt: Tensor, stretch: float | Tensor) -> Vec3:
    """Acceleration by the Earth's full field and the Sun, dt seconds from the middle, in pole axes."""
    tilt = Vec3(*around.pole_rate.unbind(0)) * dt
    angle = around.angle + EARTH_ROTATION_RATE * dt
    cos, sin = torch.cos(angle), torch.sin(angle)
    p = rotate_z(r - tilt.cross(r), cos, sin)
    f = rotate_z(stretched(field(stretched(p, stretch), FULL), stretch), cos, -sin)
    sun = Vec3(*around.r_sun.unbind(0)) + Vec3(*around.v_sun.unbind(0)) * dt
    return f + tilt.cross(f) + third_body(r, sun)


# -- the heavy parts: packs [K, 3, n] in and out ---------------------------------------------------------------------------


def vector(pack: Tensor) -> Vec3:
    """Vector of a pack [K, 3, n]."""
    return Vec3(*pack.unbind(1))


def pack(vector: Vec3) -> Tensor:
    """Pack [K, 3, n] of a vector."""
    return torch.stack(list(vector), 1)


def relax(guess: Tensor, ballistic: Tensor, rest: Tensor, twice: Tensor, stretch: Tensor) -> Tensor:
    """Four Picard iterations in the zonal field.

    Args:
        guess: Positions at the nodes [K, 3, n].
        ballistic: Positions without acceleration [K, 3, n].
        rest: Accelerations that the zonal field lacks [K, 3, n].
        twice: Matrix [K, K] that integrates accelerations twice.
        stretch: Stretch of equatorial components, [].
    """
    for _ in range(PER_ROUND):
        acceleration = pack(zonal_field(vector(guess), stretch)) + rest
        guess = ballistic + (twice @ acceleration.flatten(1)).view(guess.shape)
    return guess


def lacking(r: Tensor, dt: Tensor, stretch: Tensor, r_sun: Tensor, v_sun: Tensor, angle: Tensor, rate: Tensor) -> Tensor:
    """What the zonal field lacks at positions [K, 3, n], dt [K, 1] seconds from the middle; see :class:`Surroundings`."""
    around = Surroundings(r_sun, v_sun, angle, rate)
    return pack(full_field(vector(r), around, dt, stretch) - zonal_field(vector(r), stretch))


def step_defect(r: Vec3, v: Vec3, stretch: float | Tensor, growth: float | Tensor) -> tuple[Vec3, Vec3]:
    """Error per second, of position and velocity, of the Runge-Kutta step of ``PLAN_STEP`` that ends at r and v in pole axes.

    Found by comparison with four substeps, whose own error is 1/256 of it. The step's stages take the Earth's orientation of
    its beginning; ``stretch`` is the mean effect of that, see :func:`frame_stretch`.
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


def defects(state: Tensor, stretch: Tensor, growth: Tensor) -> Tensor:
    """:func:`step_defect` of position and velocity side by side, [K, 6, n]."""
    r, v = step_defect(Vec3(*state.unbind(1)[:3]), Vec3(*state.unbind(1)[3:]), stretch, growth)
    return torch.stack([*r, *v], 1)


class Kernels(NamedTuple):
    """The heavy parts as they are, or compiled."""

    relax: Callable[..., Tensor]
    lacking: Callable[..., Tensor]
    defects: Callable[..., Tensor]


@functools.cache
def kernels(backend: str) -> Kernels:
    """The heavy parts under a backend; compiled ones are shared by all environments of the process."""
    parts: list[Callable[..., Tensor]] = [relax, lacking, defects]
    return Kernels(*(just_in_time(part, f"orbit solver ({part.__name__})") if backend == "compiled" else part for part in parts))
