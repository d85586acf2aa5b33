"""Momentum dumping: thruster pulses that take the wheels' momentum away.

Basilisk's chain thrMomentumManagement, thrForceMapping, thrMomentumDumping, on the thrusters of
:mod:`bsk_torch.sim.dyn.effectors.thrusters`: pairs, or any set.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field, UserArguments, Values, vec
from bsk_torch.sim.dyn.effectors.thrusters import ARMS, THRUST, arms_about_center, described_thrusters
from bsk_torch.sim.dyn.effectors.wheels import largest_momentum
from bsk_torch.vec3 import Vec3, only, select

Pairs = tuple[Tensor, ...]


@functools.cache
def pair_map() -> list[list[float]]:
    """Return the impulse of each thruster of the default pairs, N s, per momentum, N m s: ``D^T (D D^T)^-1``, of least norm.

    D has the torque per newton, m, of each thruster; those of a pair are equal, so that ``D D^T`` is twice that of the pairs.
    """
    D = torch.tensor(ARMS, dtype=torch.float64).mT
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


def impulses(dH: Vec3, rows: Iterable[Sequence[Tensor | float]]) -> Pairs:
    """Return the impulse, N s, of each thruster for the change of momentum dH, N m s in B: Basilisk's thrForceMapping.

    ``F = D^T (D D^T)^-1 dH``, of least norm, then ``F - min(0, min F)``: thrusters only push, and equal impulses of all of them
    have no torque, if the thrusters are symmetric. The ``rows`` are those of :func:`pair_map`.
    """
    wanted = [dH.x * a + dH.y * b + dH.z * c for a, b, c in rows]
    least = torch.clamp(_least(wanted), max=0.0)
    return tuple(f - least for f in wanted)


def _least(values: Sequence[Tensor]) -> Tensor:
    if len(values) == 1:
        return values[0]
    half = len(values) // 2
    return torch.minimum(_least(values[:half]), _least(values[half:]))


Rows = Callable[[Bus], Iterable[Sequence[Tensor | float]]]  # returns the rows of the map of impulses, three each


def dump_momentum(bus: Bus, rows: Rows, thrusts: Callable[[Bus], Sequence[Tensor | float]]) -> None:
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
        on, lambda: _dump(bus, rows(bus), thrusts(bus)), off
    )


def _dump(
    bus: Bus, rows: Iterable[Sequence[Tensor | float]], thrusts: Sequence[Tensor | float]
) -> tuple[Pairs, Vec3, Pairs, Tensor, Tensor]:
    """Return commands, momentum to dump, on-times left, ticks to wait and number of calls after a call."""
    h, first, second = bus.h, bus.dump_calls == 0.0, bus.dump_calls == 1.0
    dH = select(first, momentum_to_dump(stored_momentum(bus), bus.momentum_to_keep), bus.dump_momentum_B)
    waiting = bus.dump_counter > 0.0
    fires = ~first & (second | ~waiting)
    remaining = tuple(
        torch.where(second, f / thrust, remainder)
        for f, thrust, remainder in zip(impulses(dH, rows), thrusts, bus.dump_remaining, strict=True)
    )
    full = tuple((fires & (remainder >= h) & (remainder >= bus.shortest_pulse)).to(remainder.dtype) for remainder in remaining)
    spent = tuple(torch.where(fires, torch.clamp(remainder - h, min=0.0), remainder) for remainder in remaining)
    counter = torch.where(fires, bus.dump_wait, torch.clamp(bus.dump_counter - 1.0, min=0.0))
    return full, dH, spent, torch.where(first, bus.dump_counter, counter), bus.dump_calls + 1.0


def _check(args: Values) -> None:
    if bool((args["thrForceSign"] != 1.0).any()):
        raise ValueError(f"thrForceSign={args['thrForceSign'].tolist()}: only +1 (thrusters that push) is supported")


DUMP_RESET = {"dump_calls": 0.0, "dump_counter": 0.0, "dump_remaining": 0.0}
"""What a mode resets in which desaturation begins."""


DESATURATION_ARGS = (
    Arg("hs_min", 0.0, "N m s", "momentum left in the wheels", low=0.0, high=1e6, flown=(-1e6, 1e6)),
    Arg("maxCounterValue", 4.0, "-", "ticks between pulses", low=0.0, high=2.0**31, whole=True),
    Arg("thrMinFireTime", 0.02, "s", "shortest pulse", low=0.0, high=1e9),
    Arg("desatAttitude", "sun", "-", "attitude while desaturating", "choice", choices=("sun", "nadir", None)),
    Arg("thrForceSign", 1.0, "-", "sign of the thrusters' forces"),
)


def desaturation(count: int, rows: Rows, thrusts: Callable[[Bus], Sequence[Tensor | float]]) -> Component:
    """Return the component that dumps momentum by ``count`` thrusters, or pairs of them, with these thrusts, N.

    The ``rows`` are those of the map, see :func:`impulses`.
    """

    @functools.wraps(dump_momentum)
    def update(bus: Bus) -> None:
        dump_momentum(bus, rows, thrusts)

    return Component(
        slot="desaturation",
        update=update,
        args=DESATURATION_ARGS,
        state=(
            vec("dump_momentum_B", "N m s", "momentum to remove"),
            Field("dump_remaining", count, "s", "on-time left for each thruster or pair", many=True),
            Field("dump_counter", 1, "-", "ticks to wait"),
            Field("dump_calls", 1, "-", "ticks since the mode was entered"),
        ),
        params=(Field("momentum_to_keep", 1, "N m s"), Field("dump_wait"), Field("shortest_pulse", 1, "s")),
        prepare=_prepare,
        check=_check,
        fit=fitted_desaturation,
        flags=("desat_on",),
    )


def _prepare(args: Values) -> dict[str, Tensor]:
    return {"momentum_to_keep": args["hs_min"], "dump_wait": args["maxCounterValue"], "shortest_pulse": args["thrMinFireTime"]}


def _prepare_set(args: Values) -> dict[str, Tensor]:
    return _prepare(args) | {
        "impulse_map": torch.linalg.pinv(arms_about_center(args).mT).flatten(-2),
        "thruster_thrust": args["thrusterMaxThrust"],
    }


def _check_set(args: Values) -> None:
    _check(args)
    values = torch.linalg.svdvals(arms_about_center(args))
    rank = (values > 1e-9 * values[:, :1].clamp(min=1e-30)).sum(-1)
    if bool((rank < 3).any()):
        places = args["thrusterPositions_B"][0].tolist()
        raise ValueError(
            f"thrusters at {places} exert torques about {int(rank.min())} of 3 axes, so desaturation would do nothing; place "
            "them off the lines through the center of mass, in other directions, or add some: three axes need at least three"
        )


def _check_set_in_tick(args: Values, h: float) -> str | None:
    """Return words about thrusters that turn the body otherwise than desired, or never fire."""
    arms, words = arms_about_center(args), []
    uneven = arms.sum(-2).norm(dim=-1) > 1e-6 * arms.norm(dim=-1).sum(-1)
    if bool(uneven.any()):
        words.append(
            "firing all thrusters at once exerts a torque, which the mapping of Basilisk's thrForceMapping assumes to be zero: "
            "desaturation changes the momentum otherwise than desired; place them so that their torques cancel"
        )
    impulse = args["thrusterMaxThrust"] * arms.norm(dim=-1)
    if bool((largest_momentum(args) < h * impulse.min(-1).values).any()):
        words.append(
            f"a pulse of a tick, {h:g} s, of a thruster changes the momentum by up to {h * impulse.max().item():.3g} N m s, and "
            f"wheels have at most {largest_momentum(args):.3g}: shorter pulses do not act, so it never fires; use a smaller "
            "thrust, or sim_rate"
        )
    return "; ".join(words) or None


@functools.cache
def set_desaturation(count: int) -> Component:
    """Return the component that dumps momentum by ``count`` thrusters of any places and directions."""
    part = desaturation(count, lambda bus: bus.impulse_map, lambda bus: bus.thruster_thrust)
    params = (*part.params, Field("impulse_map", 3 * count, vectors=True), Field("thruster_thrust", count, "N", many=True))
    reads = ("thrusterPositions_B", "thrusterDirections_B", "thrusterMaxThrust", "r_CB_B", "rwJs", "rwOmegaMax")
    return replace(part, params=params, reads=reads, prepare=_prepare_set, check=_check_set, check_tick=_check_set_in_tick)


def fitted_desaturation(arguments: UserArguments) -> Component:
    """Return the component for the thrusters that the arguments as given describe."""
    listed = described_thrusters(arguments) if "thrusters" in arguments else None
    return DESATURATION if listed is None else set_desaturation(len(listed))


DESATURATION = desaturation(len(ARMS), lambda bus: pair_map(), lambda bus: [THRUST] * len(ARMS))
"""Desaturation by the eight default thrusters, unless the arguments describe others."""
