"""Parts of passes in the light: when the Sun is at the wanted elevations over places that rest on the Earth.

The Sun's elevation there changes slowly, so few values tell where it crosses a limit: those at the ends of a pass, and in long
passes every ten minutes. Only pieces with a crossing, or an extreme close to the limit, are searched.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.astro.roots import find_maximum, find_root
from bsk_torch.sim.access.passes import Passes
from bsk_torch.sim.places import FixedPlaces, SunElevation
from bsk_torch.vec3 import Vec3

PIECE = 600.0
"""Longest piece of a pass, s. At a place, maxima and minima of the Sun's elevation are about twelve hours apart."""

FASTEST = 7.32e-5
"""Bound of the rate of the sine of the Sun's elevation, 1/s.

The Earth's rotation, 7.292e-5 rad/s, the Sun's motion, at most 2.1e-7 rad/s, and its parallax, 4.3e-5 times both.
"""

BISECTIONS = 4
"""Bisections of a search for a crossing: within 40 s, the sine is nearly a straight line or a parabola of time."""

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

    Args:
        margin: A function that changes by at most :data:`FASTEST` per second, and has at most one extreme in a :data:`PIECE`.
        passes: Passes.
    """
    pieces = torch.ceil((passes.close - passes.open) / PIECE).clamp(min=1.0).long()
    number = torch.repeat_interleave(pieces + 1)  # of the pass to which each point belongs
    k = torch.arange(len(number), device=number.device) - (torch.cumsum(pieces + 1, 0) - (pieces + 1))[number]
    first, last = k == 0, k == pieces[number]
    time = torch.lerp(passes.open[number], passes.close[number], k / pieces[number].to(passes.open.dtype))
    value = margin(number, time)
    holds = value > 0.0

    edges = time.unsqueeze(-1).repeat(1, 3)  # at each point, and up to two on the piece behind it
    found = torch.stack([holds & (first | last), torch.zeros_like(holds), torch.zeros_like(holds)], -1)
    begin = torch.nonzero(~last).squeeze(-1)
    crosses = begin[holds[begin] != holds[begin + 1]]
    edges[crosses, 1] = _root(margin, number[crosses], time[crosses], time[crosses + 1])
    found[crosses, 1] = True
    both = value[begin].abs() + value[begin + 1].abs() < FASTEST * (time[begin + 1] - time[begin])
    turns, opens, closes = _extremes(margin, number, time, holds, begin[(holds[begin] == holds[begin + 1]) & both])
    edges[turns, 1], edges[turns, 2] = opens, closes
    found[turns, 1:] = True

    point, _ = torch.nonzero(found, as_tuple=True)
    # edges of a pass begin and end a part in turn
    own, opens, closes = number[point[::2]], edges[found][::2], edges[found][1::2]
    long = closes > opens
    return Passes(passes.row[own][long], passes.place[own][long], opens[long], closes[long])


def _root(margin: Margin, number: Tensor, a: Tensor, b: Tensor) -> Tensor:
    def f(time: Tensor) -> Tensor:
        return margin(number, time)

    return find_root(f, a, b, f(a), f(b), bisections=BISECTIONS)


def _extremes(margin: Margin, number: Tensor, time: Tensor, holds: Tensor, begin: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return which pieces, of those that begin at points ``begin``, cross the limit twice, and when, s."""
    own, a, b = number[begin], time[begin], time[begin + 1]
    sign = torch.where(holds[begin], -1.0, 1.0).to(time.dtype)
    extreme = find_maximum(lambda when: sign * margin(own, when), a, b)
    twice = (margin(own, extreme) > 0.0) != holds[begin]
    own, a, b, extreme = (part[twice] for part in (own, a, b, extreme))
    return begin[twice], _root(margin, own, a, extreme), _root(margin, own, extreme, b)
