"""Whether attitude control is stable at the length of a tick: the linear closed loop of one axis, sampled.

With the attitude error s, the rate w and the inertia J of the body without its wheels' spin, ``s' = w / 4`` and ``w' = -u / J``.
The torque u of a tick is what was commanded one tick before the tick's start (see :mod:`bsk_torch.sim.schedule`), so with
``W = h w / 4`` and the command ``c = A s + R W``, scaled by ``h^2 / (4 J)``::

    W(k + 1) = W(k) - c(k - 1)        s(k + 1) = s(k) + W(k) - c(k - 1) / 2

Where pointing at the Sun or at a place, the rate is a difference of errors: ``R (s(k) - s(k - 1))`` takes the place of
``R W(k)``. A law that integrates has ``A = a0 + a1 z / (z - 1)`` and ``R = r0 + r1 z / (z - 1)``. The loop is stable if all roots
of its characteristic polynomial lie within the unit circle, which the recursion of Schur and Cohn tells (Jury, "Theory and
application of the z-transform method", 1964, chapter 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.sim.component import Values
from bsk_torch.sim.dyn.effectors.wheels import free_moments, largest_momentum
from bsk_torch.sim.dyn.hub import BODY, body_inertia

RATE_SHARE = 0.36
"""``P h / J`` of proposed gains with rate gain P and the smallest moment J: roots ``z^2 - z + 0.36`` of the rate loop are 0.6."""

DAMPING = 1.2
"""Damping ``P / sqrt(K J)`` of proposed gains for the largest moment of inertia J, and of those of the default satellite."""

NULL_SHARE = 0.2
"""``k h / J`` of a proposed gain k of null motion, with the smallest wheel inertia J; see ``SMOOTH`` of the allocation."""


def rate_gain(smallest: float, h: float) -> float:
    """Return the rate gain P, N m s, for the smallest moment of inertia without the spin of wheels, kg m^2, and ticks of h s."""
    return RATE_SHARE * smallest / h


def attitude_rate(P: float, largest: float) -> float:
    """Return the fastest rate, 1/s, at which attitude errors decay with the rate gain P, N m s, damped by :data:`DAMPING`.

    With ``K = 4 a P`` and the largest moment of inertia J, kg m^2, ``P / sqrt(K J)`` is 1.2 for ``a = P / (4 1.2^2 J)``.
    """
    return P / (4.0 * DAMPING**2 * largest)


def gains_at(rate: float, P: float) -> dict[str, float]:
    """Return the gains with which errors decay at a rate, 1/s, with the rate gain P, N m s, of feedback and of steering.

    Where errors are small, ``sigma = theta / 4``, and ``omega = -4 a sigma`` is ``theta' = -a theta``. Integrals cancel a
    constant torque in about the same time: with that of feedback, both slow roots are ``a / 2``.
    """
    gains = {"P": P, "K": 4.0 * rate * P, "Ki": 0.25 * rate / P}
    return gains | {"servo_P": P, "servo_Ki": rate * P, "K1": 4.0 * rate, "K3": 4.0 / 3.0 * rate}


GROWTH = 1.001  # factor by which a tick must multiply errors for a loop to grow without bound, and not only to keep them

UNBOUNDED = 7.0
"""Ratio ``50 N m s h / J`` above which a growing loop makes numbers overflow, in spite of the limit of the torque.

