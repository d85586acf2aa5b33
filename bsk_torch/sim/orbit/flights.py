"""Orbits carried along step by step: flights in the state of the multistep method, of which little is kept.

An arc keeps the nodes of hours. A flight keeps position and velocity at one step, and the last accelerations. Their polynomial,
integrated twice, gives position and velocity at any time since the first of them: it is the one by which the step was made.
"""

from __future__ import annotations

import functools
from functools import cache
from typing import Protocol

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.gravity import DEGREE
from bsk_torch.astro.multistep import lagrange
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.component import Bus, neighbours
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_at
from bsk_torch.sim.orbit.equations import frame_stretch
from bsk_torch.sim.orbit.flown_arc import (
    MULTISTEP_ORDER,
    MULTISTEP_STEP,
    START_STEPS,
    acceleration,
    flown_step,
    start_schedule,
    visited,
)
from bsk_torch.sim.orbit.grid import LEAD_NODES
from bsk_torch.sim.orbit.kernel_solver import continue_flight, start_flight
from bsk_torch.vec3 import Vec3

FIRST_STEP = START_STEPS[-1]  # step after the epoch at which a flight starts
REMEMBERED = MULTISTEP_ORDER - 1  # steps before the one it is at for which a flight remembers accelerations


class Flights(Protocol):
    """Starts and advances the flights of n objects, [C, n] numbers: r and v, m and m/s in N, and accelerations, oldest first."""

    device: torch.device

    def start(self, r: Tensor, v: Tensor, ephemeris: Samples) -> Tensor:
        """Return flights at step :data:`FIRST_STEP`, from positions, [n, 3] m, and velocities, [n, 3] m/s, in N at the epoch.

        ``ephemeris`` holds the records of Sun and Earth from the epoch on.
        """

    def advance(self, flight: Tensor, step: Tensor, counts: Tensor, ephemeris: Samples) -> None:
        """Advance flights [C, n], in place, from ``step`` [n] by ``counts`` [n] steps."""

    def fly(self, flight: Tensor, step: Tensor, count: int, ephemeris: Samples) -> Tensor:
        """Advance flights [C, n] in place from ``step`` [n] by ``count`` steps; return the positions there, [n, count, 3] m."""


def make_flights(step: float, backend: str, device: torch.device, degree: int = DEGREE) -> Flights:
    """Return what advances flights in a simulation with ticks of ``step`` seconds, in the Earth's field of a degree and order."""
    if backend == "compiled" and device.type == "cpu":
        return KernelFlights(step, degree)
    return TensorFlights(step, device, degree)


class KernelFlights(Flights):
    """Flights advanced by the kernels of the flown arc."""

    device = torch.device("cpu")

    def __init__(self, step: float, degree: int) -> None:
        self.degree, self.stretch = degree, torch.tensor([frame_stretch(step)], dtype=torch.float64)

    @override
    def start(self, r: Tensor, v: Tensor, ephemeris: Samples) -> Tensor:
        return start_flight(self.degree, self.stretch, r, v, ephemeris)[0]

    @override
    def advance(self, flight: Tensor, step: Tensor, counts: Tensor, ephemeris: Samples) -> None:
        continue_flight(self.degree, self.stretch, flight, step, counts, ephemeris)

    @override
    def fly(self, flight: Tensor, step: Tensor, count: int, ephemeris: Samples) -> Tensor:
        flown = flight.new_empty(len(step), count, 3)
        continue_flight(self.degree, self.stretch, flight, step, torch.full_like(step, count), ephemeris, flown)
        return flown


