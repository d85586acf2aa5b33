"""Allocation: the torque on the body that a control law asks for, distributed among actuators.

A component with an :class:`~bsk_torch.sim.component.Allocation` knows the actuators, control laws only the torque, as in
Basilisk's rwMotorTorque.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from bsk_torch.sim.component import Allocation, Bus, Component
from bsk_torch.vec3 import Vec3, select

Commands = tuple[Any, ...]
"""Commands to actuators: vectors, planes, or tuples of planes, one for each field that holds them."""


def held_commands(bus: Bus) -> Commands:
    """Return the current commands to the actuators: those of the last tick, until a law writes others."""
    return tuple(getattr(bus, name) for name in bus.allocation.commands)


def commands_for(bus: Bus, torque_B: Vec3) -> Commands:
    """Return the commands to the actuators that together exert a torque on the body, N m in B."""
    return bus.allocation.distribute(bus, torque_B)


def write_commands(bus: Bus, commands: Commands, where: Tensor | None = None) -> None:
    """Write commands to the actuators where the mask holds, everywhere if None; elsewhere the last ones stay."""
    for name, new in zip(bus.allocation.commands, commands, strict=True):
        setattr(bus, name, new if where is None else _chosen(where, new, getattr(bus, name)))


def _chosen(where: Tensor, new: Any, old: Any) -> Any:
    if isinstance(new, Vec3):
        return select(where, new, old)
    if isinstance(new, tuple):
        return tuple(torch.where(where, a, b) for a, b in zip(new, old, strict=True))
    return torch.where(where, new, old)


BODY_AXIS_WHEELS = Component(
    slot="allocation",
    after="control",
    allocation=Allocation(("motor_torque_command_B",), lambda bus, torque_B: (-torque_B,)),
)
"""Three wheels on the axes of B: the motor torques are the opposite of the torque on the body."""
