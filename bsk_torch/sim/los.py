"""Lines of sight between the satellites of an episode, as Basilisk's SpacecraftLocation and bsk_rl's logs of it see them.

In every tick the module of satellite i finds satellite j where j is after that tick if j comes first in the episode, and where it
was a tick ago otherwise. The Earth is an ellipsoid that becomes a sphere when lengths along its axis are stretched.

Nobody looks at every tick. The *margin* of a pair, positive where one of the two sees the other, changes no faster than the
satellites move; so if the margins at both ends of an interval add up to less than minus the distance flown in it, nothing is seen
within. Other intervals are halved.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import position, positions
from bsk_torch.astro.orbit import periapsis_radius
from bsk_torch.constants import NANO, R_EARTH
from bsk_torch.lanes.loop import Loop, Samples
from bsk_torch.sim.component import Bus, neighbours
from bsk_torch.sim.paths import ARC, Sketch
from bsk_torch.sim.sight import KernelSight
from bsk_torch.sim.sky import SKY, orient_pole, put_track
from bsk_torch.sim.span import LEAD, SPACING
from bsk_torch.vec3 import Vec3, select

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet
    from bsk_torch.sim.simulator import Simulator

RANGE = "losMaximumRange"
"""Argument of satellites: how far they see, m; without limit where it is not positive."""

STRETCH = 1.0 / 0.98
"""Of lengths along the Earth's axis; bsk_rl takes the polar radius for 0.98 of the equatorial one."""

HASTE = 1.02
"""Satellites are never faster than so many times the speed that they would have at their osculating periapsis."""

TINY = 1e-300
"""Far below what rounding leaves of positions."""

BLOCK, DEVICE_BLOCK = 1 << 15, 1 << 22
"""Pairs looked at together on the CPU, where they should fit into its cache, and on other devices, where memory bounds them."""

TOGETHER = 1 << 22
"""Pairs of which margins are kept together, unless one episode has more."""


# -- where satellites are ------------------------------------------------------------------------------------------------------


def flown_positions(simulator: Simulator, rows: Tensor, time: Tensor) -> Tensor:
    """Positions [m, 3] m in N of rows [m], which may repeat, at times [m] s since reset that their flown arcs cover."""
    arcs = simulator.arcs
    path = Samples(arcs.flown, arcs.start - LEAD * SPACING, rows)
    if isinstance(simulator.eclipses.sight, KernelSight):
        state = time.expand(4, -1).clone()
        path_kernel()(state, 1, (path,))
        return state[1:].mT
    nodes, tau = neighbours(ARC, path.table, rows, time - path.start[rows])
    return positions(nodes, tau * (1.0 / SPACING))


@cache
def path_kernel() -> Loop:
    """Position on the flown arc; the state is the time, then what is found."""
    sketch = Sketch()
    time: Any = sketch.planes("state", 1)[0]
    r: Any = position(*sketch.path(1))
    return Loop("flown positions", sketch.program, [time, *r], (ARC,), clock="state_0")


def pole_directions(simulator: Simulator, rows: Tensor, time: Tensor) -> Tensor:
    """The Earth's axis [m, 3] in N at times [m] s since the resets of rows [m], which may repeat."""
    records, tau = neighbours(SKY, simulator.arcs.sky, rows, time - simulator.arcs.start[rows])
    bus = Bus(simulator.h_ns)
    put_track(bus, SKY, records.flatten(1).unbind(-1), tau)
    orient_pole(bus)
    return bus.pole.z.stack()


def fastest(simulator: Simulator) -> Tensor:
    """Bound of every satellite's speed, [N] m/s: ``|r x v|`` over the osculating periapsis, and a little more."""
    r, v = (Vec3.of(simulator.read(name)) for name in ("r", "v"))
    return HASTE * r.cross(v).norm() / periapsis_radius(r, v)


# -- who sees whom -------------------------------------------------------------------------------------------------------------


def stretched(r: Vec3, pole: Vec3) -> Vec3:
    """The position with lengths along the Earth's axis stretched, which makes the Earth a sphere."""
    return r + pole * ((STRETCH - 1.0) * r.dot(pole))


def clearance(p: Vec3, q: Vec3) -> Tensor:
    """How far the straight line between stretched positions p and q passes the Earth, m; it changes no faster than either does.

    The point that is nearest to the Earth's centre is ``p + k (q - p)`` with ``k = p . (p - q) / |p - q|^2``, or an end.
    """
    p2, q2, pq = p.dot(p), q.dot(q), p.dot(q)
    along = p2 - pq
    d2 = along + (q2 - pq)
    k = torch.clamp(along / torch.clamp(d2, min=TINY), 0.0, 1.0)
    return torch.sqrt(torch.clamp(p2 - k * (2.0 * along - k * d2), min=0.0)) - R_EARTH


