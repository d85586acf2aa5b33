"""Where the satellite will be: arcs computed ahead of the simulation, in batched passes.

Without manoeuvres and above the felt atmosphere an orbit depends on nothing that the agent does, so it is solved in advance:
Picard iteration on Chebyshev nodes evaluates an hour at a time, and a quintic between nodes a minute apart serves every tick.

Two arcs are kept for each satellite. The *flown* arc is the one that Basilisk integrates at the simulation's rate. The *planned*
arc is the one that bsk_rl looks ahead on, a Runge-Kutta propagation in steps of 30 s; its truncation error, metres per orbit, is
reproduced by adding the error of one such step to the equations of motion.
"""

from __future__ import annotations

import math
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
from bsk_torch.astro.integrate import State, picard_path, picard_velocity, quadrature, rk4_step
from bsk_torch.astro.interpolate import Node, quintic_position, quintic_velocity
from bsk_torch.constants import MU_EARTH
from bsk_torch.vec3 import Mat3, Vec3

SPACING = 60.0
"""Seconds between the nodes of an arc."""

SPAN = 3600.0
"""Seconds solved at once."""

PER_SPAN = round(SPAN / SPACING)

PLAN_STEP = 30.0
"""Step, s, of bsk_rl's look-ahead propagation."""

ORDER = 56
ITERATIONS = (15, 8, 6, 5)
"""Picard iterations in the zonal field: before the full field is first evaluated, and after each of its evaluations."""

PLAN_ITERATIONS = 14

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


def _stretched(r: Vec3, stretch: float) -> Vec3:
    return Vec3(r.x * (1.0 + stretch), r.y * (1.0 + stretch), r.z)


def zonal_field(r: Vec3, stretch: float = 0.0) -> Vec3:
    """Acceleration by the point mass and J2 in pole axes."""
    return _stretched(field(_stretched(r, stretch), ZONAL), stretch)


class Surroundings(NamedTuple):
    """What surrounds a satellite during a span, in the pole axes of its middle.

    Sun at the middle; meridian angles, seconds from the middle and the pole's small motion since then at the nodes.
    """

    r_sun: Vec3
    v_sun: Vec3
    cos: Tensor
    sin: Tensor
    from_middle: Tensor
    tilt: Vec3


def surroundings(et: Tensor, pole: Mat3, from_middle: Tensor) -> Surroundings:
    """Surroundings at ``from_middle`` [M, n] seconds from the ET ``et`` [n] to which ``pole`` belongs."""
    alpha_rate, delta_rate = POLE_RIGHT_ASCENSION_RATE, POLE_DECLINATION_RATE
    rate = Vec3(torch.full_like(et, -delta_rate), pole.y.z * alpha_rate, pole.z.z * alpha_rate)
    tilt = Vec3(*(x * from_middle for x in rate))
    angle = earth_angles(et)[2] + EARTH_ROTATION_RATE * from_middle
    sun = [pole @ Vec3.of(part) for part in sun_state(et)]
    return Surroundings(sun[0], sun[1], torch.cos(angle), torch.sin(angle), from_middle, tilt)


def full_field(r: Vec3, around: Surroundings, stretch: float) -> Vec3:
    """Acceleration by the Earth's full field and the Sun in pole axes."""
    p = rotate_z(r - around.tilt.cross(r), around.cos, around.sin)
    f = rotate_z(_stretched(field(_stretched(p, stretch), FULL), stretch), around.cos, -around.sin)
    return f + around.tilt.cross(f) + third_body(r, around.r_sun + around.v_sun * around.from_middle)


def _zonal_flow(r: Vec3, v: Vec3, step: float, substeps: int) -> tuple[Vec3, Vec3]:
    def rates(stage: int, offset: float, y: State) -> State:
        return y[1], zonal_field(y[0])

    y: State = (r, v)
    for _ in range(substeps):
        y = rk4_step(rates, y, step / substeps)
    return y[0], y[1]


def step_defect(r: Vec3, v: Vec3) -> tuple[Vec3, Vec3]:
    """Error per second of one Runge-Kutta step of ``PLAN_STEP``, in position and velocity.

    Found by comparison with four substeps, whose own error is 1/256 of it.
    """
    coarse, fine = _zonal_flow(r, v, PLAN_STEP, 1), _zonal_flow(r, v, PLAN_STEP, 4)
    scale = (256.0 / 255.0) / PLAN_STEP
    return (coarse[0] - fine[0]) * scale, (coarse[1] - fine[1]) * scale


class Span(NamedTuple):
    """State at the start of a span: flown and planned position and velocity, [n] each, in pole axes."""

    r: Vec3
    v: Vec3
    planned_r: Vec3
    planned_v: Vec3


