"""Repeat the tick until each environment's own end.

The longest duration of each is known when a step starts; a tick that stops (see :class:`bsk_torch.sim.tick.Tick`) may end it
earlier, and with it the other satellites of its team. Kernels work on blocks of rows with similar durations and end each row, or
team, at its own tick; elsewhere a loop over ticks holds the rows that have ended. It asks the device for nothing while it runs,
unless ticks may stop: then once in :data:`PATIENCE` ticks, whether there is any row left.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.lanes.expr import UntraceableError
from bsk_torch.lanes.loop import Loop, Samples
from bsk_torch.sim.compiler import BACKENDS, just_in_time
from bsk_torch.sim.tick import Tick

logger = logging.getLogger(__name__)

PATIENCE = 64
"""Ticks between two questions whether all rows have ended."""


@dataclass(frozen=True)
class Flight:
    """What a run starts from.

    ``state`` [C, N], which the run changes, ``shared`` [C, 1] and ``own`` [C, N] are float64 packs; ``mode`` [N] chooses
    columns of the flag table ``flags`` [F, M]; ``ticks`` [N] is the number of ticks since reset; ``tracks`` are known in advance.
    ``order`` [N] is the number of ticks to be expected, where stops make it differ from the longest; a matter of speed only.
    Every ``team`` rows, from the first on, fly in one episode: they have run as many ticks, are to run as many, and end in the
    tick in which the first of them stops.
    """

    state: Tensor
    shared: Tensor
    own: Tensor
    mode: Tensor
    flags: Tensor
    ticks: Tensor
    tracks: tuple[Samples, ...]
    order: Tensor | None = None
    team: int = 1


Runner = Callable[[Flight, Tensor], Tensor]
"""Runs each row of a flight for its number of ticks [N] or until it stops; the number of ticks that each has run, [N]."""


class Runners(NamedTuple):
    """What repeats ticks, and what does the tick at time zero, once for each row."""

    run: Runner
    wake: Runner


def make_runners(tick: Tick, backend: str, device: torch.device, team: int = 1) -> Runners:
    """What runs ``tick`` under a back end; flights of other teams than ``team`` may have to wait for the compiler."""
    if backend not in BACKENDS:
        raise ValueError(f"backend={backend!r} must be one of {list(BACKENDS)}")
    if backend == "compiled" and device.type == "cpu":
        try:
            return Runners(*(kernel_loop(tick.kernel(wakes, team), tick.h_ns) for wakes in (False, True)))
        except UntraceableError as error:
            logger.warning("%s; the tick is compiled by inductor instead, which is slower", error)
    step: Callable[..., Any] = tick.step
    if backend == "compiled":
        step = just_in_time(step, "tick")
    return Runners(loop(step, tick.stops), waking(tick))


def waking(tick: Tick) -> Runner:
    """The tick at time zero on tensors."""

    def wake(flight: Flight, counts: Tensor) -> Tensor:
        tables, starts = [track.table for track in flight.tracks], [track.start for track in flight.tracks]
        packs = flight.state, flight.shared, flight.own, flight.flags[:, flight.mode]
        planes = tick.wake(tick.inputs(*packs, tables, starts, flight.ticks.double()))
        flight.state.copy_(torch.stack([plane.expand(len(counts)).double() for plane in planes]))
        return counts

    return wake


def loop(step: Callable[..., tuple[Tensor, Tensor]], stops: bool = False) -> Runner:
    """A loop over ticks that holds the rows that have ended: shapes never change, so that graphs can be replayed."""

    def run(flight: Flight, counts: Tensor) -> Tensor:
        flags, end, now = flight.flags[:, flight.mode], (flight.ticks + counts).double(), flight.ticks.double()
        tracks = *(t.table for t in flight.tracks), *(t.start for t in flight.tracks)
        state = flight.state
        for k in range(int(counts.max())):
            if stops and k and k % PATIENCE == 0 and not bool((now < end).any()):
                break
            now = now + 1.0
            state, end = step(state, flight.shared, flight.own, flags, now, end, *tracks)
            if stops and flight.team > 1:
                end = earliest(end, flight.team)
        flight.state.copy_(state)
        return end.long() - flight.ticks if stops else counts

    return run


def earliest(end: Tensor, team: int) -> Tensor:
    """The first ``end`` [N] of each team, for all of its rows."""
    return end.view(-1, team).amin(1).repeat_interleave(team)


def kernel_loop(kernel: Loop, h_ns: int) -> Runner:
    """A kernel of a tick of ``h_ns`` nanoseconds."""

    def run(flight: Flight, counts: Tensor) -> Tensor:
        return kernel(
            flight.state,
            counts,
            flight.tracks,
            order=flight.order,
            shared=flight.shared,
            own=flight.own,
            mode=flight.mode,
            flags=flight.flags,
            ticks=flight.ticks,
            nanoseconds=h_ns,
            team=flight.team,
        )

    return run
