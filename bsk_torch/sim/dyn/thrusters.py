"""Eight attitude thrusters, Basilisk's thrusterDynamicEffector.

Basilisk's integrator feels a sixth of every full pulse and nothing of shorter ones: a command of time t is latched at t + h and
acts over (t + h, t + 2 h], but a pulse of at most h ends by t + h, so only the first of the four stages, whose time is t + h, can
find the thruster on, and its weight is 1/6.

The thrusters come in four pairs whose members have the same torque and opposite forces. Commands follow from torques alone,
so both members of a pair always fire alike and there is never a net force: the pair is the unit here.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.constants import NANO
from bsk_torch.sim.component import Bus, Component, Effector, Field
from bsk_torch.vec3 import Vec3

THRUST = 0.9
"""Thrust of one thruster, N (idealised Monarc-1)."""

_NEAR, _FAR, _HIGH, _SLANT = 0.03874945160902288, 1.206182747348013, 0.85245, math.sqrt(0.5)

POSITIONS = tuple((x, y, z) for x, y in ((_NEAR, -_FAR), (-_NEAR, -_FAR)) for z in (_HIGH, -_HIGH))
"""Positions, m, in B of one thruster of each pair; the other one sits at (-x, -y, -z)."""

DIRECTIONS = tuple((x, _SLANT, 0.0) for x in (-_SLANT, _SLANT) for _ in range(2))
"""Force directions in B of the same thrusters; those of the others are opposite."""


def _arm(position: tuple[float, ...], direction: tuple[float, ...]) -> tuple[float, float, float]:
    (x, y, z), (a, b, c) = position, direction
    return (y * c - z * b, z * a - x * c, x * b - y * a)


ARMS = tuple(_arm(p, d) for p, d in zip(POSITIONS, DIRECTIONS, strict=True))
"""Torque per newton, m, of one thruster of each pair."""


def pulse_torque(pulse: tuple[Tensor, ...]) -> Vec3:
    """Return the torque, N m in B, of the pairs that fire (``pulse`` is 1 or 0 for each): ``L = sum 2 F (r x d)``.

    F is the thrust, N, of each of the two thrusters of a pair, r and d are position, m, and force direction of one of them.
    """
    axes = zip(*ARMS, strict=True)
    terms = ([on * (2.0 * THRUST * arm) for on, arm in zip(pulse, axis, strict=True)] for axis in axes)
    return Vec3(*(a + b + c + d for a, b, c, d in terms))


def latch_pulses(bus: Bus) -> None:
    """Latch the commands of the last tick: a message is consumed once.

    Basilisk compares a pulse's end ``t_write + h`` with the time of the next Runge-Kutta stage, both rounded to doubles of
    seconds; the pulse is missed where rounding puts the end first, ``fl(fl(t_write) + h) < fl(t_write + h)``. For ticks of one
    second that happens at the write times 14, 28, 57, 114, 228 s, ...
    """
    stage = bus.ticks * bus.h_ns * NANO
    # abs keeps compilers from fusing the product into the sum, which would round once instead of twice
    written = torch.abs((bus.ticks - 1.0) * bus.h_ns * NANO)
    reaches = written + bus.h_ns * NANO >= stage
    bus.pulse = tuple(torch.where(reaches, command, torch.zeros_like(command)) for command in bus.pulse_command)
    bus.pulse_command = tuple(torch.zeros_like(command) for command in bus.pulse_command)


THRUSTERS = Component(
    slot="thrusters",
    update=latch_pulses,
    state=(
        Field("pulse", 4, "-", "pairs that fire in the first stage of the next tick"),
        Field("pulse_command", 4, "-", "full pulses commanded by the flight software in this tick"),
    ),
    initial=lambda args: {name: torch.zeros(1, 4, dtype=torch.float64) for name in ("pulse", "pulse_command")},
    effector=Effector(torque=lambda bus, stage: pulse_torque(bus.pulse) if stage == 0 else None),
)
