"""Traces: fields of satellites at every tick of a run, for what depends on several satellites at the same time.

Satellites of each type run in a separate kernel. A component that ``records`` fields leaves a trace of them; one that
``follows`` another satellite reads that one's trace, tick by tick, so the followed satellite runs first. What depends on
the motion of several satellites, such as the distance between them, is computed from their traces after a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from bsk_torch.codegen.kernel import Samples
from bsk_torch.constants import NANO
from bsk_torch.sim.component import Component, Field, Layout, Track
from bsk_torch.sim.names import nearest


def recorded(components: Sequence[Component]) -> tuple[Field, ...]:
    """Return the fields that the components of a model record, in the order in which they are first named.

    ValueError for a name that is not a field of the state.
    """
    fields = {field.name: field for component in components for field in component.state}
    names = dict.fromkeys(name for component in components for name in component.records)
    for name in names:
        if name not in fields:
            raise ValueError(f"records={name!r} is no field of the state; {nearest(name, fields)}")
    return tuple(fields[name] for name in names)


class Trace(NamedTuple):
    """Recorded fields of rows in a run: record k holds them k ticks after its start."""

    layout: Layout
    table: Tensor  # their values, [N, K + 1, C]; those behind the end of a row have no meaning
    start: Tensor  # ticks since reset at record 0, [N]

    @staticmethod
    def room(fields: Sequence[Field], start: Tensor, ticks: int) -> Trace:
        """Return a trace for runs of at most so many ticks, which begin at the ticks ``start`` [N]."""
        layout = Layout(fields)
        shape = len(start), ticks + 1, layout.size
        if start.device.type == "cpu":  # pages that are never touched take no memory
            return Trace(layout, torch.from_numpy(np.zeros(shape)), start)
        return Trace(layout, torch.zeros(shape, dtype=torch.float64, device=start.device), start)

    def after(self, ticks: int) -> Trace:
        """Return the part of the trace from so many ticks on, in the same memory."""
        return Trace(self.layout, self.table[:, ticks:], self.start + ticks)

    def read(self, name: str) -> Tensor:
        """Return a field, [N, K + 1], or [N, K + 1, width]."""
        where = self.layout.slices[name]
        return self.table[..., where.start] if self.layout.fields[name].width == 1 else self.table[..., where]

    def samples(self, h_ns: int, owner: Tensor) -> Samples:
        """Return the trace as samples of a track, one record a tick, for rows that follow the rows ``owner`` [n] of the trace."""
        # records are looked up half a tick after their time, where no rounding of time moves them to a neighbor
        return Samples(self.table, (self.start.double() - 0.5) * (h_ns * NANO), owner)


class Flight(NamedTuple):
    """A run of some episodes, with the traces of all types of satellites."""

    envs: Tensor
    since: Tensor  # ticks since reset at its start, [n]
    ticks: Tensor  # ticks that it took, [n]
    remaining: Tensor  # ticks to the end of the episode, [n]: there the clock stops before any event is evaluated
    # trace of each type of satellites, of the rows of these episodes; None for one that records nothing
    traces: tuple[Trace | None, ...]
    counts: tuple[int, ...]  # number of satellites of each type in an episode

    def read(self, k: int, name: str) -> Tensor:
        """Return a field of the satellites of type k, [n, count, K + 1], or [n, count, K + 1, width]."""
        trace, count = self.traces[k], self.counts[k]
        if trace is None or name not in trace.layout.fields:
            raise ValueError(f"satellites of type {k} do not record {name!r}; list it in records of one of their components")
        values = trace.read(name)
        return values.view(len(self.envs), count, *values.shape[1:])


class TrackSource(Protocol):
    """Supplies the samples of a track to the N satellites of a simulation; see ``Simulator.sources``."""

    def reach(self, time: Tensor) -> None:
        """Make the samples of runs from now on reach ``time`` [N] s."""

    def samples(self) -> Samples:
        """Return the samples for all N rows."""


def no_samples(track: Track, rows: int, device: torch.device) -> Samples:
    """Return samples for N rows where nothing supplies them: zeros."""
    table = torch.zeros(1, track.count, track.width, dtype=torch.float64, device=device)
    return Samples(table, table.new_zeros(1), torch.zeros(rows, dtype=torch.int64, device=device))
