"""One hour of orbit for many satellites at once.

Picard iteration on Chebyshev nodes: accelerations along the present guess are integrated twice to give the next one. Most
iterations run in the field of the point mass and J2, which is cheap; what that field lacks is looked up a few times on the way.
The heavy parts work on packs [K, 3, n] and are compiled, unless the simulation is eager.
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
from bsk_torch.astro.gravity import DEGREE, field, field_weights, third_body, zonal_weights
from bsk_torch.astro.integrate import State, quadrature, rk4_step
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.compiler import compiled
from bsk_torch.vec3 import Mat3, Vec3

SPACING = 60.0
"""Seconds between the nodes of an arc."""

SPAN = 3600.0
"""Seconds solved at once."""

PER_SPAN = round(SPAN / SPACING)

PLAN_STEP = 30.0
"""Step, s, of bsk_rl's look-ahead propagation."""

ORDER = 44
"""Degree of the interpolated accelerations; with the rounds below arcs are solved to 0.03 mm."""

ROUNDS = (3, 2, 1, 1)
"""Calls of :func:`relax` before the full field is first looked up, and after each time that it is."""

PLAN_ROUNDS = 3

PER_ROUND = 4
"""Picard iterations in one call of :func:`relax`."""

BLOCK = 48
"""A multiple of the column blocks of the usual matrix-product kernels."""

ZONAL, FULL = zonal_weights(), field_weights(DEGREE)


def frame_stretch(step: float) -> float:
    """Mean stretch of equatorial components by Basilisk's linear extrapolation of the Earth's orientation over a step.

    ``(omega dt)^2 / 2`` averaged over the Runge-Kutta stages.
    """
    return (EARTH_ROTATION_RATE * step) ** 2 / 6.0


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


def _stretched(r: Vec3, stretch: float | Tensor) -> Vec3:
    return Vec3(r.x * (1.0 + stretch), r.y * (1.0 + stretch), r.z)


def zonal_field(r: Vec3, stretch: float | Tensor = 0.0) -> Vec3:
    """Acceleration by the point mass and J2 in pole axes."""
    return _stretched(field(_stretched(r, stretch), ZONAL), stretch)


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
    f = rotate_z(_stretched(field(_stretched(p, stretch), FULL), stretch), cos, -sin)
    sun = Vec3(*around.r_sun.unbind(0)) + Vec3(*around.v_sun.unbind(0)) * dt
    return f + tilt.cross(f) + third_body(r, sun)


# -- the heavy parts: packs [K, 3, n] in and out ---------------------------------------------------------------------------


def _vec(pack: Tensor) -> Vec3:
    return Vec3(*pack.unbind(1))


def _pack(vector: Vec3) -> Tensor:
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
        acceleration = _pack(zonal_field(_vec(guess), stretch)) + rest
        guess = ballistic + (twice @ acceleration.flatten(1)).view(guess.shape)
    return guess


def lacking(r: Tensor, dt: Tensor, stretch: Tensor, r_sun: Tensor, v_sun: Tensor, angle: Tensor, rate: Tensor) -> Tensor:
    """What the zonal field lacks at positions [K, 3, n], dt [K, 1] seconds from the middle; see :class:`Surroundings`."""
    around = Surroundings(r_sun, v_sun, angle, rate)
    return _pack(full_field(_vec(r), around, dt, stretch) - zonal_field(_vec(r), stretch))


def zonal_step(state: Tensor, step: Tensor, stretch: Tensor, growth: Tensor) -> Tensor:
    """One Runge-Kutta step of ``step`` [] seconds in the zonal field, of position and velocity side by side, [K, 6, n].

    Equatorial components are stretched by ``stretch + growth * offset^2`` at the stage that lies ``offset`` seconds on.
    """

    def rates(stage: int, offset: float | Tensor, y: State) -> State:
        return y[1], zonal_field(y[0], stretch + growth * (offset * offset))

    r, v = rk4_step(rates, (Vec3(*state.unbind(1)[:3]), Vec3(*state.unbind(1)[3:])), step)
    return torch.stack([*r, *v], 1)


class Kernels(NamedTuple):
    """The heavy parts as they are, or compiled."""

    relax: Callable[..., Tensor]
    lacking: Callable[..., Tensor]
    zonal_step: Callable[..., Tensor]


@functools.cache
def kernels(backend: str) -> Kernels:
    """The heavy parts under a backend; compiled ones are shared by all environments of the process."""
    if backend == "eager":
        return Kernels(relax, lacking, zonal_step)
    batched = (True, True, True, False, False), (True, False, False, True, True, True, True), (True, False, False, False)
    parts: list[Callable[..., Tensor]] = [relax, lacking, zonal_step]
    names = (f"orbit solver ({part.__name__})" for part in parts)
    return Kernels(*(compiled(*three) for three in zip(parts, names, batched, strict=True)))


# -- a span ----------------------------------------------------------------------------------------------------------------


