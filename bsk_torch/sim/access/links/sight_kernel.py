"""Search for lines of sight between the satellites of one type by a kernel, which looks at ordered pairs one by one.

The margin f of a pair changes by at most v a tick, the distance that the faster one flies (see
:mod:`bsk_torch.sim.access.links.line_of_sight_search`). So after a tick with ``f <= 0``, it is positive ``-f / v`` ticks later at
the earliest, which is the next tick to look at.
"""

from __future__ import annotations

import dataclasses
from functools import cache, lru_cache
from typing import NamedTuple, cast

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import position
from bsk_torch.astro.sight import POLAR_STRETCH
from bsk_torch.codegen.ir import Value
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.constants import NANO
from bsk_torch.sim.access.links.line_of_sight import SatellitePositions, speed_bound, visibility_margin
from bsk_torch.sim.component import Bus
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, orient_pole, put_track
from bsk_torch.sim.orbit.builder import ARC, KernelBuilder
from bsk_torch.sim.orbit.grid import NODE_SPACING

PAIRS_AT_ONCE = 1 << 18  # pairs whose orbits are gathered at once, 30 MB


class OrderedPairs(NamedTuple):
    """Pairs of a sensor and another satellite.

    Attributes:
        env: Episode, [m].
        i: Row of the satellite with the sensor, [m].
        j: Row of the other one, [m].
        later: 1.0 where the sensor's satellite comes first in the episode, and sees the other one a tick late, [m].
        apart: False for a satellite and itself, [m].
    """

    env: Tensor
    i: Tensor
    j: Tensor
    later: Tensor
    apart: Tensor

    def after(self, envs: int, satellites: int) -> OrderedPairs:
        """Return the same pairs so many episodes later, each with so many ``satellites``."""
        if not envs:
            return self
        return self._replace(env=self.env + envs, i=self.i + envs * satellites, j=self.j + envs * satellites)


@lru_cache(maxsize=8)
def ordered_pairs(num_envs: int, satellites: int) -> OrderedPairs:
    """Return all pairs of ``satellites`` of one type in each episode, [num_envs * satellites * satellites]."""
    with torch.inference_mode(False):
        rows = torch.arange(num_envs * satellites).view(num_envs, satellites)
        i, j = rows.repeat_interleave(satellites, 1).flatten(), rows.repeat(1, satellites).flatten()
        return OrderedPairs(i // satellites, i, j, (i < j).double(), i != j)


@cache
def sight_kernel() -> Kernel:
    """Return the kernel of the search: in each tick, it looks at a pair and moves on; a row stops at a sight, or at its end.

    Its state is the time, s, the tick, and 1 for a sight. A sensor whose satellite comes first in the episode sees the other one
    where it was a tick earlier, except at tick zero.
    """
    builder, bus = KernelBuilder(), Bus(0)
    time, tick, _ = builder.planes("state", 3)
    r_i, v_i, r_j, v_j = builder.vectors("own", 4)
    max_range, later, last = builder.planes("own", 3, first=12)
    h_ns = builder.number("shared", 0)
    h = h_ns * NANO
    put_track(bus, EPHEMERIS_TRACK, builder.records(1, EPHEMERIS_TRACK.count * EPHEMERIS_TRACK.width), builder.tau(1))
    orient_pole(bus)
    (path_i, s_i), (path_j, s_j) = builder.path(2), builder.path(3)
    s_j = s_j - torch.where(tick > 0.5, later * h * (1.0 / NODE_SPACING), torch.zeros_like(tick))
    one, other = (SatellitePositions.of(position(*at), bus.EN.z) for at in ((path_i, s_i), (path_j, s_j)))
    margin = visibility_margin(one, other, torch.where(max_range > 0.0, max_range, torch.inf))
    speed = torch.maximum(speed_bound(r_i, v_i), speed_bound(r_j, v_j)) * POLAR_STRETCH * h
    after = tick + torch.floor(-margin / speed) + 1.0
    sees = margin > 0.0
    loop = builder.loop(
        [after * h_ns * NANO, after, torch.where(sees, 1.0, torch.zeros_like(tick))], [], (EPHEMERIS_TRACK, ARC, ARC), time
    )
    return Kernel("lines of sight", dataclasses.replace(loop, stop=cast("Value", sees | (after > last))))