class Spots(NamedTuple):
    """Positions, m in N, and the same stretched."""

    r: Vec3
    stretched: Vec3

    @staticmethod
    def of(r: Vec3, pole: Vec3) -> Spots:
        """Of positions under the Earth's axis."""
        return Spots(r, stretched(r, pole))

    def map(self, function: Callable[[Tensor], Tensor]) -> Spots:
        """Apply ``function`` to every component."""
        return Spots(*(part.map(function) for part in self))

    def where(self, condition: Tensor, other: Spots) -> Spots:
        """These where ``condition`` holds, else the others."""
        return Spots(*(select(condition, mine, theirs) for mine, theirs in zip(self, other, strict=True)))


def margin(own: Spots, other: Spots, reach: Tensor | None) -> Tensor:
    """Positive where others are seen: the clearance, or half of what is left of the range ``reach`` if that is less, m."""
    clear = clearance(own.stretched, other.stretched)
    if reach is None:
        return clear
    return torch.minimum(clear, 0.5 * (reach - (other.r - own.r).norm()) + TINY)


class Pairs(NamedTuple):
    """Pairs of satellites: episode, number of the first and of the second satellite, which comes later, [m] each."""

    env: Tensor
    i: Tensor
    j: Tensor

    def of(self, index: Tensor) -> Pairs:
        """Some of the pairs."""
        return Pairs(*(part[index] for part in self))


class Spans(NamedTuple):
    """Spans of time: number of the pair, first and last tick, and the margins in these, [m] each."""

    pair: Tensor
    first: Tensor
    last: Tensor
    at_first: Tensor
    at_last: Tensor

    def of(self, index: Tensor) -> Spans:
        """Some of the spans."""
        return Spans(*(part[index] for part in self))


