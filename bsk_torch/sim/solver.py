"""Two ways to the same arcs: kernels that integrate each satellite, and Picard iteration on tensors."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from bsk_torch.astro.integrate import quadrature
from bsk_torch.constants import MU_EARTH
from bsk_torch.lanes.loop import Samples
from bsk_torch.sim import paths
from bsk_torch.sim.span import (
    LEAD,
    ORDER,
    PER_SPAN,
    PLAN_ROUNDS,
    PLAN_STEP,
    ROUNDS,
    SPACING,
    SPAN,
    Surroundings,
    frame_growth,
    frame_stretch,
    kernels,
    pack,
    pole_matrix,
    surroundings,
    vector,
    zonal_field,
)
from bsk_torch.vec3 import Mat3, Vec3

BLOCK = 48
"""A multiple of the column blocks of the usual matrix-product kernels."""

MINUTE_NS, STEP_NS = round(SPACING * 1e9), round(paths.PLANNED_STEP * 1e9)

PER_STEP = round(paths.PLANNED_STEP / PLAN_STEP)
"""Samples of the planned arc in a step of its kernel."""


class Solution(NamedTuple):
    """Positions in N, m, and what is needed to go on from the arcs' ends, [n, T].

    Those of the flown arc lie a minute apart, those of the planned arc 30 s.
    """

    flown: Tensor
    planned: Tensor
    tail: Tensor


class Solver(Protocol):
    """Solves arcs of n satellites."""

    device: torch.device
    tail: int

    def begin(self, et: Tensor, r: Tensor, v: Tensor, sky: Tensor, nodes: int) -> Solution:
        """Both arcs from the epoch on.

        Args:
            et: ET at the epoch, [n].
            r: Position in N, [n, 3] m.
            v: Velocity in N, [n, 3] m/s.
            sky: Records [n, H, 16] of Sun and Earth from the epoch on.
            nodes: Number of nodes, a minute apart: whole hours and one.

        Returns:
            Positions [n, LEAD + nodes, 3], planned ones [n, 2 nodes - 1, 3] from the epoch on.
        """

    def extend(self, et: Tensor, tail: Tensor, start: Tensor, sky: Tensor, flown: Tensor) -> Solution:
        """The next hour.

        Args:
            et: ET at the epoch, [n].
            tail: What the last call left, [n, T].
            start: Time of the first node and of the first record of the sky, [n] s since the epoch.
            sky: Records [n, H, 16] of Sun and Earth.
            flown: Flown nodes so far, [n, Q, 3], of which :data:`LEAD` before ``start``.

        Returns:
            Flown positions with the next hour, [n, Q + 60, 3], and planned ones of that hour, [n, 120, 3].
        """


def make_solver(step: float, backend: str, device: torch.device) -> Solver:
    """The solver for a simulation with ticks of ``step`` seconds."""
    return KernelSolver(step) if backend == "compiled" and device.type == "cpu" else PicardSolver(step, backend, device)


class KernelSolver:
    """Integrates each satellite by itself, see :mod:`bsk_torch.sim.paths`; for the CPU."""

    device = torch.device("cpu")
    tail = paths.FLOWN_STATE + paths.PLANNED_STATE

    def __init__(self, step: float) -> None:
        """Take the stretches of both arcs."""
        self.stretches = torch.tensor([frame_stretch(step), frame_stretch(PLAN_STEP)], dtype=torch.float64)
        self.schedule = paths.start_schedule()

    def begin(self, et: Tensor, r: Tensor, v: Tensor, sky: Tensor, nodes: int) -> Solution:
        """See :class:`Solver`."""
        n, around, lead = len(et), Samples(sky, torch.zeros_like(et)), 2 * LEAD
        fine = torch.empty(n, lead + 2 * nodes - 1, 3, dtype=torch.float64)
        state = self._start(r, v, around, fine)
        self._fly(state, torch.full((n,), paths.FIRST[-1]), around, fine[:, 1 + paths.ORDER :])
        flown = fine[:, ::2].contiguous()
        planned = torch.empty(n, 2 * nodes - 1, 3, dtype=torch.float64)
        planned[:, 0] = r
        tail = torch.zeros(paths.PLANNED_STATE, n, dtype=torch.float64)
        tracks = around, Samples(flown, around.start - LEAD * SPACING)
        once, epoch = torch.ones(n, dtype=torch.int64), torch.full((n,), -1)
        paths.defect_kernel()(tail, once, tracks, shared=self.stretches, ticks=epoch, nanoseconds=MINUTE_NS)
        self._plan(tail, epoch + 1, tracks, planned[:, 1:])
        return Solution(flown, planned, torch.cat([state, tail]).mT)

    def extend(self, et: Tensor, tail: Tensor, start: Tensor, sky: Tensor, flown: Tensor) -> Solution:
        """See :class:`Solver`."""
        n, last = flown.shape[0], flown.shape[1] - 1 - LEAD
        state, planned_tail = (x.contiguous() for x in tail.mT.split([paths.FLOWN_STATE, paths.PLANNED_STATE]))
        node = (start / SPACING).round().long() + last
        around, fine = Samples(sky, start), flown.new_empty(n, 2 * PER_SPAN, 3)
        self._fly(state, 2 * node, around, fine)
        longer = torch.cat([flown, fine[:, 1::2]], 1)
        planned = torch.empty(n, 2 * PER_SPAN, 3, dtype=torch.float64)
        self._plan(planned_tail, node * MINUTE_NS // STEP_NS, (around, Samples(longer, start - LEAD * SPACING)), planned)
        return Solution(longer, planned, torch.cat([state, planned_tail]).mT)

    def _start(self, r: Tensor, v: Tensor, around: Samples, flown: Tensor) -> Tensor:
        """Fill the first positions; the state with which the flown arc goes on."""
        n, ticks = len(r), len(self.schedule)
        state = torch.zeros(paths.START_STATE, n, dtype=torch.float64)
        state[:3], state[3:6] = r.mT, v.mT
        visited = torch.empty(n, ticks, 3, dtype=torch.float64)
        counts = torch.full((n,), ticks)
        paths.start_kernel()(state, counts, [around], shared=self.stretches, schedule=self.schedule, written=visited)
        lead, found = 2 * LEAD, visited[:, -paths.ORDER :]
        flown[:, :lead], flown[:, lead], flown[:, lead + 1 : paths.ORDER + 1] = found[:, :lead], r, found[:, lead:]
        accelerations = state[-6 - 3 * paths.ORDER : -6]
        return torch.cat([state[-6:], accelerations[3 : 3 * lead], state[6:9], accelerations[3 * lead :]])

    def _fly(self, state: Tensor, step: Tensor, around: Samples, flown: Tensor) -> None:
        counts = torch.full_like(step, flown.shape[1])
        kernel = paths.flown_kernel()
        kernel(state, counts, [around], shared=self.stretches, ticks=step, nanoseconds=MINUTE_NS // 2, written=flown)

    def _plan(self, tail: Tensor, step: Tensor, tracks: tuple[Samples, Samples], planned: Tensor) -> None:
        counts, kernel = torch.full_like(step, planned.shape[1] // PER_STEP), paths.planned_kernel()
        kernel(tail, counts, tracks, shared=self.stretches, ticks=step, nanoseconds=STEP_NS, written=planned)


class PicardSolver:
    """Solves an hour of all satellites at once; for eager simulations and for devices with many cores.

    Picard iteration on Chebyshev nodes: accelerations along the present guess are integrated twice to give the next one. Most
    iterations run in the field of the point mass and J2, which is cheap; what that field lacks is looked up a few times.
    """

    tail = 12

    def __init__(self, step: float, backend: str, device: torch.device) -> None:
        """Make the matrices of the quadrature."""
        self.device, self.kernels, self.compiled = device, kernels(backend), backend == "compiled"
        self.inside = quadrature(ORDER, None, str(device))
        self.outside = quadrature(ORDER, tuple((k + 1) / (2 * PER_SPAN) for k in range(2 * PER_SPAN)), str(device))
        self.twice = SPAN**2 * self.inside.position
        self.stretch, self.plan_stretch, self.growth = (
            torch.tensor(x, dtype=torch.float64, device=device)
            for x in (frame_stretch(step), frame_stretch(PLAN_STEP), frame_growth())
        )

    def begin(self, et: Tensor, r: Tensor, v: Tensor, sky: Tensor, nodes: int) -> Solution:
        """See :class:`Solver`."""
        tail = torch.cat([r, v, r, v], -1)
        flown, planned = [self._before(et, r, v), r.unsqueeze(1)], [r.unsqueeze(1)]
        for k in range((nodes - 1) // PER_SPAN):
            *new, tail = self._hour(et + k * SPAN, tail)
            flown.append(new[0])
            planned.append(new[1])
        return Solution(torch.cat(flown, 1), torch.cat(planned, 1), tail)

    def extend(self, et: Tensor, tail: Tensor, start: Tensor, sky: Tensor, flown: Tensor) -> Solution:
        """See :class:`Solver`."""
        new, planned, tail = self._hour(et + start + (flown.shape[1] - 1 - LEAD) * SPACING, tail)
        return Solution(torch.cat([flown, new], 1), planned, tail)

    def _before(self, et: Tensor, r: Tensor, v: Tensor) -> Tensor:
        """Nodes [n, LEAD, 3] before the epoch: the orbit with time running backwards."""
        count, rows = len(et), padded(len(et), et.device, few_sizes=self.compiled)
        et, pole = et[rows], pole_matrix(et[rows] - SPAN / 2)
        r, v = (torch.stack(list(pole @ Vec3.of(part[rows]))) for part in (r, -v))
        path, rest = self._fly(r, v, surroundings(et - SPAN / 2, pole), -1.0)
        acceleration = pack(zonal_field(vector(path), self.stretch)) + rest
        return self._nodes(r, v, acceleration, None, pole)[0][:count, 1 : 2 * LEAD : 2].flip(1)

    def _hour(self, et: Tensor, tail: Tensor) -> Solution:
        """The hour that starts at ET [n], from position and velocity on both arcs, [n, 12]."""
        count, rows = len(et), padded(len(et), et.device, few_sizes=self.compiled)
        return Solution(*(part[:count] for part in self._solve(et[rows], tail[rows])))

    def _solve(self, et: Tensor, tail: Tensor) -> Solution:
        pole = pole_matrix(et + SPAN / 2)
        r, v, planned_r, planned_v = (torch.stack(list(pole @ Vec3.of(part))) for part in tail.split(3, -1))
        path, rest = self._fly(r, v, surroundings(et + SPAN / 2, pole))
        acceleration = pack(zonal_field(vector(path), self.stretch)) + rest
        speed = v + SPAN * _integrate(self.inside.velocity, acceleration)
        extra_v, extra_a = self.kernels.defects(torch.cat([path, speed], 1), self.plan_stretch, self.growth).chunk(2, 1)
        planned_a = self._plan(path, planned_r, planned_v, rest + extra_a, extra_v)
        flown, flown_end = self._nodes(r, v, acceleration, None, pole)
        planned, planned_end = self._nodes(planned_r, planned_v, planned_a, extra_v, pole)
        return Solution(flown[:, 1::2], planned, torch.cat([flown_end, planned_end], -1))

    def _ballistic(self, r: Tensor, v: Tensor) -> Tensor:
        return r + v * (self.inside.nodes * SPAN).view(-1, 1, 1)

    def _fly(self, r: Tensor, v: Tensor, around: Surroundings, sense: float = 1.0) -> tuple[Tensor, Tensor]:
        """Flown positions at the Chebyshev nodes, and what the zonal field lacks there; backwards where ``sense`` is -1."""
        time = (self.inside.nodes * SPAN).view(-1, 1, 1)
        motion = torch.sqrt(MU_EARTH / r.norm(dim=0) ** 3)
        path = r * torch.cos(motion * time) + v * (torch.sin(motion * time) / motion)
        ballistic, rest = self._ballistic(r, v), torch.zeros_like(path)
        dt = (self.inside.nodes - 0.5).unsqueeze(-1) * (SPAN * sense)
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
        return pack(zonal_field(vector(path), self.plan_stretch)) + rest

    def _nodes(self, r: Tensor, v: Tensor, a: Tensor, extra_v: Tensor | None, pole: Mat3) -> tuple[Tensor, Tensor]:
        """Positions [n, 120, 3] in N from accelerations [K, 3, n] in pole axes; position and velocity at the end, [n, 6]."""
        q = self.outside
        position = r + v * (q.times * SPAN).view(-1, 1, 1) + SPAN**2 * _integrate(q.position, a)
        if extra_v is not None:
            position = position + SPAN * _integrate(q.velocity, extra_v)
        velocity = v + SPAN * _integrate(q.velocity[-1:], a)
        r_N, v_N = ((pole.mT @ vector(x)).stack().transpose(0, 1) for x in (position, velocity))
        return r_N, torch.cat([r_N[:, -1], v_N[:, -1]], -1)


def _integrate(matrix: Tensor, values: Tensor) -> Tensor:
    """Matrix [M, K] times a pack [K, 3, n]."""
    return (matrix @ values.flatten(1)).view(-1, *values.shape[1:])


def padded(count: int, device: torch.device, few_sizes: bool = False) -> Tensor:
    """Indices of ``count`` rows, the last repeated up to a multiple of :data:`BLOCK`.

    Matrix products round differently at the edge of a block, and no satellite's orbit may depend on how many others there are.
    With ``few_sizes`` the multiple is a power of two: what is compiled for its shapes is compiled a few times only.
    """
    blocks = -(-count // BLOCK)
    blocks = 1 << (blocks - 1).bit_length() if few_sizes else blocks
    return torch.arange(blocks * BLOCK, device=device).clamp(max=count - 1)
