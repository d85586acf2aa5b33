"""Allocation: the torque on the body that a control law asks for, distributed among actuators.

A component with an :class:`~bsk_torch.sim.component.Allocation` knows the actuators, control laws only the torque, as in
Basilisk's rwMotorTorque.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import torch
from torch import Tensor

from bsk_torch.constants import RPM
from bsk_torch.sim.component import Allocation, Arg, Bus, Component, Field, UserArguments, Values
from bsk_torch.sim.dyn.axes import unit_rows
from bsk_torch.sim.dyn.effectors.wheel_set import along, described_wheels
from bsk_torch.sim.fsw.stability import NULL_SHARE
from bsk_torch.vec3 import Vec3, select

Commands = tuple[object, ...]
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


def _chosen(where: Tensor, new: Any, old: Any) -> object:
    if isinstance(new, Vec3):
        return select(where, new, old)
    if isinstance(new, tuple):
        return tuple(torch.where(where, a, b) for a, b in zip(new, old, strict=True))
    return torch.where(where, new, old)


def wheel_map(args: Values) -> Tensor:
    """Return the motor torques [n or 1, N, 3] for a torque of one on the wheels: ``[G]^T ([G] [G]^T)^-1``, of least norm.

    The columns of [G] are the axes of the available wheels. Those in a plane, with ``underactuated=True`` or after a fault, give
    the pseudo-inverse, which takes what lies in the plane; Basilisk then commands zero, or rounding errors.
    """
    axes = unit_rows(args["rwAxes_B"])
    if args.get("rwAvailable") is not None:  # others get rows of zeros
        axes = axes * args["rwAvailable"].unsqueeze(-1)
    return torch.linalg.pinv(axes.mT, rtol=RANK_TOLERANCE)


SMOOTH = 0.3
"""Largest ``k h / J`` of null motion with gain k, N m s, tick h, s, and wheel inertia J, kg m^2, that does not oscillate."""

RANK_TOLERANCE = 1e-9  # share of the largest singular value below which axes are dependent


def distribute(bus: Bus, torque_B: Vec3, null_motion: bool) -> Commands:
    """Return the motor torques, of least norm, that together exert a torque on the body, N m in B.

    ``u = -[W] L``, with [W] of :func:`wheel_map`, as Basilisk's rwMotorTorque; and with null motion
    ``u <- u - k (1 - [W] [G]) (Omega - Omega_0)``, as its rwNullSpace, which brings the wheels to their wanted speeds, as far as
    that exerts no torque. Null motion is that of all wheels, available or not, as in Basilisk.
    """
    u = [-row.dot(torque_B) for row in bus.wheel_map]
    if null_motion:
        excess = [speed - wanted for speed, wanted in zip(bus.Omega_WB_B, bus.null_speeds, strict=True)]
        total = along(list(bus.null_axes_B), excess)
        rows = bus.null_map if bus.has("null_map") else bus.wheel_map
        u = [old - bus.null_gain * (x - row.dot(total)) for old, x, row in zip(u, excess, rows, strict=True)]
    return (tuple(u),)


def check_axes(args: Values) -> None:
    """Check that the axes of the wheels span space, unless they need not."""
    values = torch.linalg.svdvals(unit_rows(args["rwAxes_B"]))
    rank = (values > RANK_TOLERANCE * values[:, :1]).sum(-1)
    plain = (rank < 3) & (args["underactuated"] < 0.5)
    if bool(plain.any()):
        row = int(torch.nonzero(plain)[0])
        axes = args["rwAxes_B"][min(row, len(args["rwAxes_B"]) - 1)].tolist()
        raise ValueError(
            f"the axes of the wheels, {axes}, span {int(rank[min(row, len(rank) - 1)])} of 3 dimensions, so no torque about the "
            "others is possible; add a wheel, such as those of dyn.pyramid(0.8), or give underactuated=True to control the rest"
        )


def _check_null_motion(args: Values, h: float) -> str | None:
    """Return words about null motion that is not smooth; the loop of a wheel is unstable where ``k h / J`` exceeds 1."""
    ratio, smallest = (args["nullSpaceGain"].unsqueeze(-1) * h / args["rwJs"]).max().item(), args["rwJs"].min().item()
    if ratio <= SMOOTH:
        return None
    return (
        f"nullSpaceGain={args['nullSpaceGain'].max().item():g} N m s {'is not stable' if ratio >= 1.0 else 'oscillates'} at "
        f"sim_rate={h:g} s for wheels of {smallest:.3g} kg m^2; {NULL_SHARE * smallest / h:.2g} is smooth"
    )


ARGS = (
    Arg("nullSpaceGain", None, "N m s", "gain of null motion of more than three wheels; None: no such motion", low=0.0, high=1e6),
    Arg("nullSpaceSpeeds", None, "rpm", "wheel speeds wanted by null motion; None: zero", low=-1e6, high=1e6, shape=(None,)),
    Arg("underactuated", False, "-", "whether the axes of the wheels may lie in a plane", "choice", choices=(False, True)),
    Arg("rwAvailable", None, "-", "1: wheels under command, else 0; None: all", low=0.0, high=1.0, whole=True, shape=(None,)),
)


@functools.cache
def wheel_allocation(count: int, null_motion: bool, some: bool) -> Component:
    """Return the component that distributes torques among ``count`` wheels, with null motion if asked for.

    Where it is ``some``, not all wheels are always available.
    """
    params = [Field("wheel_map", 3 * count, vectors=True)]
    args = list(ARGS)
    if null_motion:
        params += [Field("null_axes_B", 3 * count, vectors=True), Field("null_speeds", count, many=True), Field("null_gain")]
        args[1] = dataclasses.replace(ARGS[1], default=0.0, shape=(count,), spread=True)
    if some:
        args[3] = dataclasses.replace(ARGS[3], default=1.0, shape=(count,), spread=True)
        params += [Field("wheel_available", count, many=True)]
        params += [Field("null_map", 3 * count, vectors=True)] if null_motion else []

    def prepare(args: Values) -> dict[str, Tensor]:
        parameters = {"wheel_map": wheel_map(args).flatten(-2)}
        if null_motion:
            parameters |= {"null_axes_B": unit_rows(args["rwAxes_B"]).flatten(-2), "null_gain": args["nullSpaceGain"]}
            parameters |= {"null_speeds": args["nullSpaceSpeeds"] * RPM}
        if some:
            parameters |= {"wheel_available": args["rwAvailable"]}
            everything = {name: value for name, value in args.items() if name != "rwAvailable"}
            parameters |= {"null_map": wheel_map(everything).flatten(-2)} if null_motion else {}
        return parameters

    return Component(
        slot="allocation",
        after="control",
        args=tuple(args),
        params=tuple(params),
        reads=("rwAxes_B", "rwJs"),
        prepare=prepare,
        check=check_axes,
        check_tick=_check_null_motion if null_motion else None,
        allocation=Allocation(("motor_torque_command_B",), functools.partial(distribute, null_motion=null_motion)),
    )


def fitted_allocation(arguments: UserArguments) -> Component:
    """Return the component that distributes torques among the wheels that the arguments as given describe.

    ValueError for none, or null motion of three.
    """
    wheels, null_motion = described_wheels(arguments) if "wheels" in arguments else None, arguments["nullSpaceGain"] is not None
    if wheels is not None and not wheels:
        raise ValueError(
            "sat_args: wheels=[] has no wheels, but the flight software commands them; list at least one dyn.Wheel, or use "
            "fsw_type = fsw.FSWModel"
        )
    if null_motion and (wheels is None or len(wheels) <= 3):
        raise ValueError(
            f"sat_args: nullSpaceGain={arguments['nullSpaceGain']!r} needs more than three wheels: others have no motion without "
            "torque; leave it out, or give wheels=[dyn.Wheel(...), ...]"
        )
    some = arguments["rwAvailable"] is not None
    return BODY_AXIS_WHEELS if wheels is None else wheel_allocation(len(wheels), null_motion, some)


BODY_AXIS_WHEELS = Component(
    slot="allocation",
    after="control",
    args=ARGS,
    allocation=Allocation(("motor_torque_command_B",), lambda bus, torque_B: (-torque_B,)),
    fit=fitted_allocation,
)
"""Three wheels on the axes of B: the motor torques are the opposite of the torque on the body. Others follow from arguments."""
