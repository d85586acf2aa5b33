"""Search for lines of sight between the satellites of an episode, as logs of Basilisk's SpacecraftLocation find them.

In every tick, Basilisk's module of satellite i evaluates satellite j at its position after that tick if j comes first in the
episode, and at its position a tick earlier otherwise.

Ticks are not evaluated one by one. The margin f of a pair (see :func:`.line_of_sight.visibility_margin`), positive if one of the
two is visible from the other, changes per tick by at most the distance v that the faster one flies. So in an interval of ticks
[a, b]

    f(t) <= (f(a) + f(b)) / 2 + v (b - a) / 2,

and if ``f(a) + f(b) <= -v (b - a)``, there is no line of sight within. All other intervals are halved.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import position, positions
from bsk_torch.astro.sight import POLAR_STRETCH
from bsk_torch.codegen.kernel import Kernel, Samples
from bsk_torch.codegen.stored import stored_kernel
from bsk_torch.constants import NANO
from bsk_torch.sim.access.links.line_of_sight import SatellitePositions, visibility_margin
from bsk_torch.sim.component import Bus, neighbours
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, orient_pole, put_track
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.builder import ARC, KernelBuilder
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING
from bsk_torch.vec3 import Vec3

PAIRS_PER_BLOCK, DEVICE_PAIRS_PER_BLOCK = 1 << 15, 1 << 22
"""Pairs evaluated together: on the CPU, so that they fit into its cache, and on other devices, which memory limits."""

PAIRS_PER_BATCH = 1 << 22  # pairs of which margins are kept together, unless one episode has more


class FlownOrbits(NamedTuple):
    """Flown orbits of the satellites of one type, ``count`` in each of N episodes."""

    arcs: Arcs
    columns: Tensor  # their numbers among the S satellites of an episode, [count]
    max_range: Tensor  # range of their sensors, [N * count] m; no limit if it is not positive
    max_speed: Tensor  # bound of their speeds, [N * count] m/s
    use_kernels: bool
    # those that take part in their episodes, [N * count]; None if all do. The arcs of the others do not cover the searched
    # ticks.
    present: Tensor | None = None

    def positions(self, rows: Tensor, time: Tensor) -> Tensor:
        """Return positions in N, [m, 3] m, of rows [m], which may repeat, at times [m] s since reset that the arcs cover."""
        return flown_positions(self.arcs, rows, time, self.use_kernels)


def flown_positions(arcs: Arcs, rows: Tensor, time: Tensor, use_kernels: bool) -> Tensor:
    """Return positions in N, [m, 3] m, of rows [m] of arcs at times [m] s since reset; see :meth:`FlownOrbits.positions`."""
    path = Samples(arcs.flown, arcs.start - LEAD_NODES * NODE_SPACING, rows)
    if use_kernels:
        state = time.expand(4, -1).clone()
        flown_position_kernel()(state, 1, (path,))
        return state[1:].mT
    nodes, tau = neighbours(ARC, path.table, rows, time - path.start[rows])
    return positions(nodes, tau * (1.0 / NODE_SPACING))


@stored_kernel
def flown_position_kernel() -> Kernel:
    """Return the kernel of positions on the flown arc; its state is the time and the position."""
    builder = KernelBuilder()
    (time,) = builder.planes("state", 1)
    return Kernel("flown positions", builder.loop([time, *position(*builder.path(1))], [], (ARC,), time))


def pole_directions(arcs: Arcs, rows: Tensor, time: Tensor, h_ns: int) -> Tensor:
    """Return the Earth's axis in N, [m, 3], at times [m] s since the reset of rows [m], which may repeat."""
    records, tau = neighbours(EPHEMERIS_TRACK, arcs.ephemeris, rows, time - arcs.start[rows])
    bus = Bus(h_ns)
    put_track(bus, EPHEMERIS_TRACK, records.flatten(1).unbind(-1), tau)
    orient_pole(bus)
    return bus.EN.z.stack()


class SatellitePairs(NamedTuple):
    """Pairs of satellites: episode, number of the first and of the second satellite, which comes later, [m] each."""

    env: Tensor
    i: Tensor
    j: Tensor

    def take(self, index: Tensor) -> SatellitePairs:
        """Return the pairs ``index``, which may repeat."""
        return SatellitePairs(self.env[index], self.i[index], self.j[index])


Margins = Callable[[SatellitePairs, Tensor], Tensor]  # returns the margins of pairs, [m] m, at a tick [m] each


class TickIntervals(NamedTuple):
    """Intervals of ticks: number of the pair, first and last tick, and the margins at these, [m] each."""

    pair: Tensor
    first: Tensor
    last: Tensor
    margin_first: Tensor
    margin_last: Tensor