class Lookout:
    """Looks from the satellites of a fleet during the present step, whose logged ticks are ``first`` to ``last`` [N]."""

    def __init__(self, fleet: Fleet, first: Tensor, last: Tensor) -> None:
        """Prepare; reaches and speeds are [N, S], m and m per tick along stretched axes, axes are [N]."""
        self.fleet, self.first, self.last = fleet, first, last
        self.h_ns = fleet.simulators[0].h_ns
        sizes = [len(columns) for columns in fleet.columns]
        order, numbers = torch.cat(fleet.columns), torch.cat([torch.arange(size, device=fleet.device) for size in sizes])
        self.number = torch.empty_like(order).index_copy_(0, order, numbers)
        reach = fleet.joined([simulator.drawn[RANGE] for simulator in fleet.simulators])
        self.reach = torch.where(reach > 0.0, reach, torch.inf) if bool((reach > 0.0).any()) else None
        self.speed = fleet.joined([fastest(simulator) for simulator in fleet.simulators]) * (STRETCH * fleet.h)
        earth = fleet.simulators[0]
        start, end = (pole_directions(earth, fleet.all_envs * earth.count, self.time(tick)) for tick in (first, last))
        self.axis = Vec3.of(start)
        self.drift = Vec3.of((end - start) / (last - first).clamp(min=1).unsqueeze(-1))
        self.block = BLOCK if fleet.device.type == "cpu" else DEVICE_BLOCK

    def time(self, tick: Tensor) -> Tensor:
        """Seconds since reset, float64, after so many ticks."""
        return (tick * self.h_ns).double() * NANO

    def positions(self, env: Tensor, satellite: Tensor, tick: Tensor) -> Vec3:
        """Positions [m] in N, m, of satellites [m] of episodes [m] at ticks [m]."""
        time, number = self.time(tick), self.number[satellite]
        if len(self.fleet.simulators) == 1:
            simulator = self.fleet.simulators[0]
            return Vec3.of(flown_positions(simulator, env * simulator.count + number, time))
        found = time.new_empty(len(time), 3)
        for simulator, columns in zip(self.fleet.simulators, self.fleet.columns, strict=True):
            mine = torch.nonzero(torch.isin(satellite, columns)).squeeze(-1)
            found[mine] = flown_positions(simulator, env[mine] * simulator.count + number[mine], time[mine])
        return Vec3.of(found)

    def pole(self, env: Tensor, tick: Tensor) -> Vec3:
        """The Earth's axis [m] in N at ticks [m] of episodes [m]; it drifts by 1e-4 rad a year."""
        since = (tick - self.first[env]).double()
        return self.axis.map(lambda at, rate: at[env] + rate[env] * since, self.drift)

    def everybody(self, envs: Tensor, tick: Tensor) -> Tensor:
        """Margins of everybody who looks at anybody else, [n, S, S] m, at ticks [n] of episodes [n]."""
        n, s = len(envs), self.fleet.size
        env, satellite, at = envs.repeat_interleave(s), torch.arange(s, device=envs.device).repeat(n), tick.repeat_interleave(s)
        pole = self.pole(env, at)
        both = (Spots.of(self.positions(env, satellite, t), pole) for t in (at, (at - 1).clamp(min=0)))
        now, before = (spots.map(lambda x: x.view(n, 1, s)) for spots in both)
        rows = []
        for mine in torch.arange(s, device=envs.device).split(max(1, self.block // (n * s))):
            own = now.map(lambda x, mine=mine: x[..., mine].mT)  # type: ignore[misc]
            other = before.where(mine.unsqueeze(-1) < torch.arange(s, device=envs.device), now)
            rows.append(margin(own, other, None if self.reach is None else self.reach[envs][:, mine].unsqueeze(-1)))
        return torch.cat(rows, 1)

    def pairs(self, pairs: Pairs, tick: Tensor) -> Tensor:
        """The greater margin of each pair [m], m, at a tick [m] each."""
        env, i, j = pairs
        looks = (i, tick), (j, tick), (j, (tick - 1).clamp(min=0))
        r = self.positions(env.repeat(3), *(torch.cat(part) for part in zip(*looks, strict=True)))
        pole = self.pole(env, tick)
        first, second, before = (Spots.of(Vec3(*part), pole) for part in zip(*(x.chunk(3) for x in r), strict=True))
        reach = (None, None) if self.reach is None else (self.reach[env, i], self.reach[env, j])
        return torch.maximum(margin(first, before, reach[0]), margin(second, first, reach[1]))

    def seen(self, envs: Tensor) -> Tensor:
        """Which satellites of episodes ``envs`` [n] see one another at any tick, [n, S, S] booleans."""
        first, last, speed = self.first[envs], self.last[envs], self.speed[envs]
        ends = self.everybody(envs, first), self.everybody(envs, last)
        found = (ends[0] > 0.0) | (ends[1] > 0.0)
        found = (found | found.mT) & ~torch.eye(self.fleet.size, dtype=torch.bool, device=envs.device)
        speeds, length = torch.maximum(speed.unsqueeze(1), speed.unsqueeze(2)), (last - first).view(-1, 1, 1)
        may = (length > 1) & (ends[0] + ends[1] > -speeds * length)
        for part in torch.nonzero(((may | may.mT) & ~found).triu(1)).split(self.block):
            n, i, j = part.unbind(-1)
            at_first, at_last = (torch.maximum(end[n, i, j], end[n, j, i]) for end in ends)
            whole = Spans(torch.arange(len(n), device=n.device), first[n], last[n], at_first, at_last)
            found[n, i, j] = found[n, j, i] = self.within(Pairs(envs[n], i, j), speeds[n, i, j], whole)
        return found

    def within(self, pairs: Pairs, speed: Tensor, spans: Spans) -> Tensor:
        """Which pairs [p] have a positive margin inside one of the spans; margins change by at most ``speed`` [p] m a tick."""
        found = torch.zeros_like(pairs.env, dtype=torch.bool)
        while len(spans.pair):
            middle = (spans.first + spans.last) // 2
            there = self.pairs(pairs.of(spans.pair), middle)
            found[spans.pair[there > 0.0]] = True
            halves = spans._replace(last=middle, at_last=there), spans._replace(first=middle, at_first=there)
            spans = Spans(*(torch.cat(part) for part in zip(*halves, strict=True)))
            length = spans.last - spans.first
            may = (length > 1) & (spans.at_first + spans.at_last > -speed[spans.pair] * length) & ~found[spans.pair]
            spans = spans.of(torch.nonzero(may).squeeze(-1))
        return found


def in_sight(fleet: Fleet, asked: Tensor) -> Tensor:
    """Which satellites have seen one another since the present step began, [N, S, S] booleans; false where not ``asked`` [N].

    Logged are the ticks from that at which the step began to the last but one: recorders run before the modules do.

    Raises:
        RuntimeError: Where arcs have moved on so far that they do not cover the step any more.
    """
    first, last = fleet.since, torch.maximum(fleet.ticks - 1, fleet.since)
    seen = torch.zeros(fleet.num_envs, fleet.size, fleet.size, dtype=torch.bool, device=fleet.device)
    envs = torch.nonzero(asked & (fleet.ticks > first)).squeeze(-1)
    if fleet.size < 2 or not len(envs):
        return seen
    _check_covered(fleet, first, asked)
    lookout = Lookout(fleet, first, last)
    for some in envs.split(max(1, TOGETHER // fleet.size**2)):
        seen[some] = lookout.seen(some)
    return seen


def _check_covered(fleet: Fleet, first: Tensor, asked: Tensor) -> None:
    begin = torch.where(asked, (first - 1).clamp(min=0) * fleet.h, torch.inf)
    if any(bool((simulator.of_env(begin) < simulator.arcs.start).any()) for simulator in fleet.simulators):
        raise RuntimeError("arcs have moved on and hold the step's start no more: ask before anything looks ahead of its end")
