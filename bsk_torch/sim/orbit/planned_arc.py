"""Kernels of the planned arc, for looking ahead, each satellite by itself.

It differs from the flown arc by meters: the difference is integrated with the error of Runge-Kutta steps of 30 s as its forcing.
"""

from __future__ import annotations

from bsk_torch.astro.integrate import State, rk4_step
from bsk_torch.astro.interpolate import position, velocity
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.stored import stored_kernel
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK
from bsk_torch.sim.orbit.builder import ARC, KernelBuilder
from bsk_torch.sim.orbit.equations import FRAME_GROWTH, step_defect, zonal_field
from bsk_torch.sim.orbit.grid import NODE_SPACING, PLAN_STEP
from bsk_torch.vec3 import Vec3

DIFFERENCE_STEP = 2.0 * NODE_SPACING  # step, s, of the difference between the arcs: of meters, it needs four digits
PLANNED_STATE = 12  # planes: position and velocity relative to the flown arc, and the error rates of both at the last node


@stored_kernel
def planned_kernel() -> Kernel:
    """Return the kernel that finds samples of the planned arc every 30 s; shared are the stretches of flown and planned arc.

    With the flown arc r, the difference d of position and e of velocity follow ``d' = e + e_r`` and
    ``e' = a_z(r + d) - a_z(r) + e_v``, where a_z is the zonal field, each with the stretch of its arc, and e_r and e_v are the
    errors per second of a step (:func:`bsk_torch.sim.orbit.equations.step_defect`). Steps are of the Runge-Kutta kind, in
    the axes E of the end of each; samples within are on the cubic through both ends.
    """
    builder = KernelBuilder()
    dr, dv, defect_r, defect_v = builder.vectors("state", 4)
    flown_stretch, plan_stretch = builder.planes("shared", 2)
    ephemeris = builder.ephemeris()
    path, s = builder.path(2)
    nodes = [
        (position(path, s - k), velocity(path, s - k, NODE_SPACING))
        for k in (DIFFERENCE_STEP / NODE_SPACING, 0.5 * DIFFERENCE_STEP / NODE_SPACING, 0.0)
    ]
    r = [ephemeris.EN @ node[0] for node in nodes]
    v = [ephemeris.EN @ node[1] for node in nodes]
    defects = [(ephemeris.EN @ defect_r, ephemeris.EN @ defect_v)]
    defects += [step_defect(r[k], v[k], plan_stretch, FRAME_GROWTH) for k in (1, 2)]
    pulls = [zonal_field(x, flown_stretch) for x in r]

    def rates(stage: int, offset: object, y: State) -> State:
        k = (0, 1, 1, 2)[stage]
        return y[1] + defects[k][0], zonal_field(r[k] + y[0], plan_stretch) - pulls[k] + defects[k][1]

    start: State = (ephemeris.EN @ dr, ephemeris.EN @ dv)
    end = rk4_step(rates, start, DIFFERENCE_STEP)
    slopes = rates(0, 0.0, start)[0], rates(3, 0.0, end)[0]
    back = ephemeris.EN.mT
    outputs = [back @ x for x in (*end, *defects[2])]
    samples = round(DIFFERENCE_STEP / PLAN_STEP)
    between = [_hermite(k / samples, (start[0], end[0]), slopes) for k in range(1, samples)]
    flown = [position(path, s - (samples - k) * (PLAN_STEP / NODE_SPACING)) for k in range(1, samples)]
    written = [*(x + back @ d for x, d in zip(flown, between, strict=True)), nodes[2][0] + outputs[0]]
    return builder.kernel("planned arc", outputs, (EPHEMERIS_TRACK, ARC), written)


def _hermite(share: float, ends: tuple[Vec3, Vec3], slopes: tuple[Vec3, Vec3]) -> Vec3:
    """Return the cubic (Hermite) through both ends of a step with these slopes, at a share of it."""
    rest = 1.0 - share
    values = ends[0] * ((1.0 + 2.0 * share) * rest * rest) + ends[1] * (share * share * (3.0 - 2.0 * share))
    return values + (slopes[0] * (share * rest * rest) - slopes[1] * (share * share * rest)) * DIFFERENCE_STEP


@stored_kernel
def defect_kernel() -> Kernel:
    """Return the kernel that starts the state of :func:`planned_kernel` with the error rates at the first node."""
    builder = KernelBuilder()
    dr, dv, _, _ = builder.vectors("state", 4)
    _, plan_stretch = builder.planes("shared", 2)
    ephemeris = builder.ephemeris()
    path, s = builder.path(2)
    r, v = ephemeris.EN @ position(path, s), ephemeris.EN @ velocity(path, s, NODE_SPACING)
    rates = step_defect(r, v, plan_stretch, FRAME_GROWTH)
    return builder.kernel("planned arc's start", [dr, dv, *(ephemeris.EN.mT @ x for x in rates)], (EPHEMERIS_TRACK, ARC))
