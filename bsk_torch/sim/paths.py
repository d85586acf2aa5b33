"""Kernels that compute arcs, each satellite by itself.

The flown arc is integrated by a multistep method with an evaluation of the Earth's field every 30 s. The planned arc differs
from it by metres: their difference is integrated with the error of bsk_rl's Runge-Kutta steps as its forcing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import torch
from torch import Tensor

from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.gravity import DEGREE, field, field_weights, third_body
from bsk_torch.astro.integrate import State, rk4_step
from bsk_torch.astro.interpolate import BEFORE, COUNT, coefficients, position, velocity
from bsk_torch.astro.multistep import position_weights, velocity_weights
from bsk_torch.constants import MU_EARTH
from bsk_torch.lanes.expr import ALWAYS, DOUBLE, TICK, Program
from bsk_torch.lanes.loop import Loop
from bsk_torch.sim.component import Bus, Track, vec
from bsk_torch.sim.sky import SKY, fixed, sky_at
from bsk_torch.sim.span import LEAD, PLAN_STEP, SPACING, frame_growth, step_defect, stretched, zonal_field
from bsk_torch.vec3 import Vec3, select

STEP = SPACING / 2.0
"""Step, s, of the multistep method: two for each node that is kept."""

ORDER = 12
"""Accelerations that the multistep method remembers."""

SWEEPS = 8
"""Iterations over the first nodes; each wins two digits."""

PLANNED_STEP = 2.0 * SPACING
"""Step, s, of the difference between the arcs: of metres, it needs four digits."""

ARC = Track("arc", SPACING, (vec("r", "m", exact=True),), COUNT, BEFORE)
"""Nodes of an arc, as ticks and searches see it."""

FINE = Track("fine", PLAN_STEP, (vec("r", "m", exact=True),), count=1)
"""Samples of the planned arc."""

FULL = field_weights(DEGREE)


class Sketch:
    """A program in the making: inputs by the dozen."""

    def __init__(self) -> None:
        """Start an empty program."""
        self.program = Program()

    def planes(self, source: str, count: int, first: int = 0) -> list[Any]:
        """Inputs ``first`` to ``first + count`` of a source."""
        lasts = ALWAYS if source in ("own", "shared") else TICK
        return [self.program.input((source, first + k), DOUBLE, lasts) for k in range(count)]

    def vectors(self, source: str, count: int, first: int = 0) -> list[Vec3]:
        """``count`` vectors from plane ``first`` on."""
        planes = self.planes(source, 3 * count, first)
        return [Vec3(*planes[3 * k : 3 * k + 3]) for k in range(count)]

    def records(self, t: int, count: int) -> list[Any]:
        """Planes of a track's records."""
        return [self.program.input(("track", t, k), DOUBLE, t) for k in range(count)]

    def tau(self, t: int) -> Any:
        """Seconds since a track's record."""
        return self.program.input(("tau", t), DOUBLE, TICK)

    def sky(self) -> Bus:
        """Sun and Earth at the time of the tick, from track 1."""
        return sky_at(self.records(1, SKY.count * SKY.width), self.tau(1))

    def path(self, t: int) -> tuple[list[Vec3], Any]:
        """Coefficients of the arc around the time of the tick from track t, and steps since its middle node."""
        planes: list[Any] = self.records(t, 3 * COUNT)
        nodes = [Vec3(*planes[3 * k : 3 * k + 3]) for k in range(COUNT)]
        return coefficients(nodes), self.tau(t) * (1.0 / SPACING)


def weighted(weights: list[Any], vectors: list[Vec3]) -> Vec3:
    """Weighted sum, smallest (oldest) terms first."""
    total = vectors[0] * weights[0]
    for w, v in zip(weights[1:], vectors[1:], strict=True):
        total = total + v * w
    return total


def pull(sky: Bus, r: Vec3, stretch: Any) -> Vec3:
    """Acceleration in N by the Earth's full field and the Sun; ``stretch`` as in :func:`bsk_torch.sim.span.frame_stretch`."""
    p = fixed(sky, r)
    f = rotate_z(stretched(field(stretched(p, stretch), FULL), stretch), sky.cos_earth, -sky.sin_earth)
    return sky.pole.mT @ f + third_body(r, sky.r_sun)


