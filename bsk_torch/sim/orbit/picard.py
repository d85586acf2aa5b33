"""Arcs solved by Picard iteration on tensors; for eager simulations and for devices with many cores.

With time tau in [0, 1] over a segment of T seconds, the equations of motion ``r'' = a(r, t)`` are those of an integral equation::

    r(tau) = r0 + v0 T tau + T^2 int_0^tau (tau - s) a(r(s), s) ds

Picard iteration evaluates a along the present guess of r and integrates it to the next one. Accelerations at Chebyshev nodes are
interpolated by a polynomial, whose integrals are exact, so an integration is the product with a matrix
(:func:`bsk_torch.astro.integrate.quadrature`). Source: Bai and Junkins, "Modified Chebyshev-Picard Iteration Methods for Orbit
Propagation", Journal of the Astronautical Sciences 58, 2011.

Most iterations run in the zonal field, which is cheap; what it lacks of the full field changes little with r and is evaluated a
few times only. The heavy parts work on packs [K, 3, n] of K nodes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.earth_rotation import Earth
from bsk_torch.astro.integrate import quadrature
from bsk_torch.codegen.inductor import just_in_time
from bsk_torch.codegen.kernel import Samples
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.component import neighbours
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_at
from bsk_torch.sim.orbit.equations import (
    FRAME_GROWTH,
    Surroundings,
    frame_stretch,
    full_field,
    step_defect,
    surroundings,
    zonal_field,
)
from bsk_torch.sim.orbit.flown_arc import acceleration
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, LEAD_NODES, NODE_SPACING, NODES_PER_SEGMENT, PLAN_STEP
from bsk_torch.sim.orbit.solution import Solution, Solver
from bsk_torch.vec3 import Mat3, Vec3

PICARD_DEGREE = 44  # degree of the interpolated accelerations; with the rounds below arcs are solved to 0.03 mm
ROUNDS = (3, 2, 1, 1)  # calls of relax before the full field is first evaluated, and after each time that it is
PLAN_ROUNDS = 3  # calls of relax for the planned arc, which starts from the flown one
PER_ROUND = 4  # Picard iterations in one call of relax
COLUMN_BLOCK = 48  # a multiple of the column blocks of the usual matrix-product kernels


def vector(pack: Tensor) -> Vec3:
    """Vector of a pack [K, 3, n]."""
    return Vec3(*pack.unbind(1))


def pack(vector: Vec3) -> Tensor:
    """Pack [K, 3, n] of a vector."""
    return torch.stack(list(vector), 1)


def relax(guess: Tensor, ballistic: Tensor, rest: Tensor, twice: Tensor, stretch: Tensor) -> Tensor:
    """Return the guess, positions at the nodes [K, 3, n], m, after :data:`PER_ROUND` Picard iterations in the zonal field.

    Each is ``r_k <- r0 + v0 t_k + sum_j A_kj (a_z(r_j) + rest_j)``. The matrix A, ``twice`` [K, K] s^2, integrates
    accelerations at the nodes twice, ``rest`` [K, 3, n], m/s^2, is the acceleration that the zonal field a_z lacks, held
    constant, and ``ballistic`` [K, 3, n], m, is ``r0 + v0 t_k``. ``stretch`` [] is that of
    :func:`bsk_torch.sim.orbit.equations.frame_stretch`.
    """
    for _ in range(PER_ROUND):
        acceleration = pack(zonal_field(vector(guess), stretch)) + rest
        guess = ballistic + (twice @ acceleration.flatten(1)).view(guess.shape)
    return guess


def lacking(
    r: Tensor, dt: Tensor, stretch: Tensor, degree: int, r_SN_E: Tensor, v_SN_E: Tensor, angle: Tensor, rate: Tensor
) -> Tensor:
    """Return what the zonal field lacks of the field of a degree, m/s^2 in E, at r [K, 3, n], m, dt [K, 1] s from the middle."""
    around = Surroundings(r_SN_E, v_SN_E, angle, rate)
    return pack(full_field(vector(r), around, dt, stretch, degree) - zonal_field(vector(r), stretch))


def defects(state: Tensor, stretch: Tensor, growth: Tensor) -> Tensor:
    """:func:`step_defect` of position and velocity side by side, [K, 6, n]."""
    r, v = step_defect(Vec3(*state.unbind(1)[:3]), Vec3(*state.unbind(1)[3:]), stretch, growth)
    return torch.stack([*r, *v], 1)


class Kernels(NamedTuple):
    """The expensive parts, compiled or not."""

    relax: Callable[..., Tensor]
    lacking: Callable[..., Tensor]
    defects: Callable[..., Tensor]


@functools.cache
def kernels(backend: str) -> Kernels:
    """The heavy parts under a backend; compiled ones are shared by all environments of the process."""
    parts: list[Callable[..., Tensor]] = [relax, lacking, defects]
    return Kernels(*(just_in_time(part, f"orbit solver ({part.__name__})") if backend == "compiled" else part for part in parts))


class PicardSolver(Solver):
    """Solves a segment of all satellites at once.

    The tail holds position and velocity at the end of the flown arc, then those of the planned arc.
    """

    tail = 12

    def __init__(self, step: float, backend: str, device: torch.device, degree: int, earth: Earth) -> None:
        self.degree, self.earth = degree, earth
        self.device, self.kernels, self.compiled = device, kernels(backend), backend == "compiled"
        self.inside = quadrature(PICARD_DEGREE, None, str(device))
        self.outside = quadrature(
            PICARD_DEGREE, tuple((k + 1) / (2 * NODES_PER_SEGMENT) for k in range(2 * NODES_PER_SEGMENT)), str(device)
        )
        self.twice = ARC_SEGMENT**2 * self.inside.position
        self.stretch, self.plan_stretch, self.growth = (
            torch.tensor(x, dtype=torch.float64, device=device)
            for x in (frame_stretch(step), frame_stretch(PLAN_STEP), FRAME_GROWTH)
        )

    @override
    def begin(self, et: Tensor, r: Tensor, v: Tensor, ephemeris: Tensor, nodes: int) -> Solution:
        tail = torch.cat([r, v, r, v], -1)
        flown, planned = [self._before(et, r, v), r.unsqueeze(1)], [r.unsqueeze(1)]
        for k in range((nodes - 1) // NODES_PER_SEGMENT):
            *new, tail = self._hour(et + k * ARC_SEGMENT, tail)
            flown.append(new[0])
            planned.append(new[1])
        return Solution(torch.cat(flown, 1), torch.cat(planned, 1), tail)

    @override
    def extend(self, et: Tensor, tail: Tensor, start: Tensor, ephemeris: Tensor, flown: Tensor) -> Solution:
        new, planned, tail = self._hour(et + (start + (flown.shape[1] - 1 - LEAD_NODES) * NODE_SPACING), tail)
        return Solution(torch.cat([flown, new], 1), planned, tail)

    @override
    def accelerations(self, nodes: Tensor, ephemeris: Samples) -> Tensor:
        n, count, _ = nodes.shape
        rows = torch.arange(n, device=self.device).repeat_interleave(count)
        time = (NODE_SPACING * torch.arange(count, dtype=torch.float64, device=self.device)).repeat(n)
        records, tau = neighbours(EPHEMERIS_TRACK, ephemeris.table, rows, time - ephemeris.start[rows])
        sky = ephemeris_at(records.flatten(1).unbind(-1), tau)
        return acceleration(sky, Vec3.of(nodes.flatten(0, 1)), self.stretch, self.degree).stack().view(nodes.shape)

    def _before(self, et: Tensor, r: Tensor, v: Tensor) -> Tensor:
        """Nodes [n, LEAD_NODES, 3] before the epoch: the orbit with time running backwards."""
        count, rows = len(et), padded(len(et), et.device, few_sizes=self.compiled)
        et, pole = et[rows], self.earth.pole(et[rows] - ARC_SEGMENT / 2)
        r, v = (torch.stack(list(pole @ Vec3.of(part[rows]))) for part in (r, -v))
        path, rest = self._fly(r, v, surroundings(et - ARC_SEGMENT / 2, pole, self.earth), -1.0)
        acceleration = pack(zonal_field(vector(path), self.stretch)) + rest
        return self._nodes(r, v, acceleration, None, pole)[0][:count, 1 : 2 * LEAD_NODES : 2].flip(1)

    def _hour(self, et: Tensor, tail: Tensor) -> Solution:
        """The hour that starts at ET [n], from position and velocity on both arcs, [n, 12]."""
        count, rows = len(et), padded(len(et), et.device, few_sizes=self.compiled)
        return Solution(*(part[:count] for part in self._solve(et[rows], tail[rows])))

    def _solve(self, et: Tensor, tail: Tensor) -> Solution:
        pole = self.earth.pole(et + ARC_SEGMENT / 2)
        r, v, planned_r, planned_v = (torch.stack(list(pole @ Vec3.of(part))) for part in tail.split(3, -1))
        path, rest = self._fly(r, v, surroundings(et + ARC_SEGMENT / 2, pole, self.earth))
        acceleration = pack(zonal_field(vector(path), self.stretch)) + rest
        speed = v + ARC_SEGMENT * _integrate(self.inside.velocity, acceleration)
        extra_v, extra_a = self.kernels.defects(torch.cat([path, speed], 1), self.plan_stretch, self.growth).chunk(2, 1)
        planned_a = self._plan(path, planned_r, planned_v, rest + extra_a, extra_v)
        flown, flown_end = self._nodes(r, v, acceleration, None, pole)
        planned, planned_end = self._nodes(planned_r, planned_v, planned_a, extra_v, pole)
        return Solution(flown[:, 1::2], planned, torch.cat([flown_end, planned_end], -1))

    def _ballistic(self, r: Tensor, v: Tensor) -> Tensor:
        return r + v * (self.inside.nodes * ARC_SEGMENT).view(-1, 1, 1)

    def _fly(self, r: Tensor, v: Tensor, around: Surroundings, sense: float = 1.0) -> tuple[Tensor, Tensor]:
        """Flown positions at the Chebyshev nodes, and what the zonal field lacks there; backwards where ``sense`` is -1."""
        time = (self.inside.nodes * ARC_SEGMENT).view(-1, 1, 1)
        motion = torch.sqrt(MU_EARTH / r.norm(dim=0) ** 3)
        path = r * torch.cos(motion * time) + v * (torch.sin(motion * time) / motion)
        ballistic, rest = self._ballistic(r, v), torch.zeros_like(path)
        dt = (self.inside.nodes - 0.5).unsqueeze(-1) * (ARC_SEGMENT * sense)
        for k, rounds in enumerate(ROUNDS):
            if k:
                rest = self.kernels.lacking(path, dt, self.stretch, self.degree, *around)
            for _ in range(rounds):
                path = self.kernels.relax(path, ballistic, rest, self.twice, self.stretch)
        return path, rest

    def _plan(self, path: Tensor, r: Tensor, v: Tensor, rest: Tensor, extra_v: Tensor) -> Tensor:
        ballistic = self._ballistic(r, v) + ARC_SEGMENT * _integrate(self.inside.velocity, extra_v)
        for _ in range(PLAN_ROUNDS):
            path = self.kernels.relax(path, ballistic, rest, self.twice, self.plan_stretch)
        return pack(zonal_field(vector(path), self.plan_stretch)) + rest

    def _nodes(self, r: Tensor, v: Tensor, a: Tensor, extra_v: Tensor | None, pole: Mat3) -> tuple[Tensor, Tensor]:
        """Positions [n, 120, 3] in N from accelerations [K, 3, n] in pole axes; position and velocity at the end, [n, 6]."""
        q = self.outside
        position = r + v * (q.times * ARC_SEGMENT).view(-1, 1, 1) + ARC_SEGMENT**2 * _integrate(q.position, a)
        if extra_v is not None:
            position = position + ARC_SEGMENT * _integrate(q.velocity, extra_v)
        velocity = v + ARC_SEGMENT * _integrate(q.velocity[-1:], a)
        r_N, v_N = ((pole.mT @ vector(x)).stack().transpose(0, 1) for x in (position, velocity))
        return r_N, torch.cat([r_N[:, -1], v_N[:, -1]], -1)


def _integrate(matrix: Tensor, values: Tensor) -> Tensor:
    return (matrix @ values.flatten(1)).view(-1, *values.shape[1:])


def padded(count: int, device: torch.device, few_sizes: bool = False) -> Tensor:
    """Indices of ``count`` rows, the last repeated up to a multiple of :data:`COLUMN_BLOCK`.

    Matrix products round differently at the edge of a block, and no satellite's orbit may depend on how many others there are.
    With ``few_sizes`` the multiple is a power of two: what is compiled for its shapes is compiled a few times only.
    """
    blocks = -(-count // COLUMN_BLOCK)
    blocks = 1 << (blocks - 1).bit_length() if few_sizes else blocks
    return torch.arange(blocks * COLUMN_BLOCK, device=device).clamp(max=count - 1)
