"""Attitude thrusters, Basilisk's thrusterDynamicEffector: the eight default ones, which are pairs, or any others.

Basilisk's integrator feels a sixth of every full pulse and nothing of shorter ones: a command of time t is latched at t + h and
acts over (t + h, t + 2 h], but a pulse of at most h ends by t + h, so only the first of the four stages, whose time is t + h, can
find the thruster on, and its weight is 1/6.

The members of a pair have the same torque and opposite forces. Commands follow from torques alone, so both members of a pair
always fire alike and there is never a net force: the pair is the unit of the eight. The torque of a pair is the same about
any point, so this holds wherever the center of mass is. Other thrusters, which the argument ``thrusters`` lists, fire one by one,
and may push the orbit.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from bsk_torch._checks import number, vector
from bsk_torch.constants import NANO
from bsk_torch.sim.component import Arg, Bus, Component, Effector, Field, UserArguments, Values
from bsk_torch.sim.dyn.axes import check_axis, described, of_each, unit_rows
from bsk_torch.sim.dyn.hub import given_numbers
from bsk_torch.sim.faults.declared import may_change
from bsk_torch.sim.names import nearest
from bsk_torch.vec3 import Vec3

THRUST = 0.9  # thrust of one thruster, N (idealised Monarc-1)

_NEAR, _FAR, _HIGH, _SLANT = 0.03874945160902288, 1.206182747348013, 0.85245, math.sqrt(0.5)

POSITIONS = tuple((x, y, z) for x, y in ((_NEAR, -_FAR), (-_NEAR, -_FAR)) for z in (_HIGH, -_HIGH))
"""Positions, m, in B of one thruster of each pair; the other one sits at (-x, -y, -z)."""

DIRECTIONS = tuple((x, _SLANT, 0.0) for x in (-_SLANT, _SLANT) for _ in range(2))
"""Force directions in B of the same thrusters; those of the others are opposite."""


ARMS = tuple((y * c - z * b, z * a - x * c, x * b - y * a) for (x, y, z), (a, b, c) in zip(POSITIONS, DIRECTIONS, strict=True))
"""Torque per newton, m, of both thrusters of each pair, ``r x d``."""


def pair_torque(pulse: Sequence[Tensor]) -> Vec3:
    """Return the torque, N m in B, of the pairs that fire (``pulse`` is 1 or 0 for each): ``L = sum 2 F (r x d)``.

    F is the thrust, N, of each of the two thrusters of a pair, r and d are position, m, and force direction of one of them.
    """
    terms = ([on * (2.0 * THRUST * arm) for on, arm in zip(pulse, axis, strict=True)] for axis in zip(*ARMS, strict=True))
    return Vec3(*(functools.reduce(operator.add, parts) for parts in terms))


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


THRUSTER_TYPES: dict[str, float] = {
    "MOOG_Monarc_1": 0.9,
    "MOOG_Monarc_5": 4.5,
    "MOOG_Monarc_22_6": 22.0,
    "MOOG_Monarc_22_12": 22.0,
    "MOOG_Monarc_90LT": 90.0,
}
"""Thrusts, N, of the types of Basilisk's thrusterFactory. Programs may add others."""


@dataclass(frozen=True)
class Thruster:
    """A thruster that pushes the body at a place, in a direction.

    Raises:
        ValueError: For an unknown type, a thrust that is not positive, or a direction of length zero.

    Attributes:
        position: Place in B, m from its origin.
        direction: Direction of the force on the body, in B, of any length.
        thrust: Thrust, N, or a name in :data:`THRUSTER_TYPES`.
    """

    position: Sequence[float]
    direction: Sequence[float]
    thrust: float | str

    def __post_init__(self) -> None:
        if isinstance(self.thrust, str) and self.thrust not in THRUSTER_TYPES:
            raise ValueError(f"Thruster(thrust={self.thrust!r}) is unknown; {nearest(self.thrust, THRUSTER_TYPES)}")
        thrust = THRUSTER_TYPES[self.thrust] if isinstance(self.thrust, str) else self.thrust
        object.__setattr__(self, "position", vector("Thruster: position", self.position, zero=True))
        object.__setattr__(self, "direction", vector("Thruster: direction", self.direction))
        object.__setattr__(self, "thrust", number("Thruster: thrust", thrust, 0.0, above=True))


OCTET = tuple(
    Thruster([sign * x for x in POSITIONS[k]], [sign * x for x in DIRECTIONS[k]], THRUST)
    for sign, order in ((1.0, (0, 1, 2, 3)), (-1.0, (1, 0, 3, 2)))
    for k in order
)
"""The eight default thrusters, in Basilisk's order."""

ARGS = (
    Arg("thrusters", None, "-", "thrusters, a list of dyn.Thruster; None: the eight default ones", "constant"),
    Arg("thrusterPositions_B", None, "m", "places of the thrusters in B", low=-1e4, high=1e4, shape=(None, 3)),
    Arg("thrusterDirections_B", None, "-", "directions of their forces in B", low=-1e9, high=1e9, shape=(None, 3)),
    Arg("thrusterMaxThrust", None, "N", "their thrusts", low=1e-12, high=1e6, shape=(None,)),
)
"""Arguments of thrusters; the last three replace the numbers of ``thrusters``."""


