"""Magnetic torque bars: electromagnets that the Earth's magnetic field turns. Basilisk's MtbEffector.

Commands of the flight software act from the tick in which they are written: there is no extra tick of delay as for wheels. The
field is that of the position one tick ago, constant over a tick, and turns relative to the body within it. Bars take no power.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from bsk_torch._checks import number, parts, vector
from bsk_torch.sim.component import Arg, Bus, Component, Effector, Field, UserArguments
from bsk_torch.sim.dyn.axes import check_axis, of_each, unit_rows
from bsk_torch.vec3 import Mat3, Vec3

MOST_BARS = 36  # length of the arrays in Basilisk's messages


@dataclass(frozen=True)
class TorqueBar:
    """A magnetic torque bar.

    Raises:
        ValueError: For an axis of length zero, or a dipole that is not positive.

    Attributes:
        axis: Direction of its dipole in B, of any length.
        maxDipole: Largest dipole in both directions, A m^2.
    """

    axis: Sequence[float]
    maxDipole: float

    def __post_init__(self) -> None:
        number("TorqueBar: maxDipole", self.maxDipole, 0.0, above=True)
        object.__setattr__(self, "axis", vector("TorqueBar: axis", self.axis))


ARGS = (
    Arg("torqueBars", None, "-", "magnetic torque bars, a list of dyn.TorqueBar", "constant"),
    Arg("barAxes_B", None, "-", "directions of their dipoles in B", low=-1e9, high=1e9, shape=(None, 3)),
    Arg("barMaxDipoles", None, "A m^2", "their largest dipoles", low=1e-12, high=1e9, shape=(None,)),
)
"""Arguments of torque bars; the last two replace the numbers of ``torqueBars``."""


def described_bars(arguments: UserArguments) -> tuple[TorqueBar, ...]:
    """Return the bars that arguments as given describe; ValueError for none, and for entries that are not bars."""
    example = "[dyn.TorqueBar(axis, 0.2) for axis in ([1, 0, 0], [0, 1, 0], [0, 0, 1])]"
    what = f"a list of bars for dyn.TorqueBarsDynModel, such as {example}"
    listed = parts("sat_args: torqueBars", arguments["torqueBars"], TorqueBar, what)
    if len(listed) > MOST_BARS:
        raise ValueError(f"sat_args: torqueBars has {len(listed)} bars; at most {MOST_BARS} are allowed")
    return listed


def magnetic_torque(bus: Bus, BN: Mat3, r_BN_N: Vec3) -> tuple[None, Vec3]:
    """Return the torque, N m in B, ``L = (sum_i g_i m_i) x [BN] B_N``, of the dipoles m_i, A m^2, about the axes g_i.

    ``m_i`` is the command, at most the largest dipole; B_N is the magnetic field, T (Wertz, "Spacecraft attitude determination
    and control", section 17.3).
    """
    dipole = Vec3.zeros_like(bus.sigma_BN.x)
    for axis, command, most in zip(bus.bar_axes_B, bus.bar_command, bus.bar_max_dipole, strict=True):
        dipole = dipole + axis * torch.minimum(torch.maximum(command, -most), most)
    return None, dipole.cross(BN @ bus.magnetic_field_N)


@functools.cache
def bar_set(listed: tuple[TorqueBar, ...]) -> Component:
    """Return the component of torque bars; ``listed`` are the defaults of its arguments."""
    count = len(listed)
    axes = of_each(ARGS[1], count, tuple(bar.axis for bar in listed))
    dipoles = of_each(ARGS[2], count, tuple(bar.maxDipole for bar in listed))
    return Component(
        slot="torque_bars",
        after="disturbance",
        args=(ARGS[0], axes, dipoles),
        state=(Field("bar_command", count, "A m^2", "dipoles of the bars, of the flight software or a user", many=True),),
        params=(Field("bar_axes_B", 3 * count, vectors=True), Field("bar_max_dipole", count, "A m^2", many=True)),
        prepare=lambda args: {
            "bar_axes_B": unit_rows(args["barAxes_B"]).flatten(-2),
            "bar_max_dipole": args["barMaxDipoles"],
        },
        check=check_axis("barAxes_B"),
        effector=Effector(ambient=magnetic_torque),
    )


TORQUE_BARS = Component(
    slot="torque_bars", after="disturbance", args=ARGS, fit=lambda arguments: bar_set(described_bars(arguments))
)
"""The bars that ``torqueBars`` lists."""
