"""Three reaction wheels on the body axes, and the power that wheels draw.

Others are in :mod:`bsk_torch.sim.dyn.effectors.wheel_set`. Basilisk's reactionWheelStateEffector and ReactionWheelPower. As the
wheels' axes are those of B, three speeds, or torques, are the components of a vector in B. With the inertia Js of a wheel about
its axis, kg m^2, its speed Omega relative to the hub, rad/s, and the motor torque u, N m (Schaub and Junkins, section 4.5), the
wheels load the hub with ``u + Js omega x Omega``, and ``Omega' = u / Js - omega'``.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Iterator

import torch
from torch import Tensor

from bsk_torch.constants import RPM
from bsk_torch.sim.component import Arg, Bus, Component, Effector, Field, UserArguments, Values, vec
from bsk_torch.sim.dyn.effectors.wheel_set import ARGS, described_wheels, free_tensor_moments, wheel_form, wheel_set
from bsk_torch.sim.dyn.hub import MOTION, body_inertia, body_momentum, check_turn, described_body
from bsk_torch.sim.dyn.power.balance import power_arg
from bsk_torch.vec3 import Vec3

MAX_SPEED = 6000.0 * RPM  # speed, rad/s, at which a wheel takes no more accelerating torque (Honeywell HR16)
SPIN_INERTIA = 50.0 / MAX_SPEED  # wheel inertia about its axis, kg m^2 (Honeywell HR16, 50 N m s)


def latch_motor_torque(bus: Bus) -> None:
    """Latch the commanded torque u, N m, which acts over the whole next tick, within the limits of motor and wheel.

    ``u = clip(u_cmd, -u_max, u_max)`` where u_max is positive, and 0 where ``|Omega| >= 6000 rpm`` and ``Omega u >= 0``: a wheel
    at its top speed can only brake. The command was written by the flight software one tick ago: Basilisk's extra tick of delay.
    """
    limit = bus.max_motor_torque

    def limited(command: Tensor, speed: Tensor) -> Tensor:
        torque = torch.where(limit > 0.0, torch.minimum(torch.maximum(command, -limit), limit), command)
        saturated = (torch.abs(speed) >= MAX_SPEED) & (speed * torque >= 0.0)
        return torch.where(saturated, torch.zeros_like(torque), torque)

    bus.motor_torque_B = bus.motor_torque_command_B.map(limited, bus.Omega_WB_B)


def wheel_loads(bus: Bus, omega_BN_B: Vec3, y: tuple[Vec3]) -> Iterator[Vec3]:
    """Yield the torques, N m in B, that the hub exerts on the wheels: of the motors, and ``Js omega x Omega``."""
    yield bus.motor_torque_B
    yield omega_BN_B.cross(y[0]) * SPIN_INERTIA


def wheel_rates(bus: Bus, omega_BN_B: Vec3, omega_dot_B: Vec3, y: tuple[Vec3]) -> tuple[Vec3]:
    """Return the accelerations of the wheels, ``Omega' = u / Js - omega'``, rad/s^2."""
    return (bus.motor_torque_B * (1.0 / SPIN_INERTIA) - omega_dot_B,)


def wheel_momentum(bus: Bus, omega_BN_B: Vec3 | None) -> Vec3:
    """Return the wheels' momentum about their axes, ``Js (omega + Omega)``, or ``Js Omega`` relative to the hub, N m s in B."""
    rate = bus.Omega_WB_B if omega_BN_B is None else omega_BN_B + bus.Omega_WB_B
    return rate * SPIN_INERTIA


def draw_wheel_power(bus: Bus) -> None:
    """Add the electrical power of the wheels, W, to the balance: ``P = -sum_i (P_base + need_i)``.

    With the mechanical power ``w = Omega_i u_i``, the need is ``|w| / eta_em`` where w is positive, the wheel accelerates, and
    ``eta_me w`` where it brakes, which returns power; with a negative eta_me braking costs as accelerating does.
    """

    def need(speed: Tensor, torque: Tensor) -> Tensor:
        return _needed(speed * torque, bus.wheel_to_battery, bus.battery_to_wheel)

    needs: Vec3 = bus.Omega_WB_B.map(need, bus.motor_torque_B)
    bus.power = bus.power - functools.reduce(operator.add, needs) - float(len(needs)) * bus.wheel_base_power


def _needed(mechanical: Tensor, returned: Tensor, used: Tensor) -> Tensor:
    """Return the electrical power, W, for a mechanical one, without that which a wheel always draws."""
    costs = (mechanical > 0.0) | (returned < 0.0)
    return torch.where(costs, torch.abs(mechanical) * (1.0 / used), returned * mechanical)


AXIAL_INERTIA = Vec3(SPIN_INERTIA, SPIN_INERTIA, SPIN_INERTIA)  # type: ignore[arg-type]  # numbers, which all rows share
"""Diagonal of the inertia of the three wheels about their axes, kg m^2."""


def _check_inertia(args: Values) -> None:
    smallest = body_inertia(args).min(-1).values
    if bool((smallest <= SPIN_INERTIA).any()):
        row = int(smallest.argmin())
        raise ValueError(
            f"{described_body(args, row)}: a body whose smallest moment of inertia is {smallest[row].item():.3g} kg m^2 cannot "
            f"hold reaction wheels of {SPIN_INERTIA:.3g} kg m^2 each (Honeywell HR16, as in Basilisk): no gains K and P are "
            "stable. Give a larger body, smaller wheels, such as wheels=[dyn.Wheel('NanoAvionics_RW0', axis), ...], or models "
            "without wheels, dyn.DynamicsModel and fsw.FSWModel"
        )


