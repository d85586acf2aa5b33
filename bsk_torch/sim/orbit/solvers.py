"""Choice between two ways to the same arcs: kernels that integrate each satellite, and Picard iteration on tensors."""

from __future__ import annotations

import torch

from bsk_torch.astro.earth_rotation import IAU_EARTH, Earth
from bsk_torch.astro.gravity import DEGREE
from bsk_torch.sim.orbit.kernel_solver import KernelSolver
from bsk_torch.sim.orbit.picard import PicardSolver
from bsk_torch.sim.orbit.solution import Solver


def make_solver(step: float, backend: str, device: torch.device, degree: int = DEGREE, earth: Earth = IAU_EARTH) -> Solver:
    """Return the solver for a simulation with ticks of ``step`` seconds, in the Earth's field of a degree and order.

    ``earth`` is the model of the Earth's rotation.
    """
    if backend == "compiled" and device.type == "cpu":
        return KernelSolver(step, degree, earth)
    return PicardSolver(step, backend, device, degree, earth)