class Solver:
    """Solves spans for a simulation with ticks of ``step`` seconds."""

    def __init__(self, step: float, backend: str, device: torch.device) -> None:
        """Make the matrices of the quadrature."""
        self.device, self.kernels = device, kernels(backend)
        self.inside = quadrature(ORDER, None, str(device))
        self.outside = quadrature(ORDER, tuple((k + 1) / PER_SPAN for k in range(PER_SPAN)), str(device))
        self.twice = SPAN**2 * self.inside.position
        self.stretch, self.plan_stretch, self.plan_step = (
            torch.tensor(x, dtype=torch.float64, device=device)
            for x in (frame_stretch(step), frame_stretch(PLAN_STEP), PLAN_STEP)
        )
        self.plan_extrapolation = torch.zeros_like(self.stretch), torch.full_like(self.stretch, 0.5 * EARTH_ROTATION_RATE**2)

    def solve(self, et: Tensor, flown: Tensor, planned: Tensor) -> tuple[Tensor, Tensor]:
        """Nodes of the flown and the planned arc over the next hour, [n, 60, 9] each.

        Args:
            et: ET at the start, [n].
            flown: Node at the start, [n, 9]: position, velocity, acceleration in N.
            planned: The same of the planned arc.
        """
        count, rows = len(et), padded(len(et), et.device)
        nodes = self._solve(et[rows], flown[rows], planned[rows])
        return nodes[0][:count], nodes[1][:count]

    def _solve(self, et: Tensor, flown: Tensor, planned: Tensor) -> tuple[Tensor, Tensor]:
        pole = pole_matrix(et + SPAN / 2)
        r, v, planned_r, planned_v = (
            torch.stack(pole @ Vec3.of(node[:, k : k + 3])) for node in (flown, planned) for k in (0, 3)
        )
        path, rest = self._fly(r, v, surroundings(et + SPAN / 2, pole))
        acceleration = _pack(zonal_field(_vec(path), self.stretch)) + rest
        velocity = v + SPAN * _integrate(self.inside.velocity, acceleration)
        extra_v, extra_a = self._step_defect(torch.cat([path, velocity], 1)).chunk(2, 1)
        planned_a = self._plan(path, planned_r, planned_v, rest + extra_a, extra_v)
        return self._nodes(r, v, acceleration, None, pole), self._nodes(planned_r, planned_v, planned_a, extra_v, pole)

    def _step_defect(self, state: Tensor) -> Tensor:
        """Error per second of the Runge-Kutta step of ``PLAN_STEP`` that ends at states [K, 6, n].

        Found by comparison with four substeps, whose own error is 1/256 of it.
        """
        mean = self.plan_stretch, torch.zeros_like(self.plan_stretch)
        before = self.kernels.zonal_step(state, -self.plan_step, *mean)
        coarse, fine = self.kernels.zonal_step(before, self.plan_step, *self.plan_extrapolation), before
        for _ in range(4):
            fine = self.kernels.zonal_step(fine, self.plan_step / 4, *mean)
        return (coarse - fine) * ((256.0 / 255.0) / PLAN_STEP)

    def _ballistic(self, r: Tensor, v: Tensor) -> Tensor:
        return r + v * (self.inside.nodes * SPAN).view(-1, 1, 1)

    def _fly(self, r: Tensor, v: Tensor, around: Surroundings) -> tuple[Tensor, Tensor]:
        """Flown positions at the Chebyshev nodes, and what the zonal field lacks there."""
        time = (self.inside.nodes * SPAN).view(-1, 1, 1)
        motion = torch.sqrt(MU_EARTH / r.norm(dim=0) ** 3)
        path = r * torch.cos(motion * time) + v * (torch.sin(motion * time) / motion)
        ballistic, rest = self._ballistic(r, v), torch.zeros_like(path)
        dt = (self.inside.nodes - 0.5).unsqueeze(-1) * SPAN
        for k, rounds in enumerate(ROUNDS):
            if k:
                rest = self.kernels.lacking(path, dt, self.stretch, *around)
            for _ in range(rounds):
                path = self.kernels.relax(path, ballistic, rest, self.twice, self.stretch)
        return path, rest

    def _plan(self, path: Tensor, r: Tensor, v: Tensor, rest: Tensor, extra_v: Tensor) -> Tensor:
        """Accelerations of the planned arc at the Chebyshev nodes."""
        ballistic = self._ballistic(r, v) + SPAN * _integrate(self.inside.velocity, extra_v)
        for _ in range(PLAN_ROUNDS):
            path = self.kernels.relax(path, ballistic, rest, self.twice, self.plan_stretch)
        return _pack(zonal_field(_vec(path), self.plan_stretch)) + rest

    def _nodes(self, r: Tensor, v: Tensor, a: Tensor, extra_v: Tensor | None, pole: Mat3) -> Tensor:
        """Nodes [n, 60, 9] in N from accelerations [K, 3, n] in pole axes."""
        q = self.outside
        position = r + v * (q.times * SPAN).view(-1, 1, 1) + SPAN**2 * _integrate(q.position, a)
        if extra_v is not None:
            position = position + SPAN * _integrate(q.velocity, extra_v)
        packs = position, v + SPAN * _integrate(q.velocity, a), _integrate(q.value, a)
        return torch.cat([(pole.mT @ _vec(pack)).stack() for pack in packs], -1).transpose(0, 1)


def _integrate(matrix: Tensor, pack: Tensor) -> Tensor:
    """Matrix [M, K] times a pack [K, 3, n]."""
    return (matrix @ pack.flatten(1)).view(-1, *pack.shape[1:])


def padded(count: int, device: torch.device) -> Tensor:
    """Indices of ``count`` rows, the last repeated up to a multiple of :data:`BLOCK`.

    Matrix products round differently at the edge of a block, and no satellite's orbit may depend on how many others there are.
    """
    return torch.arange(-(-count // BLOCK) * BLOCK, device=device).clamp(max=count - 1)


def first_node(et: Tensor, r: Tensor, v: Tensor) -> Tensor:
    """Node [n, 9] at the epoch, from position and velocity [n, 3] in N."""
    pole = pole_matrix(et)
    a = pole.mT @ full_field(pole @ Vec3.of(r), surroundings(et, pole), torch.zeros_like(et), 0.0)
    return torch.cat([r, v, a.stack()], -1)
