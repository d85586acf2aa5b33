"""Arcs integrated by kernels, each satellite by itself; for the CPU."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.earth_rotation import IAU_EARTH, Earth
from bsk_torch.astro.gravity import DEGREE
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.orbit import flown_arc, planned_arc
from bsk_torch.sim.orbit.equations import frame_stretch
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, LEAD_NODES, NODE_SPACING, NODES_PER_SEGMENT, PLAN_STEP, RECORDS
from bsk_torch.sim.orbit.picard import PicardSolver
from bsk_torch.sim.orbit.solution import Solution, Solver

MINUTE_NS, DIFFERENCE_STEP_NS = round(NODE_SPACING * 1e9), round(planned_arc.DIFFERENCE_STEP * 1e9)

SAMPLES_PER_STEP = round(planned_arc.DIFFERENCE_STEP / PLAN_STEP)  # samples of the planned arc in a step of its kernel


class KernelSolver(Solver):
    """Solves arcs with kernels.

    The kernels are those of :mod:`bsk_torch.sim.orbit.flown_arc` and :mod:`bsk_torch.sim.orbit.planned_arc`. The tail holds the
    state of the flown arc's kernel, then that of the planned arc's.
    """

    device = torch.device("cpu")
    tail = flown_arc.FLOWN_STATE + planned_arc.PLANNED_STATE

    def __init__(self, step: float, degree: int, earth: Earth) -> None:
        self.degree, self.earth = degree, earth
        self.stretches = torch.tensor([frame_stretch(step), frame_stretch(PLAN_STEP)], dtype=torch.float64)

    @override
    def begin(self, et: Tensor, r: Tensor, v: Tensor, ephemeris: Tensor, nodes: int) -> Solution:
        # hours are solved one by one, as extend does, so that arcs do not depend on how far they are solved at once
        first = self._first_hour(et, r, v, ephemeris[:, :RECORDS].contiguous())
        flown, planned, tail = [first.flown], [first.planned], first.tail
        for hour in range(1, (nodes - 1) // NODES_PER_SEGMENT):
            start, around = torch.full_like(et, hour * ARC_SEGMENT), ephemeris[:, hour : hour + RECORDS].contiguous()
            new = self.extend(et, tail, start, around, flown[-1][:, -1 - LEAD_NODES :])
            flown.append(new.flown[:, 1 + LEAD_NODES :])
            planned.append(new.planned)
            tail = new.tail
        return Solution(torch.cat(flown, 1), torch.cat(planned, 1), tail)

    def _first_hour(self, et: Tensor, r: Tensor, v: Tensor, ephemeris: Tensor) -> Solution:
        n, around, lead, nodes = len(et), Samples(ephemeris, torch.zeros_like(et)), 2 * LEAD_NODES, NODES_PER_SEGMENT + 1
        fine = torch.empty(n, lead + 2 * nodes - 1, 3, dtype=torch.float64)
        state = self._start(r, v, around, fine)
        self._fly(state, torch.full((n,), flown_arc.START_STEPS[-1]), around, fine[:, 1 + flown_arc.MULTISTEP_ORDER :])
        flown = fine[:, ::2].contiguous()
        planned = torch.empty(n, 2 * nodes - 1, 3, dtype=torch.float64)
        planned[:, 0] = r
        tail = torch.zeros(planned_arc.PLANNED_STATE, n, dtype=torch.float64)
        tracks = around, Samples(flown, around.start - LEAD_NODES * NODE_SPACING)
        once, epoch = torch.ones(n, dtype=torch.int64), torch.full((n,), -1)
        planned_arc.defect_kernel()(tail, once, tracks, shared=self.stretches, ticks=epoch, nanoseconds=MINUTE_NS)
        self._plan(tail, epoch + 1, tracks, planned[:, 1:])
        return Solution(flown, planned, torch.cat([state, tail]).mT)

    @override
    def extend(self, et: Tensor, tail: Tensor, start: Tensor, ephemeris: Tensor, flown: Tensor) -> Solution:
        n, last = flown.shape[0], flown.shape[1] - 1 - LEAD_NODES
        state, planned_tail = (x.contiguous() for x in tail.mT.split([flown_arc.FLOWN_STATE, planned_arc.PLANNED_STATE]))
        node = (start / NODE_SPACING).round().long() + last
        around, fine = Samples(ephemeris, start), flown.new_empty(n, 2 * NODES_PER_SEGMENT, 3)
        self._fly(state, 2 * node, around, fine)
        longer = torch.cat([flown, fine[:, 1::2]], 1)
        planned = torch.empty(n, 2 * NODES_PER_SEGMENT, 3, dtype=torch.float64)
        tracks = around, Samples(longer, start - LEAD_NODES * NODE_SPACING)
        self._plan(planned_tail, node * MINUTE_NS // DIFFERENCE_STEP_NS, tracks, planned)
        return Solution(longer, planned, torch.cat([state, planned_tail]).mT)

    @override
    def accelerations(self, nodes: Tensor, ephemeris: Samples) -> Tensor:
        n, count, _ = nodes.shape
        half = torch.full((n,), -0.5 * NODE_SPACING, dtype=torch.float64)  # out of reach of rounding
        written = torch.empty_like(nodes)
        state, tracks = torch.zeros(1, n, dtype=torch.float64), (ephemeris, Samples(nodes, half))
        flown_arc.acceleration_kernel(self.degree)(state, count, tracks, shared=self.stretches, written=written)
        return written

    def _start(self, r: Tensor, v: Tensor, around: Samples, flown: Tensor) -> Tensor:
        """Fill the first positions; return the state from which the flown arc continues."""
        state, visited = start_flight(self.degree, self.stretches, r, v, around)
        lead, first_positions = 2 * LEAD_NODES, visited[:, -flown_arc.MULTISTEP_ORDER :]
        flown[:, :lead], flown[:, lead] = first_positions[:, :lead], r
        flown[:, lead + 1 : flown_arc.MULTISTEP_ORDER + 1] = first_positions[:, lead:]
        return state

    def _fly(self, state: Tensor, step: Tensor, around: Samples, flown: Tensor) -> None:
        continue_flight(self.degree, self.stretches, state, step, torch.full_like(step, flown.shape[1]), around, flown)

    def _plan(self, tail: Tensor, step: Tensor, tracks: tuple[Samples, Samples], planned: Tensor) -> None:
        counts, kernel = torch.full_like(step, planned.shape[1] // SAMPLES_PER_STEP), planned_arc.planned_kernel()
        kernel(tail, counts, tracks, shared=self.stretches, ticks=step, nanoseconds=DIFFERENCE_STEP_NS, written=planned)


def start_flight(degree: int, stretches: Tensor, r: Tensor, v: Tensor, around: Samples) -> tuple[Tensor, Tensor]:
    """Return the state [C, n] of the flown arc's kernel at the last of the start's nodes, and the positions on the way there.

    r and v are position, [n, 3] m, and velocity, [n, 3] m/s, in N at the epoch, ``around`` the records of Sun and Earth from
    there on. Of the ``stretches``, the first is that of the flown arc.
    """
    schedule, lead = flown_arc.start_schedule(), 2 * LEAD_NODES
    n, ticks = len(r), len(schedule)
    state = torch.zeros(flown_arc.START_STATE, n, dtype=torch.float64)
    state[:3], state[3:6] = r.mT, v.mT
    visited, counts = torch.empty(n, ticks, 3, dtype=torch.float64), torch.full((n,), ticks)
    flown_arc.start_kernel(degree)(state, counts, [around], shared=stretches, schedule=schedule, written=visited)
    accelerations = state[-6 - 3 * flown_arc.MULTISTEP_ORDER : -6]
    return torch.cat([state[-6:], accelerations[3 : 3 * lead], state[6:9], accelerations[3 * lead :]]), visited


def continue_flight(
    degree: int, stretches: Tensor, state: Tensor, step: Tensor, counts: Tensor, around: Samples, flown: Tensor | None = None
) -> None:
    """Advance states [C, n] of the flown arc's kernel, which are at ``step`` [n], by ``counts`` [n] steps.

    The positions of the steps are written to ``flown`` [n, K, 3], m, if given.
    """
    kernel = flown_arc.flown_kernel(degree, flown is not None)
    kernel(state, counts, [around], shared=stretches, ticks=step, nanoseconds=MINUTE_NS // 2, written=flown)


def make_solver(step: float, backend: str, device: torch.device, degree: int = DEGREE, earth: Earth = IAU_EARTH) -> Solver:
    """Return the solver for a simulation with ticks of ``step`` seconds, in the Earth's field of a degree and order.

    ``earth`` is the model of the Earth's rotation.
    """
    if backend == "compiled" and device.type == "cpu":
        return KernelSolver(step, degree, earth)
    return PicardSolver(step, backend, device, degree, earth)
