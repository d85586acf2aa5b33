"""Initial attitudes and spins under the names of ``bsk_torch.bsk_rl.utils.attitude``; what is random is a distribution.

``sat_args=dict(sigma_init=random_tumble()[0], omega_init=random_tumble()[1])`` draws values for each environment and episode, and
so does the same in a function without arguments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.astro.relative import Numeric, aligned_with_hill, like
from bsk_torch.rand import Distribution, Key, Uniform
from bsk_torch.sim.names import nearest

__all__ = ["hill_frame_attitude", "random_tumble"]

AXES = {"radial": (1.0, 0.0, 0.0), "tangential": (0.0, 1.0, 0.0), "normal": (0.0, 0.0, 1.0)}
"""Named axes of a spin, in the Hill frame; ``"velocity"`` and ``"random"`` are further ones."""

SPIN: dict[str, Any] = {"type": "fixed", "rate": 0.0, "axis": "radial"}
"""Spin of :func:`hill_frame_attitude` unless it is given."""

SHORTEST_AXIS = 1e-8
"""Length below which an axis counts as zero."""


def random_tumble(maxSpinRate: float = 0.001) -> tuple[Uniform, Uniform]:
    """Return distributions of sigma_BN, three MRPs in [0, 1), and omega_BN_B, rad/s, uniform within ``maxSpinRate``."""
    rate = number("maxSpinRate", maxSpinRate, 0.0, 1e3, unit="rad/s")
    return Uniform(0.0, 1.0, 3), Uniform(-rate, rate, 3)


@dataclass(frozen=True)
class HillSpin(Distribution):
    """Body rate omega_BN_B, rad/s, of a body aligned with the Hill frame that spins relative to it.

    Attributes:
        hill_rate: Rate of the Hill frame in its own axes, rad/s.
        low: Smallest spin, rad/s.
        high: Largest spin, rad/s.
        axis: Unit vector of the spin in the Hill frame; None for a random direction.
    """

    hill_rate: tuple[float, ...]
    low: float
    high: float
    axis: tuple[float, ...] | None

    @override
    def draw(self, key: Key) -> Tensor:
        rate = self.low + (self.high - self.low) * key.uniform(1)
        if self.axis is None:
            axis = key.named(f"{key.name} axis").normal(3)
            axis = axis / torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
        else:
            axis = torch.tensor([self.axis], dtype=torch.float64)
        return torch.tensor(self.hill_rate, dtype=torch.float64) + rate * axis


def hill_frame_attitude(r_N: Numeric, v_N: Numeric, spin_config: Mapping[str, object] | None = None) -> tuple[Any, Any]:
    """Return attitude sigma_BN and rate omega_BN_B, rad/s, of a body aligned with the Hill frame and spins.

    Both are [..., 3], arrays or tensors as given. With a random rate or axis the rate is a distribution, and there is one orbit.

    Args:
        r_N: Position, m [..., 3].
        v_N: Velocity, m/s [..., 3].
        spin_config: ``type`` ``"fixed"`` with ``rate``, or ``"uniform"`` with ``low`` and ``high``, in degrees per second;
            ``axis`` ``"radial"``, ``"tangential"``, ``"normal"``, ``"velocity"``, ``"random"``, or a vector in the Hill frame.
            No spin by default.
    """
    spin = _checked(spin_config or {})
    sigma, hill_rate, HN = aligned_with_hill(r_N, v_N)
    if not bool(torch.isfinite(HN).all()):
        raise ValueError("r_N and v_N must span an orbit plane; they are zero or parallel")
    fixed = spin["type"] == "fixed"
    low, high = (math.radians(spin[name]) for name in (("rate", "rate") if fixed else ("low", "high")))
    axis = _axis(spin["axis"], HN, v_N)
    if fixed and axis is not None:
        return like(sigma, r_N, v_N), like(hill_rate + low * axis, r_N, v_N)
    if sigma.ndim > 1:
        raise ValueError(f"r_N has shape {list(sigma.shape)}; a random spin is drawn for each environment, around one orbit [3]")
    unit = None if axis is None else tuple(axis.tolist())
    return like(sigma, r_N, v_N), HillSpin(tuple(hill_rate.tolist()), low, high, unit)


def _checked(settings: Mapping[str, object]) -> dict[str, Any]:
    names = ("type", "rate", "low", "high", "axis")
    for name in settings:
        if name not in names:
            raise ValueError(f"spin_config[{name!r}] is unknown; {nearest(str(name), names)}")
    spin = SPIN | dict(settings)
    if spin["type"] not in ("fixed", "uniform"):
        raise ValueError(f"spin_config['type']={spin['type']!r} must be 'fixed' or 'uniform'")
    if spin["type"] == "uniform" and not ("low" in spin and "high" in spin and spin["low"] <= spin["high"]):
        raise ValueError(f"spin_config={dict(settings)} needs 'low' <= 'high', in degrees per second")
    return spin


def _axis(axis: object, HN: Tensor, v_N: Numeric) -> Tensor | None:
    """Return the unit vector of a spin axis in the Hill frame, [..., 3]; None for a random one."""
    if isinstance(axis, str):
        if axis == "random":
            return None
        if axis not in (*AXES, "velocity"):
            raise ValueError(f"spin_config['axis']={axis!r}; {nearest(axis, (*AXES, 'velocity', 'random'))}")
        axis = AXES.get(axis, (HN @ torch.as_tensor(np.asarray(v_N), dtype=torch.float64).unsqueeze(-1)).squeeze(-1))
    vector = torch.as_tensor(np.asarray(axis), dtype=torch.float64)
    length = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    if vector.shape[-1:] != (3,) or bool((length < SHORTEST_AXIS).any()):
        raise ValueError(f"spin_config['axis']={axis!r} must be three numbers that are not all zero")
    return vector / length
