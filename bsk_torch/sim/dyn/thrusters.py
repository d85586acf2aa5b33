"""Attitude thrusters in pairs, Basilisk's thrusterDynamicEffector; bsk_rl has eight.

Basilisk's integrator feels a sixth of every full pulse and nothing of shorter ones: a command of time t is latched at t + h and
acts over (t + h, t + 2 h], but a pulse of at most h ends by t + h, so only the first of the four stages, whose time is t + h, can
find the thruster on, and its weight is 1/6.

The members of a pair have the same torque and opposite forces. Commands follow from torques alone, so both members of a pair
always fire alike and there is never a net force: the pair is the unit here.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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


Triple = tuple[float, float, float]


def _arm(position: Sequence[float], direction: Sequence[float]) -> Triple:
    (x, y, z), (a, b, c) = position, direction
    return (y * c - z * b, z * a - x * c, x * b - y * a)


@dataclass(frozen=True)
class ThrusterPairs:
    """Pairs of thrusters of one kind.

    Attributes:
        positions: Position of one thruster of each pair, m in B; the other one sits opposite.
        directions: Directions of their forces in B, of length one; those of the others are opposite.
        thrust: Thrust of each thruster, N.
    """

    positions: tuple[Triple, ...]
    directions: tuple[Triple, ...]
    thrust: float

    @cached_property
    def arms(self) -> tuple[Triple, ...]:
        """Torque per newton, m, of one thruster of each pair."""
        return tuple(_arm(p, d) for p, d in zip(self.positions, self.directions, strict=True))

    def torque(self, pulse: Sequence[Tensor]) -> Vec3:
        """Return the torque, N m in B, of the pairs that fire (``pulse`` is 1 or 0 for each): ``L = sum 2 F (r x d)``.

        F is the thrust, N, of each of the two thrusters of a pair, r and d are position, m, and force direction of one of them.
        """
        axes = zip(*self.arms, strict=True)
        terms = ([on * (2.0 * self.thrust * arm) for on, arm in zip(pulse, axis, strict=True)] for axis in axes)
        return Vec3(*(functools.reduce(operator.add, parts) for parts in terms))


BSK_RL_THRUSTERS = ThrusterPairs(POSITIONS, DIRECTIONS, THRUST)
"""The eight thrusters of bsk_rl."""


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


def thrusters(pairs: ThrusterPairs) -> Component:
    """Return the component of thrusters."""
    names, count = ("pulse", "pulse_command"), len(pairs.positions)
    return Component(
        slot="thrusters",
        update=latch_pulses,
        state=(
            Field("pulse", count, "-", "pairs that fire in the first stage of the next tick", many=True),
            Field("pulse_command", count, "-", "full pulses commanded by the flight software in this tick", many=True),
        ),
        initial=lambda args: {name: torch.zeros(1, count, dtype=torch.float64) for name in names},
        effector=Effector(torque=lambda bus, stage: pairs.torque(bus.pulse) if stage == 0 else None),
    )


THRUSTERS = thrusters(BSK_RL_THRUSTERS)