def _solve_flown(start: Span, around: Surroundings, stretch: float) -> tuple[Vec3, Vec3]:
    """Flown positions at the Chebyshev nodes, and what the zonal field lacks there."""
    q = quadrature(ORDER, None, str(start.r.x.device))
    time = (q.nodes * SPAN).unsqueeze(-1)
    motion = torch.sqrt(MU_EARTH / start.r.norm() ** 3)
    r = start.r * torch.cos(motion * time) + start.v * (torch.sin(motion * time) / motion)
    rest = Vec3.zeros_like(r.x)
    for k, iterations in enumerate(ITERATIONS):
        if k:
            rest = full_field(r, around, stretch) - zonal_field(r, stretch)
        for _ in range(iterations):
            r = picard_path(q, start.r, start.v, zonal_field(r, stretch) + rest, SPAN)
    return r, rest


def _solve_planned(start: Span, r: Vec3, v: Vec3, rest: Vec3) -> tuple[Vec3, Vec3]:
    """Acceleration and extra velocity of the planned arc at the Chebyshev nodes."""
    q = quadrature(ORDER, None, str(r.x.device))
    extra_v, extra_a = step_defect(r, v)
    drift = Vec3(*(SPAN * (q.velocity @ e) for e in extra_v))
    planned = r
    for _ in range(PLAN_ITERATIONS):
        acceleration = zonal_field(planned, frame_stretch(PLAN_STEP)) + rest + extra_a
        planned = picard_path(q, start.planned_r, start.planned_v, acceleration, SPAN) + drift
    return zonal_field(planned, frame_stretch(PLAN_STEP)) + rest + extra_a, extra_v


def _at_nodes(r: Vec3, v: Vec3, a: Vec3, extra_v: Vec3 | None = None) -> Node:
    """Node values, a minute apart, from the accelerations at Chebyshev nodes."""
    outputs = tuple((k + 1) / PER_SPAN for k in range(PER_SPAN))
    q = quadrature(ORDER, outputs, str(a.x.device))
    position = picard_path(q, r, v, a, SPAN)
    if extra_v is not None:
        position = position + Vec3(*(SPAN * (q.velocity @ e) for e in extra_v))
    return Node(position, picard_velocity(q, v, a, SPAN), Vec3(*(q.value @ x for x in a)))


def _pack(node: Node, pole: Mat3) -> Tensor:
    """Nodes [K, n] in pole axes as one tensor [n, K, 9] in N."""
    return torch.cat([(pole.mT @ vector).stack() for vector in node], -1).transpose(0, 1)


def solve_span(et: Tensor, flown: Tensor, planned: Tensor, step: float) -> tuple[Tensor, Tensor]:
    """Nodes of the flown and the planned arc over the next hour.

    Args:
        et: ET at the start, [n].
        flown: Node at the start, [n, 9]: position, velocity, acceleration in N.
        planned: The same of the planned arc.
        step: Step, s, of the simulation.

    Returns:
        The next nodes of both arcs, [n, 60, 9].
    """
    count, rows = len(et), padded(len(et), et.device)
    nodes = _solve_rows(et[rows], flown[rows], planned[rows], step)
    return nodes[0][:count], nodes[1][:count]


def _solve_rows(et: Tensor, flown: Tensor, planned: Tensor, step: float) -> tuple[Tensor, Tensor]:
    pole = pole_matrix(et + SPAN / 2)
    vectors = [pole @ Vec3.of(node[:, k : k + 3]) for node in (flown, planned) for k in (0, 3)]
    start = Span(*vectors)
    q = quadrature(ORDER, None, str(et.device))
    around = surroundings(et + SPAN / 2, pole, ((q.nodes - 0.5) * SPAN).unsqueeze(-1))
    stretch = frame_stretch(step)
    r, rest = _solve_flown(start, around, stretch)
    a = zonal_field(r, stretch) + rest
    planned_a, extra_v = _solve_planned(start, r, picard_velocity(q, start.v, a, SPAN), rest)
    return (
        _pack(_at_nodes(start.r, start.v, a), pole),
        _pack(_at_nodes(start.planned_r, start.planned_v, planned_a, extra_v), pole),
    )


