"""Parts of passes in the light: when the Sun is at the wanted elevations over places that rest on the Earth.

The sine of the Sun's elevation is nearly a cosine of time with the period of a day. Where it is far from a limit in the middle of
a piece of a pass, all of the piece is in the light or none. On the few other pieces, three values determine the cosine, and with
it where it crosses the limit; the exact sine is then evaluated at the crossings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.sim.access.passes.passes import Passes
from bsk_torch.sim.places import FixedPlaces, SunElevation
from bsk_torch.vec3 import Vec3

PIECE = 300.0  # longest piece of a pass, s, on which three values determine the sine: to 6e-11, as its rate varies by 4e-4

FASTEST = 7.32e-5
"""Bound of the rate of the sine, 1/s.

The Earth's rotation, 7.292e-5 rad/s, the Sun's motion, at most 2.1e-7 rad/s, and its parallax, 4.3e-5 times both.
"""

RATE = 2.0 * math.pi / 86400.0  # mean rate at which the Sun moves about the Earth, rad/s

NEWTON_STEPS = 2
"""Steps of Newton's method from the crossing of the cosine, which is 1e-6 s off where the sine changes quickly."""

Margin = Callable[[Tensor, Tensor], Tensor]
"""Margin of a condition, [m], for passes with these numbers [m] at times [m] s; positive where the condition holds."""


def in_light(places: FixedPlaces, rows: Tensor, passes: Passes) -> Passes:
    """Return the parts of passes of satellites ``rows`` [n] in which all conditions ``places.light`` hold."""
    for condition in places.light:
        passes = parts_where(_margin_of(condition, places, rows, passes), passes)
    return passes


def _margin_of(condition: SunElevation, places: FixedPlaces, rows: Tensor, passes: Passes) -> Margin:
    def margin(number: Tensor, time: Tensor) -> Tensor:
        row, place = rows[passes.row[number]], passes.place[number]
        return condition.margin_at(row, Vec3.of(places.position(row, place, time)), time, places.tables)

    return margin


def parts_where(margin: Margin, passes: Passes) -> Passes:
    """Return the parts of passes in which the margin is positive, in the order of the passes and of time.

    The margin is nearly ``A + R cos(w t - phi)`` with the rate w of the Sun, and R at most 1.
    """
    pieces = torch.ceil((passes.close - passes.open) / PIECE).clamp(min=1.0).long()
    number = torch.repeat_interleave(pieces)  # of the pass to which each piece belongs
    k = torch.arange(len(number), device=number.device) - (torch.cumsum(pieces, 0) - pieces)[number]
    opens, closes, count = passes.open[number], passes.close[number], pieces[number]
    a, m, b = (torch.lerp(opens, closes, (k + share).to(opens.dtype) / count) for share in (0.0, 0.5, 1.0))
    f_m = margin(number, m)
    near = torch.nonzero(f_m.abs() <= 0.5 * FASTEST * (b - a)).squeeze(-1)
    f_a, f_b = (f_m.index_put((near,), f) for f in margin(number[near].repeat(2), torch.cat([a[near], b[near]])).chunk(2))
    after = f_b > 0.0
    before = torch.where(k == 0, f_a > 0.0, after.roll(1))
    edges, is_edge = torch.stack([a, m, m, b], -1), torch.zeros(len(k), 4, dtype=torch.bool, device=k.device)
    is_edge[:, 0], is_edge[:, 3] = before & (k == 0), after & (k + 1 == count)
    piece = _Pieces(number[near], *(x[near] for x in (a, m, b, f_a, f_m, f_b, before, after)))
    edges[near, 1:3], is_edge[near, 1:3] = piece.crossings(margin)
    # edges of a pass, in this order, begin and end a part in turn
    run, opens, closes = number[torch.nonzero(is_edge)[::2, 0]], edges[is_edge][::2], edges[is_edge][1::2]
    long = closes > opens
    return Passes(passes.row[run][long], passes.place[run][long], opens[long], closes[long])


class _Pieces(NamedTuple):
    """Pieces of passes: pass, begin, middle and end, s, the margin then, and whether it is positive at the ends; [p] each."""

    number: Tensor
    a: Tensor
    m: Tensor
    b: Tensor
    f_a: Tensor
    f_m: Tensor
    f_b: Tensor
    before: Tensor
    after: Tensor

    def crossings(self, margin: Margin) -> tuple[Tensor, Tensor]:
        """Return the times, [p, 2] s, of up to two crossings on each piece, and which of them there are, [p, 2].

        With half the length d and ``x = w (t - m)``::

            f = A + C cos x + S sin x      C = (f_m - (f_a + f_b) / 2) / (1 - cos wd)
                                           S = (f_b - f_a) / (2 sin wd)      A = f_m - C

        so that with ``R = |(C, S)|``, ``phi = atan2(S, C)`` and ``theta = acos(-A / R)`` it rises through zero at
        ``phi - theta``, and falls at ``phi + theta``.
        """
        reach = 0.5 * RATE * (self.b - self.a)
        C = (self.f_m - 0.5 * (self.f_a + self.f_b)) / (2.0 * torch.sin(0.5 * reach) ** 2)
        S, A = (self.f_b - self.f_a) / (2.0 * torch.sin(reach)), self.f_m - C
        R, phi = torch.hypot(C, S), torch.atan2(S, C)
        theta = torch.acos((-A / R).clamp(-1.0, 1.0))
        rise, fall = (torch.remainder(x + math.pi, 2.0 * math.pi) - math.pi for x in (phi - theta, phi + theta))
        early, late = torch.where(self.before, fall, rise), torch.where(self.before, rise, fall)
        once = self.before != self.after
        twice = ~once & (A.abs() < R) & (-reach < early) & (early < late) & (late < reach)

        def within(time: Tensor) -> Tensor:
            return torch.minimum(torch.maximum(time, self.a.unsqueeze(-1)), self.b.unsqueeze(-1))

        middle, both = self.m.unsqueeze(-1), self.number.unsqueeze(-1).expand(-1, 2).flatten()
        time = within(middle + torch.stack([early, late], -1) / RATE)
        for _ in range(NEWTON_STEPS):
            x = RATE * (time - middle)
            slope = RATE * (S.unsqueeze(-1) * torch.cos(x) - C.unsqueeze(-1) * torch.sin(x))
            time = within(time - torch.where(slope != 0.0, margin(both, time.flatten()).view_as(time) / slope, 0.0))
        return time, torch.stack([once | twice, twice], -1)