Measured with the default gains over 60 000 s: none of 16 satellites at 6.8, 4 at 10.2, 11 at 15.
"""

Polynomial = Sequence[Tensor | float]


class Law(NamedTuple):
    """A control law near its reference: torque ``(a0 + a1 I) s + (r0 + r1 I) w`` with the sum I over ticks, [n or 1, 3] each."""

    a0: Tensor  # torque for an error, N m
    a1: Tensor  # the same, summed over ticks, N m
    r0: Tensor  # torque for a rate, N m s
    r1: Tensor  # the same, summed over ticks, N m s


def _times(p: Polynomial, q: Polynomial) -> list[Tensor | float]:
    product: list[Tensor | float] = [0.0] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for k, b in enumerate(q):
            product[i + k] = product[i + k] + a * b
    return product


def _plus(*parts: Polynomial) -> list[Tensor | float]:
    size = max(map(len, parts))
    padded: list[list[object]] = [[0.0] * (size - len(part)) + list(part) for part in parts]
    return [sum(column) for column in zip(*padded, strict=True)]


def roots_within(polynomial: Polynomial, radius: float = 1.0) -> Tensor:
    """Return whether all roots lie within a circle about zero, for coefficients [...] each, highest power first."""
    scaled = (torch.as_tensor(c, dtype=torch.float64) * radius**-k for k, c in enumerate(polynomial))
    rest = torch.stack(torch.broadcast_tensors(*scaled), -1)
    rest = rest / rest[..., :1]
    within = torch.ones_like(rest[..., 0], dtype=torch.bool)
    while rest.shape[-1] > 1:
        last = rest[..., -1:]
        within = within & (last.squeeze(-1).abs() < 1.0)
        rest = ((rest - last * rest.flip(-1)) / (1.0 - last * last))[..., :-1]
    return within


def is_stable(law: Law, J: Tensor, h: float, growth: float = 1.0) -> Tensor:
    """Return whether a tick multiplies the errors of each axis by less than ``growth``, however the rate is measured, [n, 3].

    J are the moments of inertia without the wheels' spin, [n or 1, 3] kg m^2, and h is the length of a tick, s.
    """
    scale = h * h / (4.0 * J)
    a0, a1, r0, r1 = law.a0 * scale, law.a1 * scale, law.r0 * scale * 4.0 / h, law.r1 * scale * 4.0 / h
    z, back, double, sums = [1.0, 0.0], [1.0, -1.0], [1.0, -2.0, 1.0], (a1 != 0.0) | (r1 != 0.0)
    # a law that sums: A and R times z - 1
    A, R = _plus(_times([a0], back), [a1, 0.0]), _plus(_times([r0], back), [r1, 0.0])

    def stable(A: Polynomial, R: Polynomial, factor: Polynomial) -> Tensor:
        start = _times(_times([2.0], _times(z, double)), factor)  # 2 z (z - 1)^2
        measured = _plus(start, _times([1.0, 1.0], A), _times([2.0, -2.0], R))
        differenced = _plus(_times(z, start), _times([1.0, 1.0], _plus(_times(z, A), _times(back, R))))
        return roots_within(measured, growth) & roots_within(differenced, growth)

    return torch.where(sums, stable(A, R, back), stable([a0], [r0], [1.0]))


def check_gains(args: Values, h: float, law: Law, gains: str, suggested: str) -> str | None:
    """Return words about a loop that is unstable at the length h of a tick, s, to be logged; None if all are stable.

    ``gains`` are those of the law as text, ``suggested`` stable ones, with the names of :func:`gains_at` in braces. ValueError
    if nothing keeps the growing rates bounded, so that numbers overflow.
    """
    J = free_moments(args)
    unstable = ~is_stable(law, J, h).all(-1)
    if not bool(unstable.any()):
        return None
    least, limit = J.min(-1).values, args["u_max"].reshape(len(args["u_max"]), -1)
    endless = ((limit <= 0.0) | torch.isinf(limit)).any(-1)
    unbounded = endless | (largest_momentum(args) * h / least > UNBOUNDED)
    overflows = unbounded & ~is_stable(law, J, h, GROWTH).all(-1)
    row = int(torch.nonzero(overflows if bool(overflows.any()) else unstable)[0])
    smallest, mass = (values[min(row, len(values) - 1)].item() for values in (least, args["mass"]))
    largest = body_inertia(args).max(-1).values
    P = rate_gain(smallest, h)
    proposed = gains_at(attitude_rate(P, largest[min(row, len(largest) - 1)].item()), P)
    better = {name: f"{gain:.2g}" for name, gain in proposed.items()}
    words = (
        f"attitude control with {gains} is not stable at sim_rate={h:g} s for a body with mass={mass:g} kg, whose smallest "
        f"moment of inertia is {smallest:.3g} kg m^2 without its wheels; {suggested.format(**better)} are stable, or a "
        "smaller sim_rate. Rounding errors grow: after about 1,000 s, episodes differ from Basilisk's, which differ likewise"
    )
    if bool(overflows.any()):
        raise ValueError(f"{words}. Rates would grow until numbers overflow")
    return words


def in_words(args: Values, *names: str) -> str:
    """Return gains as text; of several rows the range."""
    return " and ".join(
        f"{name}={low:g}" if low == high else f"{name} from {low:g} to {high:g}"
        for name in names
        for low, high in [(args[name].min().item(), args[name].max().item())]
    )


LOOP = ("inertia", *BODY, "u_max", "rwJs", "rwOmegaMax", "rwAxes_B")  # arguments of body and wheels that check_gains reads


def has_wheels(args: Values) -> bool:
    """Return whether the arguments are those of a body with wheels."""
    return all(name in args for name in (*BODY, "u_max"))