def padded(count: int, device: torch.device) -> Tensor:
    """Indices of ``count`` rows, the last repeated up to a multiple of :data:`BLOCK`.

    Matrix products round differently at the edge of a block, and no satellite's orbit may depend on how many others there are.
    """
    return torch.arange(-(-count // BLOCK) * BLOCK, device=device).clamp(max=count - 1)


def first_node(et: Tensor, r: Tensor, v: Tensor) -> Tensor:
    """Node [n, 9] at the epoch, from position and velocity [n, 3] in N."""
    pole = pole_matrix(et)
    a = pole.mT @ full_field(pole @ Vec3.of(r), surroundings(et, pole, torch.zeros_like(et)), 0.0)
    return torch.cat([r, v, a.stack()], -1)


class Arcs:
    """Flown and planned arcs of N satellites: ``spans`` hours of nodes for each, starting at its own time.

    ``flown`` and ``planned`` are [N, Q, 9]; ``start`` [N] is the time, s, of the first node.
    """

    def __init__(self, n: int, spans: int, step: float, device: torch.device) -> None:
        """Make room for ``n`` satellites; ``step`` is the simulation's."""
        self.step, self.device = step, device
        shape = (n, spans * PER_SPAN + 1, 9)
        self.flown = torch.zeros(shape, dtype=torch.float64, device=device)
        self.planned = torch.zeros_like(self.flown)
        self.start = torch.zeros(n, dtype=torch.float64, device=device)
        self.et = torch.zeros_like(self.start)

    @property
    def length(self) -> float:
        """Seconds that every arc covers."""
        return (self.flown.shape[1] - 1) * SPACING

    @property
    def end(self) -> Tensor:
        """Time of the last node, [N]."""
        return self.start + self.length

    def reset(self, rows: Tensor, et: Tensor, r: Tensor, v: Tensor) -> None:
        """Solve the arcs of ``rows`` [n] anew from ET [n] and position and velocity [n, 3] at time zero."""
        self.start[rows], self.et[rows] = 0.0, et
        node = first_node(et, r, v)
        parts = [[node.unsqueeze(1)], [node.unsqueeze(1)]]
        for k in range(round(self.length / SPAN)):
            for part, new in zip(parts, solve_span(et + k * SPAN, *(p[-1][:, -1] for p in parts), self.step), strict=True):
                part.append(new)
        self.flown[rows], self.planned[rows] = (torch.cat(part, 1) for part in parts)

    def extend(self, rows: Tensor, spans: int) -> None:
        """Move the arcs of ``rows`` on by ``spans`` hours, dropping as many at their beginning."""
        for _ in range(spans):
            arcs = self.flown[rows], self.planned[rows]
            new = solve_span(self.et[rows] + self.end[rows], arcs[0][:, -1], arcs[1][:, -1], self.step)
            self.flown[rows], self.planned[rows] = (
                torch.cat([arc[:, PER_SPAN:], nodes], 1) for arc, nodes in zip(arcs, new, strict=True)
            )
            self.start[rows] += SPAN

    def grow(self) -> None:
        """Make every arc an hour longer."""
        new = solve_span(self.et + self.end, self.flown[:, -1], self.planned[:, -1], self.step)
        self.flown, self.planned = (
            torch.cat([arc, nodes], 1) for arc, nodes in zip((self.flown, self.planned), new, strict=True)
        )

    def nodes(self, rows: Tensor, time: Tensor, count: int) -> tuple[Tensor, Tensor]:
        """``count`` consecutive flown nodes [n, count, 9] around time [n] of ``rows``, and the time of the first, [n]."""
        index = torch.floor((time - self.start[rows]) / SPACING).long()
        index = index.clamp(0, self.flown.shape[1] - count)
        steps = torch.arange(count, device=self.device)
        return self.flown[rows.unsqueeze(-1), index.unsqueeze(-1) + steps], self.start[rows] + index * SPACING

    def planned_position(self, rows: Tensor, time: Tensor) -> Vec3:
        """Planned position in N at time [m] of ``rows`` [m]."""
        index = torch.floor((time - self.start[rows]) / SPACING).long().clamp(0, self.planned.shape[1] - 2)
        first, second = (as_node(self.planned[rows, index + k]) for k in (0, 1))
        return quintic_position((time - self.start[rows]) / SPACING - index, SPACING, first, second)


def as_node(values: Tensor) -> Node:
    """Node of values [..., 9]."""
    return Node(*(Vec3.of(values[..., k : k + 3]) for k in (0, 3, 6)))


def position_on_arc(nodes: tuple[Tensor, ...], first: Tensor, tau: Tensor) -> tuple[Vec3, Vec3]:
    """Position and velocity at tau from three nodes (27 planes) the first of which lies at ``first`` (same clock, s)."""
    s = (tau - first) * (1.0 / SPACING)
    later = s >= 1.0
    planes = [torch.where(later, b, a) for a, b in zip(nodes[:18], nodes[9:], strict=True)]
    s = torch.where(later, s - 1.0, s)
    start, end = (Node(*(Vec3(*planes[k + i : k + i + 3]) for i in (0, 3, 6))) for k in (0, 9))
    return quintic_position(s, SPACING, start, end), quintic_velocity(s, SPACING, start, end)


def spans_for(seconds: float) -> int:
    """Hours of arc that cover ``seconds``."""
    return max(1, math.ceil(seconds / SPAN))
