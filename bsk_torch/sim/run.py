"""Repeat the tick until each environment's own end.

Durations are known when a step starts, so rows are sorted by the time that they have left and the loop works on a shrinking front
part. Sun, Earth and orbit are looked up once a minute, counted from the start of the step: what a row sees never depends on when
others end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from bsk_torch.constants import NANO
from bsk_torch.sim.tick import Step

SEGMENT = 60.0
"""Seconds after which Sun, Earth and orbit are looked up again."""

SHORTEST_CUT = 10
"""Ticks that a loop has at least, where enough are left; rows that end inside it are held by their count."""

FEWEST_ROWS = 2
"""Rows that a call has at least: the compiler specialises a batch of one."""

SegmentMaker = Callable[[Tensor, float], tuple[Tensor, Tensor, Tensor]]


def loops(counts: list[int], start: int, longest: int) -> Iterator[tuple[int, int, int]]:
    """Cut the segment that begins at tick ``start`` into loops: first tick, end, and the number of rows still running.

    ``counts`` are the rows' numbers of ticks in descending order; the segment has at most ``longest`` ticks.
    """
    stop, rows = min(counts[0], start + longest), len(counts)
    while start < stop:
        while counts[rows - 1] <= start:
            rows -= 1
        wanted = min(start + SHORTEST_CUT, stop)
        end = min(next(c for c in reversed(counts[:rows]) if c >= wanted), stop)
        yield start, end, rows
        start = end


def pulse_reaches(ticks: Tensor, count: int, h_ns: int) -> Tensor:
    """Whether a pulse commanded one tick before each of the next ``count`` ticks reaches the integrator, [count, n].

    Basilisk compares the pulse's end with the time of the next Runge-Kutta stage, both rounded to doubles of seconds; it is
    missed where rounding puts the end first.
    """
    number = ticks + torch.arange(1, count + 1, device=ticks.device).unsqueeze(-1)
    written, stage = (((number - k) * h_ns).double() * NANO for k in (1, 0))
    return (written + h_ns * NANO >= stage).double()


def run(step: Step, state: Tensor, shared: Tensor, own: Tensor, make: SegmentMaker, ticks: Tensor, h_ns: int) -> Tensor:
    """State [C, N] after each row has run its number of ticks ``ticks`` [N].

    Args:
        step: The tick, see :meth:`bsk_torch.sim.tick.Tick.step`.
        state: State pack [C, N]; not modified.
        shared: Shared parameters.
        own: Own parameters [C, N].
        make: Gives, for rows and the seconds since the start of the step at which a segment starts, the rows' flags, their
            segment pack, and their tick counters at the start of the step.
        ticks: Number of ticks of each row, int64 [N].
        h_ns: Tick, nanoseconds.
    """
    order = torch.argsort(ticks, descending=True, stable=True)
    counts = ticks[order].tolist()
    h, longest = h_ns * NANO, max(1, int(SEGMENT / (h_ns * NANO) + 1e-9))
    numbers = torch.arange(1, longest + 1, device=state.device, dtype=torch.float64)
    clocks = torch.stack([numbers * h, numbers], -1).to(state.dtype)
    state, own = state[:, order], own[:, order]
    for first in range(0, counts[0], longest):
        running = sum(count > first for count in counts)
        rows = torch.cat([order[:running], order[:1].expand(max(0, FEWEST_ROWS - running))])
        flags, segment, clock_ticks = make(rows, first * h)
        left = (ticks[rows] - first).to(state.dtype)
        reaches = pulse_reaches(clock_ticks + first, longest, h_ns).to(state.dtype)
        each = torch.stack([left.expand_as(reaches), reaches], 1)
        for start, end, n in loops(counts[:running], first, longest):
            front = _front(state, n)
            packs = shared, *(_front(pack, n) for pack in (own, flags, segment))
            columns = each[..., : front.shape[1]].contiguous()  # other strides would be another graph
            for k in range(start - first, end - first):
                front = step(front, *packs, clocks[k], columns[k])
            state[:, :n] = front[:, :n]
    result = torch.empty_like(state)
    result[:, order] = state
    return result


def _front(pack: Tensor, rows: int) -> Tensor:
    """The first rows of a pack, at least :data:`FEWEST_ROWS` of them, as a tensor of their own."""
    front = pack[:, :rows]
    return torch.cat([front, front[:, :1]], 1) if rows < FEWEST_ROWS else front.contiguous()