# -- the flown arc -----------------------------------------------------------------------------------------------------------

FIRST = (*range(-2 * LEAD, 0), *range(1, ORDER - 2 * LEAD + 1))
"""Steps from the epoch at which the start finds accelerations."""

START_STATE = 6 + 3 + 6 * ORDER + 6
"""Planes: r and v at the epoch, acceleration there, those of the last and of this sweep, r and v of the node last visited."""

FLOWN_STATE = 6 + 3 * ORDER
"""Planes: r and v at the last node, and the last accelerations, oldest first."""

SCHEDULED = 3 + 2 * (ORDER + 1)
"""Numbers that each tick of the start needs."""


def start_schedule() -> Tensor:
    """Rows of the start's ticks: time, whether it is the first, whether it ends a sweep, weights in r, then in v.

    Weights are those of the accelerations. The first tick visits the epoch, the following ones those of :data:`FIRST`, again
    and again.
    """
    nodes = [0, *FIRST]
    rows = [[0.0, 1.0, 0.0, *[0.0] * (2 * (ORDER + 1))]]
    for node in FIRST * SWEEPS:
        r, v = _scaled(position_weights(nodes, 0, node), STEP**2), _scaled(velocity_weights(nodes, 0, node), STEP)
        rows.append([node * STEP, 0.0, float(node == FIRST[-1]), *r, *v])
    return torch.tensor(rows, dtype=torch.float64)


@cache
def start_kernel() -> Loop:
    """Positions and accelerations at the first nodes, by Picard iteration over them; shared is the stretch."""
    sketch = Sketch()
    r0, v0, a0, *accelerations, _, _ = sketch.vectors("state", 3 + 2 * ORDER + 2)
    last, this = accelerations[:ORDER], accelerations[ORDER:]
    time, is_first, is_last, *weights = sketch.planes("schedule", SCHEDULED)
    first, ends = is_first > 0.5, is_last > 0.5
    (stretch,) = sketch.planes("shared", 1)
    r = r0 + v0 * time + weighted(weights[: ORDER + 1], [a0, *last])
    v = v0 + weighted(weights[ORDER + 1 :], [a0, *last])
    a = pull(sketch.sky(), r, stretch)
    this = [*this[1:], a]
    last = [select(first, a, select(ends, new, old)) for new, old in zip(this, last, strict=True)]
    return _loop(
        "start of the arcs", sketch, [r0, v0, select(first, a, a0), *last, *this, r, v], (SKY,), [r], "schedule", SCHEDULED
    )


@cache
def flown_kernel() -> Loop:
    """Positions on the flown arc, one each tick of :data:`STEP`: predict, evaluate, correct.

    The acceleration is moved from the predicted to the corrected position by the gradient of the central field; without that,
    long steps are unstable.
    """
    sketch = Sketch()
    r, v, *accelerations = sketch.vectors("state", 2 + ORDER)
    (stretch,) = sketch.planes("shared", 1)
    before, after = list(range(1 - ORDER, 1)), list(range(2 - ORDER, 2))
    corrector = _scaled(position_weights(after, 0, 1), STEP**2)
    straight = r + v * STEP
    predicted = straight + weighted(_scaled(position_weights(before, 0, 1), STEP**2), accelerations)
    a, remembered = pull(sketch.sky(), predicted, stretch), accelerations[1:]
    r = straight + weighted(corrector, [*remembered, a])
    change = central_gradient(predicted, r - predicted)
    r, remembered = r + change * corrector[-1], [*remembered, a + change]
    v = v + weighted(_scaled(velocity_weights(after, 0, 1), STEP), remembered)
    return _loop("flown arc", sketch, [r, v, *remembered], (SKY,), [r])


def central_gradient(r: Vec3, d: Vec3) -> Vec3:
    """Change of the point mass's acceleration from r to r + d, to first order in d."""
    inverse2 = 1.0 / r.dot(r)
    return (r * (3.0 * inverse2 * r.dot(d)) - d) * (MU_EARTH * inverse2 * torch.sqrt(inverse2))


