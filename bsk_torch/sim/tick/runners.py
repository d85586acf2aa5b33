"""Repeat the tick until each row's own end.

The longest duration of each row is known when a step starts; a tick that stops (see :class:`bsk_torch.sim.tick.loop.Tick`) may
end it earlier, and with it the other satellites of its episode. Kernels work on blocks of rows with similar durations; elsewhere
a loop over ticks holds the rows that have ended. It does not wait for the device while it runs, unless ticks may stop: then once
in :data:`CHECK_EVERY` ticks, whether there is any row left.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypedDict

import torch
from torch import Tensor

from bsk_torch.codegen.inductor import BACKENDS, just_in_time
from bsk_torch.codegen.ir import UntraceableError
from bsk_torch.codegen.kernel import Kernel, Samples
from bsk_torch.sim.tick.loop import Tick

logger = logging.getLogger(__name__)

CHECK_EVERY = 64  # number of ticks between two checks whether all rows have ended


WORK = 2**23
"""Ticks of rows that a thread runs in one call of a kernel: about a third of a second, in which Ctrl-C has to wait."""

LANES = 8  # rows that take as long as one


def ticks_at_once(rows: int) -> int:
    """Return the number of ticks, at least 2, that a kernel runs of so many rows in one call."""
    return max(2, WORK * torch.get_num_threads() // max(rows, LANES))


class RunInputs(TypedDict):
    """What a run of n rows reads apart from their fields; see :meth:`bsk_torch.codegen.kernel.Kernel.__call__`."""

    tracks: Sequence[Samples]
    shared: Tensor
    own: Tensor
    mode: Tensor
    flags: Tensor
    ticks: Tensor
    nanoseconds: int
    lockstep: int
    present: Tensor | None


class Runners(NamedTuple):
    """What runs ticks, and the tick at time zero, once for each row, as :meth:`bsk_torch.codegen.kernel.Kernel.__call__` does."""

    run: Kernel | TickLoop
    first_tick: Kernel | Callable[..., Tensor]

    def build(self, lockstep: int) -> None:
        """Build kernels for groups of ``lockstep`` rows that end together, where they are not there yet."""
        for runner in self:
            if isinstance(runner, Kernel):
                runner.build(lockstep)


def make_runners(tick: Tick, backend: str, device: torch.device, lockstep: int = 1) -> Runners:
    """Return the runners of ``tick`` under a back end; ValueError for an unknown one.

    Runs in groups of other sizes than ``lockstep`` may have to wait for the compiler.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend={backend!r} must be one of {list(BACKENDS)}")
    if backend == "compiled" and device.type == "cpu":
        try:
            return Runners(*(tick.kernel(wakes, lockstep) for wakes in (False, True)))
        except UntraceableError as error:
            logger.warning("%s; the tick is compiled by inductor instead, which is slower", error)
    step: Callable[..., Any] = tick.step
    if backend == "compiled":
        step = just_in_time(step, "tick")
    recorded = torch.tensor(tick.recorded_planes, dtype=torch.int64, device=device)
    return Runners(TickLoop(step, tick.stops, recorded), functools.partial(_first_tick, tick))


def _first_tick(
    tick: Tick,
    state: Tensor,
    counts: Tensor,
    tracks: Sequence[Samples],
    *,
    shared: Tensor,
    own: Tensor,
    mode: Tensor,
    flags: Tensor,
    ticks: Tensor,
    **_: object,
) -> Tensor:
    """Run the tick at time zero on tensors, as :meth:`bsk_torch.codegen.kernel.Kernel.__call__` runs a kernel."""
    tables, starts = _of_rows([t.table for t in tracks], tracks), _of_rows([t.start for t in tracks], tracks)
    planes = tick.wake(tick.inputs(state, shared, own, flags[:, mode], tables, starts, ticks.double()))
    state.copy_(torch.stack([plane.expand(len(counts)).double() for plane in planes]))
    return counts


class TickLoop:
    """A loop over ticks that holds the rows that have ended; shapes never change, so that graphs can be replayed."""

    def __init__(self, step: Callable[..., tuple[Tensor, Tensor]], stops: bool = False, recorded: Tensor | None = None) -> None:
        """Repeat ``step``, see :meth:`bsk_torch.sim.tick.loop.Tick.step`, which may stop rows if it ``stops``.

        Planes that are ``recorded``, indices [R], are written in every tick.
        """
        self.step, self.stops, self.recorded, self.ticks_run = step, stops, recorded, 0

    def __call__(
        self,
        state: Tensor,
        counts: Tensor,
        tracks: Sequence[Samples],
        *,
        shared: Tensor,
        own: Tensor,
        mode: Tensor,
        flags: Tensor,
        ticks: Tensor,
        lockstep: int = 1,
        written: Tensor | None = None,
        present: Tensor | None = None,
        longest: int | None = None,
        **_: object,
    ) -> Tensor:
        """Run the tick as :meth:`bsk_torch.codegen.kernel.Kernel.__call__` runs a kernel; ``longest`` is the largest count."""
        runs = counts if present is None else torch.where(present, counts, 0)
        flags, end, now = flags[:, mode], (ticks + runs).double(), ticks.double()
        samples = *_of_rows([t.table for t in tracks], tracks), *_of_rows([t.start for t in tracks], tracks)
        planes = state
        longest = int(runs.max()) if longest is None else longest
        self.ticks_run += longest
        for k in range(longest):
            if self.stops and k and k % CHECK_EVERY == 0 and not bool((now < end).any()):
                break
            now = now + 1.0
            planes, end = self.step(planes, shared, own, flags, now, end, *samples)
            if written is not None:
                written[:, k] = torch.where((now <= end).unsqueeze(1), planes[self.recorded].mT, written[:, k])
            if self.stops and lockstep > 1:
                end = earliest(end, lockstep, present)
        state.copy_(planes)
        if not self.stops:
            return counts
        ran = end.long() - ticks
        return ran if present is None else earliest(torch.where(present, ran, counts), lockstep)


def _of_rows(parts: Sequence[Tensor], tracks: Sequence[Samples]) -> list[Tensor]:
    """Return parts of tracks, one for each row of a run: those of the rows' owners, where they have any."""
    return [part if track.owner is None else part[track.owner] for part, track in zip(parts, tracks, strict=True)]


def earliest(end: Tensor, lockstep: int, present: Tensor | None = None) -> Tensor:
    """Return the first ``end`` [N] of each episode for all of its ``lockstep`` rows; rows that are not present keep theirs."""
    if present is None:
        return end.view(-1, lockstep).amin(1).repeat_interleave(lockstep)
    return torch.where(present, earliest(torch.where(present, end, torch.inf), lockstep), end)