def _check_spin(args: Values, h: float) -> None:
    """Check that ticks of h s resolve the initial rates of body and wheels; see :func:`bsk_torch.sim.dyn.hub.check_turn`."""
    inertia = body_inertia(args)
    H = body_momentum(args) + args["wheelSpeeds"] * (RPM * SPIN_INERTIA)
    check_turn(args, H, inertia - SPIN_INERTIA, h, "wheelSpeeds and omega_init turn")


def free_moments(args: Values) -> Tensor:
    """Return the moments of inertia [n or 1, 3], kg m^2, of the body without the spin of its wheels.

    Those of a box with the default wheels are about the body axes, others principal moments.
    """
    return body_inertia(args) - SPIN_INERTIA if args.get("rwJs") is None else free_tensor_moments(args)


def largest_momentum(args: Values) -> float:
    """Return the largest momentum of a wheel at its top speed, N m s; infinite where it has none."""
    if args.get("rwJs") is None:
        return SPIN_INERTIA * MAX_SPEED
    fastest = torch.where(args["rwOmegaMax"] > 0.0, args["rwOmegaMax"], torch.inf) * RPM
    return float((args["rwJs"] * fastest).max())


def fitted_wheels(arguments: UserArguments) -> Component:
    """Return the component of the wheels that the arguments as given describe."""
    wheels = described_wheels(arguments)
    return WHEELS if wheels is None else wheel_set(wheel_form(arguments, wheels), wheels)


WHEELS = Component(
    slot="wheels",
    update=latch_motor_torque,
    args=ARGS,
    state=(
        vec("Omega_WB_B", "rad/s", "wheel speeds"),
        vec("motor_torque_B", "N m", "torques of the wheels' motors"),
        vec("motor_torque_command_B", "N m", "torques commanded by the flight software"),
    ),
    params=(Field("max_motor_torque", 1, "N m"),),
    reads=MOTION,
    initial=lambda args: {"Omega_WB_B": args["wheelSpeeds"] * RPM},
    prepare=lambda args: {"max_motor_torque": args["u_max"]},
    check=_check_inertia,
    check_tick=_check_spin,
    fit=fitted_wheels,
    effector=Effector(
        state=("Omega_WB_B",),
        loads=wheel_loads,
        inertia=lambda bus: AXIAL_INERTIA,
        rates=wheel_rates,
        momentum=wheel_momentum,
    ),
)
"""The three default wheels, unless the arguments describe others."""


POWER_ARGS = (
    power_arg("rwBasePower", 0.4, "power that each wheel always draws"),
    Arg(
        "rwMechToElecEfficiency",
        0.0,
        "-",
        "share of braking power returned; negative: braking costs too",
        low=-1e6,
        high=1.0,
        flown=(-1e6, 1e6),
    ),
    Arg("rwElecToMechEfficiency", 0.5, "-", "share of power that accelerates a wheel", low=1e-9, high=1.0, flown=(1e-9, 1e6)),
)


def draw_power_of_wheels(bus: Bus) -> None:
    """Add the electrical power of the wheels, W, to the balance, as :func:`draw_wheel_power`; each wheel has its numbers."""
    power = bus.power
    for k, (speed, torque) in enumerate(zip(bus.Omega_WB_B, bus.motor_torque_B, strict=True)):
        power = power - (_needed(speed * torque, bus.wheel_to_battery[k], bus.battery_to_wheel[k]) + bus.wheel_base_power[k])
    bus.power = power


def base_power_of_wheels(args: Values, n: int) -> Tensor:
    """Return the power that all wheels of each of n satellites always draw together, [n] W."""
    each: Tensor = args["rwBasePower"]
    return (each.sum(-1) if each.ndim > 1 else each * args["wheelSpeeds"].shape[-1]).expand(n)


@functools.cache
def wheel_power(count: int) -> Component:
    """Return the component of the power of ``count`` wheels, each with its numbers; one number stands for all."""
    if not count:
        return Component(slot="wheel_power", args=POWER_ARGS)
    return dataclasses.replace(
        WHEEL_POWER,
        update=draw_power_of_wheels,
        args=tuple(dataclasses.replace(arg, shape=(count,), spread=True) for arg in POWER_ARGS),
        params=tuple(dataclasses.replace(field, width=count, many=True) for field in WHEEL_POWER.params),
    )


def fitted_power(arguments: UserArguments) -> Component:
    """Return the component of the power of the wheels that the arguments as given describe."""
    wheels = described_wheels(arguments) if "wheels" in arguments else None
    return WHEEL_POWER if wheels is None else wheel_power(len(wheels))


WHEEL_POWER = Component(
    slot="wheel_power",
    update=draw_wheel_power,
    args=POWER_ARGS,
    fit=fitted_power,
    params=(Field("wheel_base_power", 1, "W"), Field("wheel_to_battery"), Field("battery_to_wheel")),
    prepare=lambda args: {
        "wheel_base_power": args["rwBasePower"],
        "wheel_to_battery": args["rwMechToElecEfficiency"],
        "battery_to_wheel": args["rwElecToMechEfficiency"],
    },
)
