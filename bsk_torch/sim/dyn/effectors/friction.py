"""Friction of reaction wheels: Coulomb, viscous and Stribeck, of Basilisk's reactionWheelStateEffector.

It is evaluated in every stage of the hub's Runge-Kutta step, with the wheel's speed of that stage.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from bsk_torch.sim.component import Bus

LINEAR_BELOW = 1e-4  # speed, rad/s, below which friction is proportional to the speed (Basilisk's `omegaLimitCycle`)

Planes = tuple[Tensor, ...]


def _stribeck(x: Tensor | float, coulomb: Tensor, static: Tensor, beta: Tensor) -> Tensor:
    """Return the Stribeck friction, N m, without its viscous part, at the speed x, rad/s.

    ``sqrt(2 e) (F_s - F_c) exp(-(x / b)^2 / 2) x / (b sqrt 2) + F_c tanh(10 x / b)`` (Armstrong-Helouvry, Dupont and Canudas de
    Wit, "A survey of models, analysis tools and compensation methods for the control of machines with friction", Automatica
    30(7), 1994).
    """
    ratio = x * (1.0 / beta)
    return (static - coulomb) * math.sqrt(math.e) * torch.exp(-0.5 * ratio * ratio) * ratio + coulomb * torch.tanh(10.0 * ratio)


def friction_torques(bus: Bus, speeds: Sequence[Tensor], stribeck: bool) -> Planes:
    """Return the friction torques on the wheels, N m, negative where they brake a positive speed.

    Of a speed Omega, ``f = -(sign(Omega) F_c + c Omega)``, below :data:`LINEAR_BELOW` a straight line through zero. A wheel that
    has been at rest, and speeds up from there, has Stribeck friction instead, until it slows down: the flag ``wheel_started`` on
    the bus, which lasts over stages and ticks, with the speed ``wheel_speed_before`` of the last tick.
    """
    torques, flags = [], []
    for k, speed in enumerate(speeds):
        coulomb, viscous = bus.wheel_coulomb[k], bus.wheel_viscous[k]
        force = torch.sign(speed) * coulomb + viscous * speed
        at_limit = coulomb + viscous * LINEAR_BELOW
        if stribeck:
            beta, static = bus.wheel_stribeck[k], bus.wheel_static[k]
            turned = torch.sign(speed) * torch.sign(speed - bus.wheel_speed_before[k]) < 0.0
            started = (bus.wheel_started[k] > 0.5) | (torch.abs(speed) < 0.1 * LINEAR_BELOW)
            started = started & ~turned & (beta > 0.0)
            beta = torch.where(beta > 0.0, beta, torch.ones_like(beta))
            force = torch.where(started, _stribeck(speed, coulomb, static, beta) + viscous * speed, force)
            limit = _stribeck(LINEAR_BELOW, coulomb, static, beta) + viscous * LINEAR_BELOW
            at_limit = torch.where(started, limit, at_limit)
            flags.append(torch.where(started, torch.ones_like(speed), torch.zeros_like(speed)))
        slow = torch.abs(speed) < LINEAR_BELOW
        torques.append(-torch.where(slow, at_limit * (1.0 / LINEAR_BELOW) * speed, force))
    if stribeck:
        bus.wheel_started = tuple(flags)
    return tuple(torques)
