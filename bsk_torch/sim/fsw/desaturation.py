"""Momentum dumping: thruster pulses that take the wheels' momentum away.

Basilisk's chain thrMomentumManagement, thrForceMapping, thrMomentumDumping, on the thruster pairs of
:mod:`bsk_torch.sim.dyn.thrusters`.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec
from bsk_torch.sim.dyn.thrusters import BSK_RL_THRUSTERS, ThrusterPairs
from bsk_torch.vec3 import Vec3, only, select

Pairs = tuple[Tensor, ...]


@functools.cache
def impulse_map(pairs: ThrusterPairs) -> list[list[float]]:
    """Return the impulse of each thruster of the pairs, N s, per momentum, N m s: ``D^T (D D^T)^-1``, of least norm.

    D has the torque per newton, m, of each thruster; those of a pair are equal, so that ``D D^T`` is twice that of the pairs.
    """
    D = torch.tensor(pairs.arms, dtype=torch.float64).mT
    mapping: list[list[float]] = (D.mT @ torch.linalg.inv(2.0 * D @ D.mT)).tolist()
    return mapping


def stored_momentum(bus: Bus) -> Vec3:
    """Return the sum of the effectors' momenta relative to the hub, such as ``Js Omega`` of wheels, N m s in B."""
    momenta = [effector.momentum(bus, None) for effector in bus.effectors if effector.momentum]
    return functools.reduce(operator.add, momenta) if momenta else Vec3.zeros_like(bus.sigma_BN.x)


def momentum_to_dump(h: Vec3, keep: Tensor) -> Vec3:
    """Return the change of momentum, N m s in B, that leaves ``keep``, N m s, of h: Basilisk's thrMomentumManagement.

    ``dH = -(|h| - keep) h / |h|``, and 0 where ``|h| < keep``.
    """
    size = h.norm()
    excess = torch.where(size < keep, torch.zeros_like(size), size - keep)
    return h * (-excess / torch.where(size > 0.0, size, torch.ones_like(size)))


def impulses(dH: Vec3, pairs: ThrusterPairs) -> Pairs:
    """Return the impulse, N s, of each pair's thrusters for the change of momentum dH, N m s in B: Basilisk's thrForceMapping.

    ``F = D^T (D D^T)^-1 dH``, of least norm, then ``F - min(0, min F)``: thrusters only push, and equal impulses of all of them
    have no torque.
    """
    wanted = [dH.x * a + dH.y * b + dH.z * c for a, b, c in impulse_map(pairs)]
    least = torch.clamp(_least(wanted), max=0.0)
    return tuple(f - least for f in wanted)


def _least(values: Sequence[Tensor]) -> Tensor:
    """Return the least of several planes, by pairs of halves."""
    if len(values) == 1:
        return values[0]
    half = len(values) // 2
    return torch.minimum(_least(values[:half]), _least(values[half:]))


def dump_momentum(bus: Bus, pairs: ThrusterPairs) -> None:
    """Fire for one tick, wait ``maxCounterValue`` ticks, until the impulse is spent; Basilisk's thrMomentumDumping.

    Only pulses of a whole tick reach the integrator, so only those are commanded. With on-times left T, ticks to wait c, and
    impulses F of the momentum measured in the first call::

        call of the mode     condition     command           T after           c after
        first                              none              T                 c
        second                             T >= h of F/F0    max(F/F0 - h, 0)  maxCounterValue
        later                c > 0         none              T                 c - 1
        later                c = 0         T >= h            max(T - h, 0)     maxCounterValue

    F0 is the thrust of a thruster, N; pulses shorter than ``thrMinFireTime`` are not fired. Entering the mode sets T and c to
    zero.
    """
    on = bus.desat_on > 0.0
    none = tuple(torch.zeros_like(command) for command in bus.pulse_command)
    off = none, bus.dump_momentum_B, bus.dump_remaining, bus.dump_counter, bus.dump_calls
    bus.pulse_command, bus.dump_momentum_B, bus.dump_remaining, bus.dump_counter, bus.dump_calls = only(
        on, lambda: _dump(bus, pairs), off
    )


def _dump(bus: Bus, pairs: ThrusterPairs) -> tuple[Pairs, Vec3, Pairs, Tensor, Tensor]:
    """Return commands, momentum to dump, on-times left, ticks to wait and number of calls after a call."""
    h, first, second = bus.h, bus.dump_calls == 0.0, bus.dump_calls == 1.0
    dH = select(first, momentum_to_dump(stored_momentum(bus), bus.momentum_to_keep), bus.dump_momentum_B)
    waiting = bus.dump_counter > 0.0
    fires = ~first & (second | ~waiting)
    remaining = tuple(
        torch.where(second, f / pairs.thrust, left) for f, left in zip(impulses(dH, pairs), bus.dump_remaining, strict=True)
    )
    full = tuple((fires & (left >= h) & (left >= bus.shortest_pulse)).to(left.dtype) for left in remaining)
    spent = tuple(torch.where(fires, torch.clamp(left - h, min=0.0), left) for left in remaining)
    counter = torch.where(fires, bus.dump_wait, torch.clamp(bus.dump_counter - 1.0, min=0.0))
    return full, dH, spent, torch.where(first, bus.dump_counter, counter), bus.dump_calls + 1.0


def _check(args: Values) -> None:
    if bool((args["thrForceSign"] != 1.0).any()):
        raise ValueError(f"thrForceSign={args['thrForceSign'].tolist()}: only +1 (thrusters that push) is supported")


DUMP_RESET = {"dump_calls": 0.0, "dump_counter": 0.0, "dump_remaining": 0.0}
"""What a mode resets in which desaturation begins."""


DESATURATION_ARGS = (
    Arg("hs_min", 0.0, "N m s", "momentum left in the wheels", low=0.0, high=1e6),
    Arg("maxCounterValue", 4.0, "-", "ticks between pulses", low=0.0, high=2.0**31, whole=True),
    Arg("thrMinFireTime", 0.02, "s", "shortest pulse", low=0.0, high=1e9),
    Arg("desatAttitude", "sun", "-", "attitude while desaturating", "choice", choices=("sun", "nadir", None)),
    Arg("thrForceSign", 1.0, "-", "sign of the thrusters' forces"),
)


def desaturation(pairs: ThrusterPairs) -> Component:
    """Return the component that dumps momentum by pairs of thrusters."""
    count = len(pairs.positions)
    widths = {"dump_momentum_B": 3, "dump_remaining": count, "dump_counter": 1, "dump_calls": 1}

    @functools.wraps(dump_momentum)
    def update(bus: Bus) -> None:
        dump_momentum(bus, pairs)

    return Component(
        slot="desaturation",
        update=update,
        args=DESATURATION_ARGS,
        state=(
            vec("dump_momentum_B", "N m s"),
            Field("dump_remaining", count, "s", "on-time left for each pair", many=True),
            Field("dump_counter", 1, "-", "ticks to wait"),
            Field("dump_calls", 1, "-", "ticks since the mode was entered"),
        ),
        params=(Field("momentum_to_keep", 1, "N m s"), Field("dump_wait"), Field("shortest_pulse", 1, "s")),
        initial=lambda args: {name: torch.zeros(1, width, dtype=torch.float64) for name, width in widths.items()},
        prepare=lambda args: {
            "momentum_to_keep": args["hs_min"],
            "dump_wait": args["maxCounterValue"],
            "shortest_pulse": args["thrMinFireTime"],
        },
        check=_check,
        flags=("desat_on",),
    )


DESATURATION = desaturation(BSK_RL_THRUSTERS)