class LineOfSightSearch:
    """Search among the S satellites of N episodes during ticks ``first`` to ``last`` [N] of each episode."""

    def __init__(self, types: Sequence[FlownOrbits], first: Tensor, last: Tensor, h_ns: int) -> None:
        """Gather ranges, [N, S] m, speeds, [N, S] m per tick in stretched coordinates, and the Earth's axis.

        The ticks ``first`` to ``last`` [N], of ``h_ns`` nanoseconds, of each episode are searched.
        """
        self.types, self.first, self.last, self.h_ns = types, first, last, h_ns
        self.size = sum(len(part.columns) for part in types)
        columns = torch.cat([part.columns for part in types])
        numbers = torch.cat([torch.arange(len(part.columns), device=first.device) for part in types])
        self.number_in_type = torch.empty_like(columns).index_copy_(0, columns, numbers)
        max_range = self._by_satellite([part.max_range for part in types])
        self.max_range = torch.where(max_range > 0.0, max_range, torch.inf)
        self.speed = self._by_satellite([part.max_speed for part in types]) * (POLAR_STRETCH * (h_ns * NANO))
        present = [part.present for part in types if part.present is not None]
        self.present = self._by_satellite(present) if present else None
        start, end = (self._poles(tick) for tick in (first, last))
        self.pole_start = Vec3.of(start)
        self.pole_rate = Vec3.of((end - start) / (last - first).clamp(min=1).unsqueeze(-1))
        self.block = PAIRS_PER_BLOCK if first.device.type == "cpu" else DEVICE_PAIRS_PER_BLOCK

    def _by_satellite(self, parts: Sequence[Tensor]) -> Tensor:
        """Return values [N, S] from those of each type, [N * count]."""
        joined = parts[0].new_empty(len(self.first), self.size)
        for part, values in zip(self.types, parts, strict=True):
            joined[:, part.columns] = values.reshape(len(self.first), -1)
        return joined

    def _poles(self, tick: Tensor) -> Tensor:
        """Return the Earth's axis in N, [N, 3], at ticks [N], by the ephemeris of the first satellite that is present."""
        envs, poles = torch.arange(len(tick), device=tick.device), None
        for part in reversed(self.types if self.present is not None else self.types[:1]):
            rows = envs * len(part.columns)
            if part.present is None:
                poles = pole_directions(part.arcs, rows, self._time(tick), self.h_ns)
                continue
            is_present = part.present.view(len(tick), -1)
            of_type = pole_directions(part.arcs, rows + is_present.long().argmax(1), self._time(tick), self.h_ns)
            poles = of_type if poles is None else torch.where(is_present.any(1, keepdim=True), of_type, poles)
        assert poles is not None
        return poles

    def _time(self, tick: Tensor) -> Tensor:
        return (tick * self.h_ns).double() * NANO

    def _positions(self, env: Tensor, satellite: Tensor, tick: Tensor) -> Vec3:
        """Return positions in N, m, of satellites [m] of episodes [m] at ticks [m]."""
        time, number = self._time(tick), self.number_in_type[satellite]
        if len(self.types) == 1:
            return Vec3.of(self.types[0].positions(env * self.size + number, time))
        r_BN_N = time.new_empty(len(time), 3)
        for part in self.types:
            rows = torch.nonzero(torch.isin(satellite, part.columns)).squeeze(-1)
            r_BN_N[rows] = part.positions(env[rows] * len(part.columns) + number[rows], time[rows])
        return Vec3.of(r_BN_N)

    def _pole(self, env: Tensor, tick: Tensor) -> Vec3:
        """Return the Earth's axis in N at ticks [m] of episodes [m]; it moves by 1e-4 rad a year, so it is interpolated."""
        since, row = (tick - self.first[env]).double(), operator.itemgetter(env)
        return self.pole_start.map(row) + self.pole_rate.map(row) * since

    def all_margins(self, envs: Tensor, tick: Tensor) -> Tensor:
        """Return the margins of all ordered pairs, [n, S, S] m by sensor and other satellite, at ticks [n] of episodes [n]."""
        n, s = len(envs), self.size
        env, satellite, at = envs.repeat_interleave(s), torch.arange(s, device=envs.device).repeat(n), tick.repeat_interleave(s)
        pole = self._pole(env, at)
        by_episode = operator.methodcaller("view", n, 1, s)
        now = SatellitePositions.of(self._positions(env, satellite, at), pole).map(by_episode)
        before = SatellitePositions.of(self._positions(env, satellite, (at - 1).clamp(min=0)), pole).map(by_episode)
        rows = []
        for columns in torch.arange(s, device=envs.device).split(max(1, self.block // (n * s))):
            one = now.map(lambda x, columns=columns: x[..., columns].mT)  # type: ignore[misc]
            other = before.where(columns.unsqueeze(-1) < torch.arange(s, device=envs.device), now)
            rows.append(visibility_margin(one, other, self.max_range[envs][:, columns].unsqueeze(-1)))
        return torch.cat(rows, 1)

    def pair_margins(self, pairs: SatellitePairs, tick: Tensor) -> Tensor:
        """Return the larger one of the two margins of each pair, [m] m, at a tick [m] each."""
        env, i, j = pairs
        ticks = torch.cat([tick, tick, (tick - 1).clamp(min=0)])
        r_BN_N, pole = self._positions(env.repeat(3), torch.cat([i, j, j]), ticks), self._pole(env, tick)
        thirds = zip(*[x.chunk(3) for x in r_BN_N], strict=True)
        first, second, before = [SatellitePositions.of(Vec3(*part), pole) for part in thirds]
        max_range = self.max_range[env, i], self.max_range[env, j]
        return torch.maximum(visibility_margin(first, before, max_range[0]), visibility_margin(second, first, max_range[1]))

    def view_margins(self, views: SatellitePairs, tick: Tensor) -> Tensor:
        """Return the margins of pairs of a sensor ``i`` and another satellite ``j``, in any order, [m] m, at a tick [m] each."""
        env, i, j = views
        looks = (i, tick), (j, torch.where(i < j, (tick - 1).clamp(min=0), tick))
        r_BN_N = self._positions(env.repeat(2), *(torch.cat(part) for part in zip(*looks, strict=True)))
        halves = zip(*(x.chunk(2) for x in r_BN_N), strict=True)
        pole = self._pole(env, tick)
        one, other = (SatellitePositions.of(Vec3(*part), pole) for part in halves)
        return visibility_margin(one, other, self.max_range[env, i])

    def visible_pairs(self, envs: Tensor, directed: bool = False) -> Tensor:
        """Return the pairs with a line of sight at any tick of episodes ``envs`` [n]; [n, S, S] booleans.

        With ``directed`` the result is that of each sensor, [n, sensor, other], else that of either sensor of a pair.
        """
        first, last, speed = self.first[envs], self.last[envs], self.speed[envs]
        ends = self.all_margins(envs, first), self.all_margins(envs, last)
        if not directed:
            ends = torch.maximum(ends[0], ends[0].mT), torch.maximum(ends[1], ends[1].mT)
        others = ~torch.eye(self.size, dtype=torch.bool, device=envs.device)
        is_visible = ((ends[0] > 0.0) | (ends[1] > 0.0)) & others
        speeds, length = torch.maximum(speed.unsqueeze(1), speed.unsqueeze(2)), (last - first).view(-1, 1, 1)
        possible = (length > 1) & (ends[0] + ends[1] > -speeds * length) & others
        if self.present is not None:
            both = self.present[envs].unsqueeze(1) & self.present[envs].unsqueeze(2)
            is_visible, possible = is_visible & both, possible & both
        possible &= ~is_visible
        margins = self.view_margins if directed else self.pair_margins
        for part in torch.nonzero(possible if directed else possible.triu(1)).split(self.block):
            n, i, j = part.unbind(-1)
            numbers = torch.arange(len(n), device=n.device)
            whole = TickIntervals(numbers, first[n], last[n], *(end[n, i, j] for end in ends))
            is_visible[n, i, j] = self._search(SatellitePairs(envs[n], i, j), speeds[n, i, j], whole, margins)
        return is_visible if directed else is_visible | is_visible.mT

    def _search(self, pairs: SatellitePairs, speed: Tensor, intervals: TickIntervals, margins: Margins) -> Tensor:
        """Return the pairs, [p] booleans, with a positive margin inside one of the intervals.

        Margins change by at most ``speed`` [p] m a tick; see the formula at the top of the module.
        """
        is_visible = torch.zeros_like(pairs.env, dtype=torch.bool)
        while len(intervals.pair):
            middle = (intervals.first + intervals.last) // 2
            margin = margins(pairs.take(intervals.pair), middle)
            is_visible[intervals.pair[margin > 0.0]] = True
            halves = (intervals._replace(last=middle, margin_last=margin), intervals._replace(first=middle, margin_first=margin))
            intervals = TickIntervals(*map(torch.cat, zip(*halves, strict=True)))
            length = intervals.last - intervals.first
            total = intervals.margin_first + intervals.margin_last
            possible = (length > 1) & (total > -speed[intervals.pair] * length) & ~is_visible[intervals.pair]
            index = torch.nonzero(possible).squeeze(-1)
            intervals = TickIntervals(*[part[index] for part in intervals])
        return is_visible