class TensorFlights(Flights):
    """Flights advanced on tensors."""

    def __init__(self, step: float, device: torch.device, degree: int) -> None:
        self.degree, self.device = degree, device
        self.stretch = torch.tensor(frame_stretch(step), dtype=torch.float64, device=device)

    @override
    def start(self, r: Tensor, v: Tensor, ephemeris: Samples) -> Tensor:
        r0, v0 = Vec3.of(r), Vec3.of(v)
        first, *others = start_schedule().tolist()
        a0 = self._acceleration(r0, torch.full_like(r0.x, first[0]), ephemeris)
        last, this = [a0] * MULTISTEP_ORDER, []
        for time, _, ends, *weights in others:
            position, velocity = visited(r0, v0, [a0, *last], time, weights)
            this.append(self._acceleration(position, torch.full_like(r0.x, time), ephemeris))
            if ends:
                last, this = this, []
        lead = 2 * LEAD_NODES
        return _packed([position, velocity, *last[1:lead], a0, *last[lead:]])

    @override
    def advance(self, flight: Tensor, step: Tensor, counts: Tensor, ephemeris: Samples) -> None:
        for k in range(int(counts.max())):
            flight.copy_(torch.where(k < counts, self._after(flight, step + k + 1, ephemeris), flight))

    @override
    def fly(self, flight: Tensor, step: Tensor, count: int, ephemeris: Samples) -> Tensor:
        flown = flight.new_empty(len(step), count, 3)
        for k in range(count):
            flight.copy_(self._after(flight, step + k + 1, ephemeris))
            flown[:, k] = flight[:3].mT
        return flown

    def _after(self, flight: Tensor, step: Tensor, ephemeris: Samples) -> Tensor:
        r, v, *accelerations = (Vec3(*part) for part in flight.split(3))
        around = functools.partial(self._around, MULTISTEP_STEP * step.double(), ephemeris)
        after = flown_step(r, v, accelerations, around, self.stretch, self.degree)
        return _packed([after[0], after[1], *after[2]])

    def _acceleration(self, r: Vec3, time: Tensor, ephemeris: Samples) -> Vec3:
        return acceleration(self._around(time, ephemeris), r, self.stretch, self.degree)

    def _around(self, time: Tensor, ephemeris: Samples) -> Bus:
        rows = torch.arange(len(time), device=self.device) if ephemeris.owner is None else ephemeris.owner
        records, tau = neighbours(EPHEMERIS_TRACK, ephemeris.table, rows, time - ephemeris.start[rows])
        return ephemeris_at(records.flatten(1).unbind(-1), tau)


def _packed(vectors: list[Vec3]) -> Tensor:
    return torch.stack([component for vector in vectors for component in vector])


@cache
def _integrals(device: torch.device) -> tuple[Tensor, Tensor]:
    """Return coefficients of the integrals of Lagrange's polynomials over the remembered steps, [MULTISTEP_ORDER, P] each.

    With ``l_j(s) = sum_p c_jp s^p``, those of ``int_0^s (s - u) l_j(u) du / s^2`` are ``c_jp / ((p + 1) (p + 2))``, and those of
    ``int_0^s l_j(u) du / s`` are ``c_jp / (p + 1)``.
    """
    nodes = lagrange(tuple(range(-REMEMBERED, 1)))
    twice = [[float(c / ((p + 1) * (p + 2))) for p, c in enumerate(terms)] for terms in nodes]
    once = [[float(c / (p + 1)) for p, c in enumerate(terms)] for terms in nodes]
    return tuple(torch.tensor(table, dtype=torch.float64, device=device) for table in (twice, once))  # type: ignore[return-value]


def _weights(table: Tensor, s: Tensor) -> Tensor:
    """Return the polynomials of ``table`` at s [n], [MULTISTEP_ORDER, n] (Horner's rule)."""
    total = table[:, -1:].expand(-1, len(s))
    for column in table[:, :-1].flip(1).unbind(1):
        total = column.unsqueeze(1) + total * s
    return total


def positions(flight: Tensor, s: Tensor) -> Tensor:
    """Return positions, [3, n, ...] m in N, of flights [C, n, ...], ``s`` [n] steps after the one that they are at.

    ``r(s) = r + h s v + h^2 sum_j w_j a_j`` with the step h, s; s is not positive, and not below ``-REMEMBERED``.
    """
    integral = _integral(flight, _weights(_integrals(flight.device)[0], s) * (s * s * MULTISTEP_STEP**2))
    return flight[:3] + flight[3:6] * (s * MULTISTEP_STEP).view(-1, *[1] * (flight.ndim - 2)) + integral


def velocities(flight: Tensor, s: Tensor) -> Tensor:
    """Return velocities, [3, n, ...] m/s in N; see :func:`positions`."""
    return flight[3:6] + _integral(flight, _weights(_integrals(flight.device)[1], s) * (s * MULTISTEP_STEP))


def _integral(flight: Tensor, weights: Tensor) -> Tensor:
    """Return the sum of accelerations of flights [C, n, ...] with weights [MULTISTEP_ORDER, n], [3, n, ...]."""
    total = torch.zeros_like(flight[:3])
    for j, weight in enumerate(weights):
        total = torch.addcmul(total, flight[6 + 3 * j : 9 + 3 * j], weight.view(-1, *[1] * (flight.ndim - 2)))
    return total
