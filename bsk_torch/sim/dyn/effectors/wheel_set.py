"""Reaction wheels in any number, about any axes, with friction: Basilisk's reactionWheelStateEffector, balanced wheels.

The three wheels of :mod:`bsk_torch.sim.dyn.effectors.wheels` are the special case that is compiled to fewer operations. What
wheels have, friction for example, is fixed when the tick is built, by :class:`WheelForm`; their numbers are parameters.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch._checks import parts
from bsk_torch.constants import RPM
from bsk_torch.rand import Uniform
from bsk_torch.sim.component import Arg, Bus, Component, Effector, Field, UserArguments, Values
from bsk_torch.sim.dyn.axes import check_axis, of_each, unit_rows
from bsk_torch.sim.dyn.effectors.wheel_types import TRIAD, Wheel
from bsk_torch.sim.dyn.hub import MOTION, body_inertia, body_momentum, check_turn, described_body, given_numbers, inertia_tensor
from bsk_torch.sim.faults.declared import may_change
from bsk_torch.vec3 import Mat3, Vec3

Axis = int | Vec3  # a wheel's axis: the number of the axis of B that it is, or a unit vector in B

Planes = tuple[Tensor, ...]

MOST_WHEELS = 36  # length of the arrays in Basilisk's messages

NUMBERS = (
    Arg("rwAxes_B", None, "-", "spin axes of the wheels in B, of any length", "scalar", -1e9, 1e9, shape=(None, 3)),
    Arg("rwJs", None, "kg m^2", "inertia of the wheels about their axes", low=1e-12, high=1e6, shape=(None,)),
    Arg("rwOmegaMax", None, "rpm", "speed from which on a wheel can only brake; no limit where not positive", shape=(None,)),
    Arg("rwUMin", None, "N m", "smallest motor torque; smaller commands become 0", low=0.0, high=1e6, shape=(None,)),
    Arg("rwPMax", None, "W", "largest mechanical power; no limit where not positive", shape=(None,)),
    Arg("rwFCoulomb", None, "N m", "Coulomb friction", low=0.0, high=1e6, shape=(None,)),
    Arg("rwFStatic", None, "N m", "static friction, with rwBetaStatic", low=0.0, high=1e6, shape=(None,)),
    Arg("rwBetaStatic", None, "rad/s", "Stribeck friction coefficient; none where negative", shape=(None,)),
    Arg("rwCViscous", None, "N m s", "viscous friction", low=0.0, high=1e6, shape=(None,)),
)
"""Numbers of wheels that replace those of ``wheels``; without ``wheels``, those of the three default ones."""

WHEELS_ARG = Arg("wheels", None, "-", "reaction wheels, a list of dyn.Wheel; None: three HR16 on the axes of B", "constant")

ARGS = (
    WHEELS_ARG,
    *NUMBERS,
    Arg("wheelSpeeds", Uniform(-1500.0, 1500.0, 3), "rpm", "initial wheel speeds", "vector", -1e6, 1e6),
    Arg("maxWheelSpeed", math.inf, "rpm", "spacecraft with a wheel at or above this speed die", low=1e-6, flown=(-1e9, math.inf)),
    Arg("u_max", 0.2, "N m", "largest motor torque; no limit where not positive", endless=True),
)
"""Arguments of the three default wheels, and those that describe others."""


EACH = ("u_max", "rwBasePower", "rwMechToElecEfficiency", "rwElecToMechEfficiency", "rwAvailable")
"""Arguments of which the three default wheels share one number; others have one for each wheel."""


class WheelForm(NamedTuple):
    """What decides the operations of a tick with wheels."""

    axes: tuple[int | None, ...]  # for each wheel the number of the axis of B about which it turns, None for another direction
    least: bool  # whether small torques become zero
    power: bool  # whether power is limited
    friction: bool  # whether there is friction
    stribeck: bool  # whether some of it is Stribeck friction


def described_wheels(arguments: UserArguments) -> tuple[Wheel, ...] | None:
    """Return the wheels that arguments as given describe; None for the three default ones, all of whose numbers are fixed.

    ValueError for entries that are not wheels.
    """
    if arguments["wheels"] is None:
        described = any(arguments[arg.name] is not None for arg in NUMBERS) or arguments.get("rwAvailable") is not None
        return TRIAD if described or may_change(arguments, *EACH) else None
    what = "a list of wheels, such as [dyn.Wheel('BCT_RWP015', [1, 0, 0])]"
    wheels = parts("sat_args: wheels", arguments["wheels"], Wheel, what, empty=True)
    if len(wheels) > MOST_WHEELS:
        raise ValueError(f"sat_args: wheels has {len(wheels)} wheels; at most {MOST_WHEELS} are allowed")
    return wheels


def wheel_defaults(wheels: Sequence[Wheel]) -> dict[str, tuple[object, ...]]:
    """Return the numbers of wheels by argument, one entry for each wheel."""
    each = [wheel.arguments for wheel in wheels]
    return {name: tuple(numbers[name] for numbers in each) for name in (each[0] if each else ())}


def wheel_form(arguments: UserArguments, wheels: Sequence[Wheel]) -> WheelForm:
    """Return what decides the operations of wheels, from the arguments as given: what is drawn may be anything."""
    if not wheels:
        return WheelForm((), False, False, False, False)
    defaults = wheel_defaults(wheels)

    def numbers(name: str) -> Tensor | None:
        return given_numbers(defaults[name] if arguments[name] is None else arguments[name])

    def positive(name: str) -> bool:
        values = numbers(name)
        return values is None or bool((values > 0.0).any())

    axes = numbers("rwAxes_B")
    is_fixed = axes is not None and axes.shape == (len(wheels), 3)
    axis_numbers = [_axis_number(row) for row in axes] if is_fixed and axes is not None else [None] * len(wheels)
    stribeck = positive("rwBetaStatic")
    friction = stribeck or positive("rwFCoulomb") or positive("rwCViscous")
    return WheelForm(tuple(axis_numbers), positive("rwUMin"), positive("rwPMax"), friction, stribeck)


def _axis_number(row: Tensor) -> int | None:
    """Return the number of the axis of B in whose positive direction a vector points exactly, None for others."""
    nonzero = torch.nonzero(row).flatten().tolist()
    return int(nonzero[0]) if len(nonzero) == 1 and bool(row[nonzero[0]] > 0.0) else None


def axes_on(bus: Bus, form: WheelForm) -> list[Axis]:
    """Return the axes of the wheels."""
    return [bus.wheel_axes_B[k] if axis is None else axis for k, axis in enumerate(form.axes)]


def along(axes: Sequence[Axis], values: Sequence[Tensor]) -> Vec3:
    """Return the sum of vectors along axes, ``sum_i g_i x_i``."""
    parts: list[list[Tensor]] = [[], [], []]
    for axis, value in zip(axes, values, strict=True):
        for k in range(3) if isinstance(axis, Vec3) else (axis,):
            parts[k].append(axis[k] * value if isinstance(axis, Vec3) else value)
    return Vec3(*(functools.reduce(operator.add, part) if part else torch.zeros_like(values[0]) for part in parts))


def component(axis: Axis, v: Vec3) -> Tensor:
    """Return the component of a vector along an axis, ``g . v``."""
    return axis.dot(v) if isinstance(axis, Vec3) else v[axis]


@functools.cache
def wheel_effector(form: WheelForm) -> Effector:
    """Return the effector of wheels, with inertia J_i and axis g_i, motor torque u_i, friction f_i, speed Omega_i.

    The wheels load the hub with ``sum_i g_i (u_i + f_i)`` and ``omega x sum_i g_i J_i Omega_i``, and ``Omega_i' = (u_i + f_i) /
    J_i - g_i . omega'`` (Schaub and Junkins, section 4.5).
    """

    def loads(bus: Bus, omega_BN_B: Vec3, y: tuple[Planes]) -> Iterator[Vec3]:
        torques = bus.motor_torque_B
        if form.friction:
            friction = friction_torques(bus, y[0], form.stribeck)
            torques = tuple(u + f for u, f in zip(torques, friction, strict=True))
        bus.wheel_torque = torques  # the rates of the same stage read them
        axes = axes_on(bus, form)
        yield along(axes, torques)
        yield omega_BN_B.cross(along(axes, [J * speed for J, speed in zip(bus.wheel_inertia, y[0], strict=True)]))

    def inertia(bus: Bus) -> Vec3 | Mat3:
        axes = axes_on(bus, form)
        if not any(isinstance(axis, Vec3) for axis in axes):
            return along(axes, bus.wheel_inertia)
        zero, outer = torch.zeros_like(bus.wheel_inertia[0]), []
        for axis, J in zip(axes, bus.wheel_inertia, strict=True):
            vector = axis if isinstance(axis, Vec3) else Vec3(*(zero + float(k == axis) for k in range(3)))
            outer.append(Mat3.outer(vector, vector * J))
        return functools.reduce(operator.add, outer)

    def rates(bus: Bus, omega_BN_B: Vec3, omega_dot_B: Vec3, y: tuple[Planes]) -> tuple[Planes]:
        each = zip(axes_on(bus, form), bus.wheel_torque, bus.wheel_inertia, strict=True)
        return (tuple(torque * (1.0 / J) - component(axis, omega_dot_B) for axis, torque, J in each),)

    def momentum(bus: Bus, omega_BN_B: Vec3 | None) -> Vec3:
        axes, speeds = axes_on(bus, form), bus.Omega_WB_B
        if omega_BN_B is not None:
            speeds = [component(axis, omega_BN_B) + speed for axis, speed in zip(axes, speeds, strict=True)]
            if bus.has("wheel_available"):  # the software leaves out wheels that it does not command
                speeds = [speed * on for speed, on in zip(speeds, bus.wheel_available, strict=True)]
        return along(axes, [J * speed for J, speed in zip(bus.wheel_inertia, speeds, strict=True)])

    return Effector(state=("Omega_WB_B",), loads=loads, inertia=inertia, rates=rates, momentum=momentum)


@functools.cache
def latch(form: WheelForm) -> Callable[[Bus], None]:
    """Return the update of wheels: the torque that acts over the next tick."""

    def latch_motor_torques(bus: Bus) -> None:
        """Latch the commanded torques u, N m, which act over the whole next tick, within the limits of motors and wheels.

        In Basilisk's order: the largest torque, where positive; the smallest; the largest power P, ``u <- sign(u) P / |Omega|``
        where ``|u Omega| >= P``; and 0 at the largest speed, unless the torque brakes.
        """
        torques = []
        for k, (command, speed) in enumerate(zip(bus.motor_torque_command_B, bus.Omega_WB_B, strict=True)):
            most, fastest = bus.max_motor_torque[k], bus.wheel_top_speed[k]
            u = torch.where(most > 0.0, torch.minimum(torch.maximum(command, -most), most), command)
            if form.least:
                u = torch.where(torch.abs(u) < bus.min_motor_torque[k], torch.zeros_like(u), u)
            if form.power:
                power = bus.max_wheel_power[k]
                over = (power > 0.0) & (torch.abs(u * speed) >= power)
                rate = torch.where(over, torch.abs(speed), torch.ones_like(speed))
                u = torch.where(over, torch.sign(u) * (power / rate), u)
            saturated = (fastest > 0.0) & (torch.abs(speed) >= fastest) & (speed * u >= 0.0)
            torques.append(torch.where(saturated, torch.zeros_like(u), u))
        bus.motor_torque_B = tuple(torques)
        if form.stribeck:
            bus.wheel_speed_before = bus.Omega_WB_B

    return latch_motor_torques


def free_tensor_moments(args: Values) -> Tensor:
    """Return the principal moments [n or 1, 3], kg m^2, of ``I - sum_i J_i g_i g_i^T``, in ascending order.

    This is the inertia of the body without the spin of its wheels, of inertia J_i about axes g_i.
    """
    axes = unit_rows(args["rwAxes_B"])
    return torch.linalg.eigvalsh(inertia_tensor(args) - (axes.mT * args["rwJs"].unsqueeze(-2)) @ axes)


def _initial(form: WheelForm, args: Values) -> dict[str, Tensor]:
    speeds = args["wheelSpeeds"] * RPM
    state = {"Omega_WB_B": speeds}
    if form.stribeck:  # Basilisk evaluates its equations once before the first tick
        started = (speeds.abs() < 1e-5) & (args["rwBetaStatic"] > 0.0)
        state |= {"wheel_speed_before": speeds, "wheel_started": started.to(torch.float64)}
    return state


PARAMETERS = {
    "wheel_inertia": ("rwJs", 1.0),
    "wheel_top_speed": ("rwOmegaMax", RPM),
    "max_motor_torque": ("u_max", 1.0),
    "min_motor_torque": ("rwUMin", 1.0),
    "max_wheel_power": ("rwPMax", 1.0),
    "wheel_coulomb": ("rwFCoulomb", 1.0),
    "wheel_viscous": ("rwCViscous", 1.0),
    "wheel_static": ("rwFStatic", 1.0),
    "wheel_stribeck": ("rwBetaStatic", 1.0),
}
"""Parameters of the tick, one for each wheel, with the arguments that they are, and factors to SI units."""


def parameters_of(form: WheelForm) -> tuple[str, ...]:
    """Return the names of the parameters that a form of wheels needs."""
    names = ["wheel_inertia", "wheel_top_speed", "max_motor_torque"]
    names += ["min_motor_torque"] if form.least else []
    names += ["max_wheel_power"] if form.power else []
    names += ["wheel_coulomb", "wheel_viscous"] if form.friction else []
    return (*names, *(("wheel_static", "wheel_stribeck") if form.stribeck else ()))


def _prepare(form: WheelForm, args: Values) -> dict[str, Tensor]:
    parameters = {name: args[PARAMETERS[name][0]] * PARAMETERS[name][1] for name in parameters_of(form)}
    return parameters | {"wheel_axes_B": unit_rows(args["rwAxes_B"]).flatten(-2)}


def _check(form: WheelForm, args: Values) -> None:
    axes = args["rwAxes_B"]
    check_axis("rwAxes_B")(args)
    if bool((args["rwBetaStatic"] == 0.0).any()):
        raise ValueError("rwBetaStatic=0 is not allowed: give the speed, rad/s, at which static friction decays, or -1 for none")
    for k, axis in enumerate(form.axes):
        if axis is not None and any(_axis_number(row) != axis for row in axes[:, k]):
            raise ValueError(
                f"rwAxes_B: wheel {k} of the first satellite of the type turns about axis {axis} of B, so that of all must; give "
                "the first one another axis, too, or draw the axes"
            )
    absent = (("rwUMin", form.least), ("rwPMax", form.power), ("rwFCoulomb", form.friction), ("rwCViscous", form.friction))
    for name, has in (*absent, ("rwBetaStatic", form.stribeck)):
        if not has and bool((args[name] > 0.0).any()):
            raise ValueError(
                f"{name}={args[name].max().item():g}: the first satellite of the type has none, which decides what is built; "
                "give it a small positive number, too"
            )
    check_inertia(args)


def check_inertia(args: Values) -> None:
    """Check that the body is heavier than its wheels, whose inertia is included in that of the body."""
    smallest = free_tensor_moments(args)[:, 0]
    if bool((smallest <= 0.0).any()):
        row = int(smallest.argmin())
        wheels = args["rwJs"][min(row, len(args["rwJs"]) - 1)].tolist()
        raise ValueError(
            f"{described_body(args, row)}: a body whose smallest moment of inertia is "
            f"{body_inertia(args)[min(row, len(body_inertia(args)) - 1)].min().item():.3g} kg m^2, wheels included, cannot hold "
            f"reaction wheels of {', '.join(f'{J:.3g}' for J in wheels)} kg m^2. Give a larger body, or smaller wheels, such as "
            "dyn.Wheel('NanoAvionics_RW0', axis)"
        )


def _check_tick(args: Values, h: float) -> None:
    """Check that ticks of h s resolve initial rates of body and wheels, and what the motors can do in one."""
    moments = free_tensor_moments(args)
    spin = (unit_rows(args["rwAxes_B"]) * (args["rwJs"] * args["wheelSpeeds"] * RPM).unsqueeze(-1)).sum(-2)
    check_turn(args, body_momentum(args) + spin, moments, h, "wheelSpeeds and omega_init turn")
    strongest = torch.where(torch.isinf(args["u_max"]), torch.zeros_like(args["u_max"]), args["u_max"]).amax(-1, keepdim=True)
    kick = torch.cat([strongest.clamp(min=0.0) * h, torch.zeros_like(strongest).expand(-1, 2)], -1)
    check_turn(args, kick, moments, h, f"wheels with u_max={strongest.max().item():g} N m, in one tick, turn")


@functools.cache
def wheel_set(form: WheelForm, wheels: tuple[Wheel, ...]) -> Component:
    """Return the component of wheels of a form; ``wheels`` are the defaults of its arguments.

    The fields of the state are tuples, with an entry for each wheel.
    """
    count = len(wheels)
    if not count:
        return Component(slot="wheels", args=ARGS)
    defaults = wheel_defaults(wheels) | {"wheelSpeeds": Uniform(-1500.0, 1500.0, count)}
    state = [Field("Omega_WB_B", count, "rad/s", "wheel speeds", many=True)]
    state += [Field(name, count, "N m", many=True) for name in ("motor_torque_B", "motor_torque_command_B")]
    if form.stribeck:
        state += [Field("wheel_speed_before", count, "rad/s", "speeds of the last tick", many=True)]
        state += [Field("wheel_started", count, "-", "1 for wheels with Stribeck friction", many=True)]
    return Component(
        slot="wheels",
        update=latch(form),
        args=tuple(of_each(arg, count, defaults[arg.name]) if arg.name in defaults else arg for arg in ARGS),
        state=tuple(state),
        params=(*(Field(name, count, many=True) for name in parameters_of(form)), Field("wheel_axes_B", 3 * count, vectors=True)),
        reads=MOTION,
        initial=functools.partial(_initial, form),
        prepare=functools.partial(_prepare, form),
        check=functools.partial(_check, form),
        check_tick=_check_tick,
        effector=wheel_effector(form),
    )


# -- friction ------------------------------------------------------------------------------------------------------------------


LINEAR_BELOW = 1e-4  # speed, rad/s, below which friction is proportional to the speed (Basilisk's `omegaLimitCycle`)


def _stribeck(x: Tensor | float, coulomb: Tensor, static: Tensor, beta: Tensor) -> Tensor:
    """Return the Stribeck friction, N m, without its viscous part, at the speed x, rad/s.

    ``sqrt(2 e) (F_s - F_c) exp(-(x / b)^2 / 2) x / (b sqrt 2) + F_c tanh(10 x / b)`` (Armstrong-Helouvry, Dupont and Canudas de
    Wit, "A survey of models, analysis tools and compensation methods for the control of machines with friction", Automatica
    30(7), 1994).
    """
    ratio = x * (1.0 / beta)
    return (static - coulomb) * math.sqrt(math.e) * torch.exp(-0.5 * ratio * ratio) * ratio + coulomb * torch.tanh(10.0 * ratio)


def friction_torques(bus: Bus, speeds: Sequence[Tensor], stribeck: bool) -> Planes:
    """Return the friction torques on the wheels, N m, negative where they brake a positive speed, in a stage of the hub's step.

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
