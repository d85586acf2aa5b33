"""Error of BSK-RL's look-ahead propagation, as a forcing of the equations of motion.

The look-ahead is a Runge-Kutta propagation in steps of 30 s. Its truncation error, meters per orbit, moves windows by
milliseconds, so it is reproduced: the error of one step, divided by the length of the step, is a rate of position and velocity,
and the planned arc solves ``r' = v + e_r, v' = a(r, t) + e_v``.
"""

from __future__ import annotations

from torch import Tensor

from bsk_torch.astro.integrate import State, rk4_step
from bsk_torch.sim.orbit.equations import zonal_field
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.vec3 import Vec3


def step_defect(r: Vec3, v: Vec3, stretch: float | Tensor, growth: float | Tensor) -> tuple[Vec3, Vec3]:
    """Return the error per second, m/s and m/s^2, of the step of ``PLAN_STEP`` that ends at r, m, and v, m/s, in axes E.

    Let y0 be the state from which the exact solution arrives at (r, v), found by a step backwards. Then::

        e = (256 / 255) (y_1 - y_4) / PLAN_STEP

    with the results y_1 of one step and y_4 of four steps of a quarter from y0: the error of a fourth-order method's step is of
    the fifth order, so four quarter steps have 4 / 4^5 = 1/256 of it (Richardson extrapolation; Hairer, Norsett and Wanner,
    "Solving Ordinary Differential Equations I", section II.4).

    The single step's stages take the Earth's orientation of its beginning, so their stretch is ``growth * dt^2``; the exact
    solution has ``stretch``, the mean of it; see :func:`bsk_torch.sim.orbit.equations.frame_stretch`.
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