def described_thrusters(arguments: UserArguments) -> tuple[Thruster, ...] | None:
    """Return the thrusters that arguments as given describe; None for the default pairs, whose numbers are fixed."""
    if arguments["thrusters"] is None and may_change(arguments, *(arg.name for arg in ARGS[1:])):
        return OCTET
    what = "a list of thrusters, such as [dyn.Thruster([0, 0.5, 1], [1, 0, 0], 0.9)]"
    return described(arguments, "thrusters", ARGS[1:], Thruster, what)


def may_push(arguments: UserArguments, listed: Sequence[Thruster]) -> bool:
    """Return whether thrusters may exert a net force: opposite ones of equal thrust about the center of mass never do."""
    drawn = any(arguments[arg.name] is not None for arg in ARGS[1:])
    place = given_numbers(arguments["r_CB_B"])
    centered = place is not None and not bool(place.any())
    return drawn or not centered or not _opposite(listed)


def _opposite(listed: Sequence[Thruster]) -> bool:
    """Return whether each thruster has an opposite one, of which it is the only one."""

    def key(part: Thruster, sign: float) -> tuple[float | str, ...]:
        return (*(sign * x + 0.0 for x in (*part.position, *part.direction)), part.thrust)

    keys = {key(part, 1.0) for part in listed}
    return len(keys) == len(listed) and all(key(part, -1.0) in keys for part in listed)


def forces_and_arms(args: Values) -> tuple[Tensor, Tensor]:
    """Return thrusts with their directions, [n or 1, T, 3] N, and torques about B, [n or 1, T, 3] N m, of thrusters in B."""
    forces = unit_rows(args["thrusterDirections_B"]) * args["thrusterMaxThrust"].unsqueeze(-1)
    places, forces = torch.broadcast_tensors(args["thrusterPositions_B"], forces)
    return forces, torch.linalg.cross(places, forces)


def arms_about_center(args: Values) -> Tensor:
    """Return the torque about the center of mass for a force of one, [n or 1, T, 3] m."""
    unit = unit_rows(args["thrusterDirections_B"])
    places, unit = torch.broadcast_tensors(args["thrusterPositions_B"] - args["r_CB_B"].unsqueeze(-2), unit)
    return torch.linalg.cross(places, unit)


def _fired(pulses: Sequence[Tensor], vectors: Sequence[Vec3]) -> Vec3:
    return functools.reduce(operator.add, (vector * on for on, vector in zip(pulses, vectors, strict=True)))


@functools.cache
def thruster_set(pushes: bool, listed: tuple[Thruster, ...]) -> Component:
    """Return the component of thrusters, which may push the orbit; ``listed`` are the defaults of its arguments."""
    count = len(listed)
    defaults = {
        "thrusterPositions_B": tuple(part.position for part in listed),
        "thrusterDirections_B": tuple(part.direction for part in listed),
        "thrusterMaxThrust": tuple(part.thrust for part in listed),
    }

    def prepare(args: Values) -> dict[str, Tensor]:
        forces, torques = forces_and_arms(args)
        parameters = {"thruster_torques_B": torques.flatten(-2)}
        return parameters | ({"thruster_forces_B": forces.flatten(-2)} if pushes else {})

    def torque(bus: Bus) -> Vec3:
        return _fired(bus.pulse, bus.thruster_torques_B)

    vectors = ("thruster_torques_B", *(("thruster_forces_B",) if pushes else ()))
    fires = (
        Effector(thrust=lambda bus, stage: (_fired(bus.pulse, bus.thruster_forces_B), torque(bus)) if stage == 0 else None)
        if pushes
        else Effector(torque=lambda bus, stage: torque(bus) if stage == 0 else None)
    )
    return replace(
        thrusters(count, fires),
        args=(ARGS[0], *(of_each(arg, count, defaults[arg.name]) for arg in ARGS[1:])),
        params=tuple(Field(name, 3 * count, vectors=True) for name in vectors),
        prepare=prepare,
        check=check_axis("thrusterDirections_B"),
    )


def fitted_thrusters(arguments: UserArguments) -> Component:
    """Return the component of the thrusters that the arguments as given describe."""
    listed = described_thrusters(arguments)
    return THRUSTERS if listed is None else thruster_set(may_push(arguments, listed), listed)


def thrusters(count: int, effector: Effector) -> Component:
    """Return the component of ``count`` thrusters, or pairs of them, that fire together; ``effector`` pushes and turns."""
    return Component(
        slot="thrusters",
        update=latch_pulses,
        args=ARGS,
        state=(
            Field("pulse", count, "-", "thrusters that fire in the first stage of the next tick", many=True),
            Field("pulse_command", count, "-", "full pulses commanded by the flight software in this tick", many=True),
        ),
        fit=fitted_thrusters,
        effector=effector,
    )


THRUSTERS = thrusters(len(ARMS), Effector(torque=lambda bus, stage: pair_torque(bus.pulse) if stage == 0 else None))
"""The eight default thrusters, unless the arguments describe others."""