def _scaled(weights: list[float], factor: float) -> list[float]:
    return [w * factor for w in weights]


# -- the planned arc ---------------------------------------------------------------------------------------------------------

PLANNED_STATE = 12
"""Planes: position and velocity relative to the flown arc, and the error rates of both at the last node."""


@cache
def planned_kernel() -> Loop:
    """Samples of the planned arc every 30 s; shared are the stretches of flown and planned arc."""
    sketch = Sketch()
    dr, dv, defect_r, defect_v = sketch.vectors("state", 4)
    flown_stretch, plan_stretch = sketch.planes("shared", 2)
    sky = sketch.sky()
    path, s = sketch.path(2)
    nodes = [
        (position(path, s - k), velocity(path, s - k, SPACING))
        for k in (PLANNED_STEP / SPACING, 0.5 * PLANNED_STEP / SPACING, 0.0)
    ]
    r = [sky.pole @ node[0] for node in nodes]
    v = [sky.pole @ node[1] for node in nodes]
    defects = [(sky.pole @ defect_r, sky.pole @ defect_v)]
    defects += [step_defect(r[k], v[k], plan_stretch, frame_growth()) for k in (1, 2)]
    pulls = [zonal_field(x, flown_stretch) for x in r]

    def rates(stage: int, offset: Any, y: State) -> State:
        k = (0, 1, 1, 2)[stage]
        return y[1] + defects[k][0], zonal_field(r[k] + y[0], plan_stretch) - pulls[k] + defects[k][1]

    start: State = (sky.pole @ dr, sky.pole @ dv)
    end = rk4_step(rates, start, PLANNED_STEP)
    slopes = rates(0, 0.0, start)[0], rates(3, 0.0, end)[0]
    back = sky.pole.mT
    outputs = [back @ x for x in (*end, *defects[2])]
    samples = round(PLANNED_STEP / PLAN_STEP)
    between = [_hermite(k / samples, (start[0], end[0]), slopes) for k in range(1, samples)]
    flown = [position(path, s - (samples - k) * (PLAN_STEP / SPACING)) for k in range(1, samples)]
    written = [*(x + back @ d for x, d in zip(flown, between, strict=True)), nodes[2][0] + outputs[0]]
    return _loop("planned arc", sketch, outputs, (SKY, ARC), written)


def _hermite(share: float, ends: tuple[Vec3, Vec3], slopes: tuple[Vec3, Vec3]) -> Vec3:
    """The cubic through both ends of a step with these slopes, at a share of it."""
    left = 1.0 - share
    values = ends[0] * ((1.0 + 2.0 * share) * left * left) + ends[1] * (share * share * (3.0 - 2.0 * share))
    return values + (slopes[0] * (share * left * left) - slopes[1] * (share * share * left)) * PLANNED_STEP


@cache
def defect_kernel() -> Loop:
    """Error rates at the node where the planned arc starts, into the state of :func:`planned_kernel`."""
    sketch = Sketch()
    dr, dv, _, _ = sketch.vectors("state", 4)
    _, plan_stretch = sketch.planes("shared", 2)
    sky = sketch.sky()
    path, s = sketch.path(2)
    r, v = sky.pole @ position(path, s), sky.pole @ velocity(path, s, SPACING)
    rates = step_defect(r, v, plan_stretch, frame_growth())
    return _loop("planned arc's start", sketch, [dr, dv, *(sky.pole.mT @ x for x in rates)], (SKY, ARC))


def _loop(
    name: str,
    sketch: Sketch,
    outputs: list[Vec3],
    tracks: tuple[Track, ...],
    written: list[Vec3] | None = None,
    clock: str = "ticks",
    schedule: int = 0,
) -> Loop:
    flat: Callable[[list[Vec3]], list[Any]] = lambda vectors: [x for v in vectors for x in v]  # noqa: E731
    return Loop(name, sketch.program, flat(outputs), tracks, flat(written or []), clock, schedule)
