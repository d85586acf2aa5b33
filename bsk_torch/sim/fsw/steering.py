"""Attitude control in two loops: a steering law asks for a body rate, a rate servo makes the wheels reach it.

Sources: Basilisk's modules mrpSteering and rateServoFullNonlinear; Schaub and Piggott, "Speed-constrained three-axes attitude
control using kinematic steering", Acta Astronautica 147, 2018.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_rate
from bsk_torch.sim.component import Arg, Bus, Component, Field, UserArguments, Values
from bsk_torch.sim.dyn.hub import body_inertia
from bsk_torch.sim.fsw.allocation import Commands, commands_for, held_commands, write_commands
from bsk_torch.sim.fsw.control import (
    CONTROL_AXES,
    CONTROL_STATE,
    LAW_ARGS,
    body_and_wheels,
    check_control_axes,
    initial_control,
    with_given_terms,
)
from bsk_torch.sim.fsw.stability import LOOP, Law, check_gains, has_wheels, in_words
from bsk_torch.vec3 import Vec3, only, select, times


def steering_rate(sigma: Vec3, K1: Tensor, K3: Tensor, omega_max: Tensor) -> tuple[Vec3, Vec3]:
    """Return the steering rate omega_B*R, rad/s in B, that takes the error sigma_BR away, and its derivative, rad/s^2.

    Axis by axis, never faster than ``omega_max``::

        w = -(2 omega_max / pi) atan(y),  y = (K1 s + K3 s^3) pi / (2 omega_max)
        w' = -(K1 + 3 K3 s^2) / (1 + y^2) s',  s' = 1/4 B(s) w

    Source: Schaub and Piggott (2018); Basilisk's mrpSteering.
    """
    y = sigma.map(lambda s: (K1 * s + K3 * s * s * s) * (0.5 * math.pi / omega_max))
    rate = y.map(torch.atan) * (omega_max * (-2.0 / math.pi))
    slope = sigma.map(lambda s, y: (K1 + 3.0 * K3 * s * s) / (1.0 + y * y), y)
    return rate, -slope.scale(mrp_rate(sigma, rate))


def steer(bus: Bus) -> None:
    """Command the torque L on the body, N m in B (Basilisk's rateServoFullNonlinear).

    The law is::

        -L = P e + Ki z - w* x H - I (w_R' + w_s' - w x w_R) + L_k
        w* = w_s + w_R,  e = w - w*,  z = int(e dt),  H = I w + sum h

    with the body rate w = omega_BN, the reference's rate w_R = omega_RN and the steering rate w_s of :func:`steering_rate`, rad/s
    in B; I is the inertia of the spacecraft, kg m^2, and h the momentum of each effector about its own axes, such as
    ``Js (w + Omega)`` of wheels; L_k, N m, is the known disturbance ``knownTorquePntB_B``, if given.

    The integral is kept within +-0.2 / servo_Ki, or +-integralLimit, for each component; it acts where ``servo_Ki`` is positive,
    and its first call has dt = 0. Where control is off the command holds, and the clock of the integral runs.
    """
    on, never = bus.control_on > 0.0, bus.control_idle < 0.0
    waited = torch.where(never, bus.control_idle, bus.control_idle + bus.h)

    def law() -> tuple[Commands, Vec3]:
        sigma_BR, omega_BR_B, w_R, dw_R = bus.error
        w_s, dw_s = steering_rate(sigma_BR, bus.K1, bus.K3, bus.omega_max)
        w, w_star = omega_BR_B + w_R, w_s + w_R
        e = w - w_star
        z = _integral(bus, e, torch.where(never, torch.zeros_like(waited), waited))
        H = body_and_wheels(bus, w)
        acceleration = dw_R + dw_s - w.cross(w_R)
        opposite = e * bus.servo_P + z * bus.servo_Ki - w_star.cross(H) - times(bus.inertia_B, acceleration)
        if bus.has("known_torque_B"):
            opposite = opposite + bus.known_torque_B
        return commands_for(bus, -opposite), z

    commands, bus.control_integral_B = only(on, law, (held_commands(bus), bus.control_integral_B))
    write_commands(bus, commands)
    bus.control_idle = torch.where(on, torch.zeros_like(waited), waited)


def _integral(bus: Bus, e: Vec3, dt: Tensor) -> Vec3:
    """Return the integral of the rate error, rad; zero where ``servo_Ki`` is not positive."""
    integrates = bus.servo_Ki > 0.0
    usual = 0.2 / torch.where(integrates, bus.servo_Ki, torch.ones_like(bus.servo_Ki))
    limit = bus.integral_limit if bus.has("integral_limit") else usual
    z = (bus.control_integral_B + e * dt).map(lambda x: torch.minimum(torch.maximum(x, -limit), limit))
    return select(integrates, z, Vec3.zeros_like(e.x))


def steering_law(args: Values, h: float) -> Law:
    """Return :func:`steer` near its reference, in ticks of h s: there ``w_s = -K1 s`` and ``w_s' = K1^2 s / 4``."""
    K1, P, Ki = (args[name].unsqueeze(-1) for name in ("K1", "servo_P", "servo_Ki"))
    sums = torch.clamp(Ki, min=0.0) * h
    inertia = body_inertia(args)
    none = torch.zeros_like(K1 + P + sums)
    return Law(P * K1 - inertia * K1 * K1 / 4.0, sums * K1, P + none, sums + none)


def check_steering(args: Values, h: float) -> str | None:
    """Check that the gains are stable; see :func:`bsk_torch.sim.fsw.stability.check_gains`."""
    if not has_wheels(args):
        return None
    gains = in_words(args, "K1", "servo_P", "servo_Ki")
    return check_gains(args, h, steering_law(args, h), gains, "K1={K1}, servo_P={servo_P} and servo_Ki={servo_Ki}")


GAINS = ("K1", "K3", "omega_max", "servo_Ki", "servo_P")


def fitted_steering(arguments: UserArguments) -> Component:
    """Return MRP steering with the terms that the arguments as given ask for."""
    return with_given_terms(MRP_STEERING, arguments)


MRP_STEERING = Component(
    slot="control",
    update=steer,
    args=(
        Arg("K1", 0.25, "rad/s", "steering gain of small errors", low=0.0, high=1e6),
        Arg("K3", 3.0, "rad/s", "steering gain of large errors", low=0.0, high=1e6),
        Arg("omega_max", math.radians(3.0), "rad/s", "fastest rate that the steering law asks for", low=1e-9, high=1e6),
        Arg("servo_Ki", 5.0, "N m/rad", "integral gain of the rate servo; no integral where not positive", high=1e6),
        Arg("servo_P", 150.0, "N m s", "gain of the rate servo", low=0.0, high=1e6),
        CONTROL_AXES,
        *LAW_ARGS,
    ),
    state=CONTROL_STATE,
    reads=LOOP,
    params=tuple(Field(name) for name in GAINS),
    initial=initial_control,
    prepare=lambda args: {name: args[name] for name in GAINS},
    check=check_control_axes,
    check_tick=check_steering,
    fit=fitted_steering,
    flags=("control_on",),
)
