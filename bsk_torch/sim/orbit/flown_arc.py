"""Kernels of the flown arc, each satellite by itself: a multistep method with an evaluation of the Earth's field every 30 s."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import torch
from torch import Tensor

from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.gravity import field, field_weights, third_body
from bsk_torch.astro.multistep import position_weights, velocity_weights
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.stored import stored_kernel
from bsk_torch.sim.component import Bus, Track, vec
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, fixed
from bsk_torch.sim.orbit.builder import KernelBuilder
from bsk_torch.sim.orbit.equations import central_gradient, stretched
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING
from bsk_torch.vec3 import Vec3, select

MULTISTEP_STEP = NODE_SPACING / 2.0  # step, s, of the multistep method: two for each stored node
MULTISTEP_ORDER = 12  # accelerations that the multistep method remembers
START_SWEEPS = 8  # iterations over the first nodes; each wins two digits


def weighted(weights: Sequence[Tensor | float], vectors: list[Vec3]) -> Vec3:
    """Return the weighted sum of vectors, smallest (oldest) terms first."""
    total = vectors[0] * weights[0]
    for w, v in zip(weights[1:], vectors[1:], strict=True):
        total = total + v * w
    return total


def acceleration(ephemeris: Bus, r: Vec3, stretch: Tensor, degree: int) -> Vec3:
    """Return the acceleration, m/s^2 in N, at r_BN_N, m, by the Earth's field of a degree and the Sun.

    ``a = [PN]^T S f(S [PN] r) + a_S(r, r_SN)`` with the stretch S of :mod:`bsk_torch.sim.orbit.equations`.
    """
    p = fixed(ephemeris, r)
    f = rotate_z(
        stretched(field(stretched(p, stretch), field_weights(degree)), stretch), ephemeris.cos_earth, -ephemeris.sin_earth
    )
    return ephemeris.EN.mT @ f + third_body(r, ephemeris.r_SN_N)


START_STEPS = (*range(-2 * LEAD_NODES, 0), *range(1, MULTISTEP_ORDER - 2 * LEAD_NODES + 1))
"""Steps from the epoch at which the start finds accelerations."""

START_STATE = 6 + 3 + 6 * MULTISTEP_ORDER + 6
"""Planes: r and v at the epoch, acceleration there, those of the last and of this sweep, r and v of the node last visited."""

FLOWN_STATE = 6 + 3 * MULTISTEP_ORDER  # planes: r and v at the last node, and the last accelerations, oldest first
SCHEDULED = 3 + 2 * (MULTISTEP_ORDER + 1)  # numbers that each tick of the start needs


@cache
def start_schedule() -> Tensor:
    """Return rows of the start's ticks: time, whether it is the first, whether it ends a sweep, weights in r, then in v.

    Weights are those of the accelerations. The first tick visits the epoch, the following ones visit :data:`START_STEPS`, again
    and again. All environments share the rows, which must not be written into.
    """
    nodes, sweep = [0, *START_STEPS], []
    for node in START_STEPS:
        r = _scaled(position_weights(nodes, 0, node), MULTISTEP_STEP**2)
        v = _scaled(velocity_weights(nodes, 0, node), MULTISTEP_STEP)
        sweep.append([node * MULTISTEP_STEP, 0.0, float(node == START_STEPS[-1]), *r, *v])
    first = [0.0, 1.0, 0.0, *[0.0] * (2 * (MULTISTEP_ORDER + 1))]
    return torch.tensor([first, *sweep * START_SWEEPS], dtype=torch.float64)


def visited(r0: Vec3, v0: Vec3, accelerations: list[Vec3], time: Tensor, weights: Sequence[Tensor]) -> tuple[Vec3, Vec3]:
    """Return position, m, and velocity, m/s, at a node of the start, ``time`` s from the epoch; see :func:`start_kernel`."""
    count = MULTISTEP_ORDER + 1
    return r0 + v0 * time + weighted(weights[:count], accelerations), v0 + weighted(weights[count:], accelerations)


@stored_kernel
def start_kernel(degree: int) -> Kernel:
    """Return the kernel that finds positions and accelerations at the first nodes, by Picard iteration; shared is the stretch.

    Each tick visits a node: ``r_k = r0 + v0 t_k + sum_j w_kj a_j``, with the weights of the schedule and the accelerations of the
    last sweep, and then evaluates its own acceleration. The accelerations of all nodes are replaced at the end of a sweep.
    """
    builder = KernelBuilder()
    r0, v0, a0, *accelerations, _, _ = builder.vectors("state", 3 + 2 * MULTISTEP_ORDER + 2)
    last, this = accelerations[:MULTISTEP_ORDER], accelerations[MULTISTEP_ORDER:]
    time, is_first, is_last, *weights = builder.planes("schedule", SCHEDULED)
    first, ends = is_first > 0.5, is_last > 0.5
    (stretch,) = builder.planes("shared", 1)
    r, v = visited(r0, v0, [a0, *last], time, weights)
    a = acceleration(builder.ephemeris(), r, stretch, degree)
    this = [*this[1:], a]
    last = [select(first, a, select(ends, new, old)) for new, old in zip(this, last, strict=True)]
    return builder.kernel(
        "start of the arcs",
        [r0, v0, select(first, a, a0), *last, *this, r, v],
        (EPHEMERIS_TRACK,),
        [r],
        "schedule",
        SCHEDULED,
    )


@stored_kernel
def flown_kernel(degree: int, writes: bool) -> Kernel:
    """Return the kernel that finds positions on the flown arc, one each tick of :data:`MULTISTEP_STEP`, and may write them.

    Predict, evaluate, correct, with q = MULTISTEP_ORDER remembered accelerations and the weights p, c and d of
    :mod:`bsk_torch.astro.multistep`, h the step::

        r* = r + h v + h^2 sum_j p_j a_j            the last q accelerations
        a* = a(r*, t + h)
        r+ = r + h v + h^2 (sum_j c_j a_j + c_q a*)  the last q - 1, and a*
        v+ = v + h (sum_j d_j a_j + d_q a)

    Then a is moved from r* to r+ by the gradient of the central field, ``a = a* + G(r*) (r+ - r*)``, and r+ with it; without
    that, long steps are unstable, and a second evaluation of the field would cost as much as the first.
    """
    builder = KernelBuilder()
    r, v, *accelerations = builder.vectors("state", 2 + MULTISTEP_ORDER)
    (stretch,) = builder.planes("shared", 1)
    r, v, remembered = flown_step(r, v, accelerations, builder.ephemeris, stretch, degree)
    return builder.kernel("flown arc" if writes else "flight", [r, v, *remembered], (EPHEMERIS_TRACK,), [r] if writes else [])


def flown_step(
    r: Vec3, v: Vec3, accelerations: list[Vec3], ephemeris: Callable[[], Bus], stretch: Tensor, degree: int
) -> tuple[Vec3, Vec3, list[Vec3]]:
    """Return position, m, velocity, m/s, and the remembered accelerations after a step; see :func:`flown_kernel`."""
    before, after = list(range(1 - MULTISTEP_ORDER, 1)), list(range(2 - MULTISTEP_ORDER, 2))
    corrector = _scaled(position_weights(after, 0, 1), MULTISTEP_STEP**2)
    straight = r + v * MULTISTEP_STEP
    predicted = straight + weighted(_scaled(position_weights(before, 0, 1), MULTISTEP_STEP**2), accelerations)
    a, remembered = acceleration(ephemeris(), predicted, stretch, degree), accelerations[1:]
    r = straight + weighted(corrector, [*remembered, a])
    change = central_gradient(predicted, r - predicted)
    r, remembered = r + change * corrector[-1], [*remembered, a + change]
    return r, v + weighted(_scaled(velocity_weights(after, 0, 1), MULTISTEP_STEP), remembered), remembered


NODE = Track("node", NODE_SPACING, (vec("r_BN_N", "m", exact=True),), count=1)  # nodes of an arc, one by one


@stored_kernel
def acceleration_kernel(degree: int) -> Kernel:
    """Return the kernel that writes the acceleration at a node in each tick; its state is the time, shared is the stretch."""
    builder = KernelBuilder()
    (time,) = builder.planes("state", 1)
    (stretch,) = builder.planes("shared", 1)
    a = acceleration(builder.ephemeris(), Vec3(*builder.records(2, 3)), stretch, degree)
    tracks = EPHEMERIS_TRACK, NODE
    return Kernel("accelerations", builder.loop([time + NODE_SPACING], list(a), tracks, time))


def _scaled(weights: list[float], factor: float) -> list[float]:
    return [w * factor for w in weights]
