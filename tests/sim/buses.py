"""Buses for tests of single components."""

from typing import Any

import torch

from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.effectors.wheels import WHEELS
from bsk_torch.sim.fsw.allocation import BODY_AXIS_WHEELS
from bsk_torch.vec3 import Vec3

N = 40


def vectors(scale: float = 1.0, n: int = N) -> Vec3:
    """Random vectors."""
    return Vec3.of(scale * torch.randn(n, 3, dtype=torch.float64))


def plane(value: float, n: int = N) -> torch.Tensor:
    """The same number for all environments."""
    return torch.full((n,), value, dtype=torch.float64)


def write(bus: Bus, **values: Any) -> Bus:
    """The bus with more messages."""
    for name, value in values.items():
        setattr(bus, name, value)
    return bus


def with_wheels(bus: Bus) -> Bus:
    """The bus of a spacecraft with three wheels on its axes."""
    return write(bus, effectors=(WHEELS.effector,), allocation=BODY_AXIS_WHEELS.allocation)
