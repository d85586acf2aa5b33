"""Vectors of which only the direction counts, in arguments of satellites."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from bsk_torch.sim.component import Values

AXIS_BOUNDS = -1e9, 1e9
"""Bounds of their components."""


def unit_rows(vectors: Tensor) -> Tensor:
    """Return vectors [..., 3] scaled to length one."""
    return vectors / vectors.norm(dim=-1, keepdim=True)


def check_axis(name: str) -> Callable[[Values], None]:
    """Return a check that the vectors [..., 3] of the argument ``name`` have directions."""

    def check(args: Values) -> None:
        if bool((args[name].norm(dim=-1) <= 0.0).any()):
            raise ValueError(f"{name}=[0, 0, 0] has length zero; give three numbers in B, not all zero, such as [0, 0, 1]")

    return check
