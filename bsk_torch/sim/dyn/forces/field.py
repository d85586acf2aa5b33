"""The Earth's field as one operator, so that compiled ticks call it instead of holding four copies of it.

Fused into a tick, the four evaluations of a Runge-Kutta step are more than C++ compilers digest.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.astro.gravity import field, field_weights
from bsk_torch.codegen.inductor import just_in_time
from bsk_torch.vec3 import Vec3


def full_field(r: Vec3, degree: int) -> Vec3:
    """Return the acceleration, m/s^2, by the Earth's field of a degree and order at the Earth-fixed position r, m, both in P."""
    return field(r, field_weights(degree))


@functools.cache
def _kernel(device: str, dtype: torch.dtype, degree: int) -> Callable[..., Tensor]:
    def on_packs(r: Tensor) -> Tensor:
        return torch.stack(list(full_field(Vec3(*r.unbind(0)), degree)))

    return just_in_time(on_packs, "Earth's field")


def prepare(device: torch.device, dtype: torch.dtype, degree: int) -> None:
    """Build the kernel that the operator calls, which cannot be built inside a compiled tick."""
    _kernel(device.type, dtype, degree)(torch.full((3, 2), 7e6, device=device, dtype=dtype))


@torch.library.custom_op("bsk_torch::earth_field", mutates_args=())
def _operator(r: Tensor, degree: int) -> Tensor:
    return _kernel(r.device.type, r.dtype, degree)(r)


@_operator.register_fake
def _(r: Tensor, degree: int) -> Tensor:
    return torch.empty_like(r)


def called_field(r: Vec3, degree: int) -> Vec3:
    """Return the same as :func:`full_field`, by an operator that is opaque to the compiler of the tick around it."""
    return Vec3(*_operator(torch.stack(list(r)), degree).unbind(0))
