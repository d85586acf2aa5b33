"""Kernels that repeat ticks, as Python sees them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.lanes import kernel
from bsk_torch.lanes.emit import SIGNATURE, TrackShape, loop_source
from bsk_torch.lanes.expr import Plane, Program
from bsk_torch.lanes.team import TEAM_SIGNATURE, check_teams, in_groups, team_source


class Samples(NamedTuple):
    """A track's records: ``table`` [N, R, C], and time ``start`` [N], s, of the first one.

    ``owner`` is the row of both for each row of a run, where they are not the same.
    """

    table: Tensor
    start: Tensor
    owner: Tensor | None = None


class Entry(NamedTuple):
    """A library: rows in a block, and its function."""

    width: int
    run: Callable[..., None]

    @staticmethod
    def of(source: str, name: str, signature: str) -> Entry:
        """Build the library, or load it; ``name`` says in messages what is being compiled."""
        library = kernel.load(source, name)
        return Entry(library.lanes_width(), kernel.entry(library, signature))


class Loop:
    """A kernel that repeats a tick; see :func:`bsk_torch.lanes.emit.loop_source`."""

    def __init__(
        self,
        name: str,
        program: Program,
        outputs: Sequence[Plane],
        tracks: Sequence[TrackShape],
        written: Sequence[Plane] = (),
        clock: str = "ticks",
        schedule: int = 0,
        stop: Plane | None = None,
        team: int = 1,
    ) -> None:
        """Build the kernel for runs of such a ``team``, or load it; ``name`` says in messages what is being compiled.

        A kernel with a stop has another library for teams of more than one; the other one of the two is built when it is needed.
        """
        self.name, self.tracks, self.stops = name, tuple(tracks), stop is not None
        self._source = program, outputs, tracks, kernel.INCLUDE, written, clock, schedule, stop
        self._entry(team)

    @cached_property
    def alone(self) -> Entry:
        """The library in which every row has an end of its own."""
        return Entry.of(loop_source(*self._source), self.name, SIGNATURE + "pppi" * len(self.tracks))

    @cached_property
    def together(self) -> Entry:
        """The library in which the rows of a team end together."""
        program, outputs, tracks, header, _, clock, schedule, stop = self._source
        if stop is None:
            raise ValueError(f"the {self.name} has no stop: its rows cannot end together")
        source = team_source(program, outputs, tracks, header, clock, schedule, stop)
        return Entry.of(source, f"{self.name} of teams", TEAM_SIGNATURE + "pppi" * len(self.tracks))

    def _entry(self, team: int) -> Entry:
        return self.together if self.stops and team > 1 else self.alone

    def __call__(
        self,
        state: Tensor,
        counts: Tensor | int,
        tracks: Sequence[Samples],
        *,
        order: Tensor | None = None,
        shared: Tensor | None = None,
        own: Tensor | None = None,
        mode: Tensor | None = None,
        flags: Tensor | None = None,
        ticks: Tensor | None = None,
        nanoseconds: int = 0,
        schedule: Tensor | None = None,
        written: Tensor | None = None,
        team: int = 1,
    ) -> Tensor:
        """Run ``counts`` [n] ticks of every column of ``state`` [C, n], or as many as there are until the kernel's stop.

        Args:
            state: State [C, n], which changes.
            counts: Number of ticks, at most, of each row [n], or of all of them.
            tracks: Records of each track.
            order: Number of ticks to be expected of each row [n], where it differs from ``counts``; a matter of speed only.
            shared: Numbers that all rows share.
            own: Numbers of each row [C', n].
            mode: Column of ``flags`` for each row [n].
            flags: Flags [F, M] of the modes.
            ticks: Number of ticks before the first, [n].
            nanoseconds: Length of a tick.
            schedule: Numbers of each tick [K, S].
            written: What each tick writes [n, L, C''], which changes; its rows may lie apart. Teams cannot write.
            team: Rows 0 to team - 1 are the first team, and so on: where the kernel has a stop, the rows of a team, whose
                ``counts`` are equal, all end in the tick in which the first of them stops.

        Returns:
            Number of ticks that each row has run, [n].

        Raises:
            ValueError: For a tensor that is not contiguous or of another type, a table with too few records, or teams that do not
                fit the rows.
        """
        alike = isinstance(counts, int)
        counts = torch.full(state.shape[1:], counts) if isinstance(counts, int) else counts
        for tensor in (state, counts, shared, own, mode, flags, ticks, schedule, *(part for t in tracks for part in t)):
            if tensor is not None and not tensor.is_contiguous():
                raise ValueError(
                    f"a kernel got a tensor {list(tensor.shape)} with strides {tensor.stride()}; it must be contiguous"
                )
            if tensor is not None and tensor.dtype not in (torch.float64, torch.int64):
                raise ValueError(f"a kernel got a tensor {list(tensor.shape)} of {tensor.dtype}; it must be float64 or int64")
        for track, samples in zip(self.tracks, tracks, strict=True):
            if samples.table.shape[1] < track.count:
                raise ValueError(
                    f"a kernel got a table {list(samples.table.shape)}; it must have at least {track.count} records a row"
                )
        n, modes = len(counts), 1 if flags is None else flags.shape[1]
        packs = n, state, shared, own, flags, modes, mode, ticks, nanoseconds, schedule
        records = [part for t in tracks for part in (t.table, t.start, t.owner, t.table.shape[1])]
        order, entry = counts if order is None else order, self._entry(team)
        if self.stops and team > 1:
            check_teams(counts, team, written)
            groups = in_groups(counts, order, mode, team, entry.width)
            entry.run(*groups.size, _threads(groups.size[0]), groups.rows, groups.teams, groups.ends, *packs, *records)
            return groups.ends[:-1].repeat_interleave(team)
        rows, ends = self._blocks(counts, alike, order, mode, modes)
        blocks = len(rows) // entry.width
        stride = 0 if written is None else written.stride(0)
        entry.run(blocks, _threads(blocks), rows, ends, *packs, written, stride, *records)
        return torch.empty_like(counts).index_copy_(0, rows[:n], ends[:n]) if self.stops else counts

    def _blocks(self, counts: Tensor, alike: bool, order: Tensor, mode: Tensor | None, modes: int) -> tuple[Tensor, Tensor]:
        """Rows in blocks of like durations and modes, and their numbers of ticks; padded with rows that run no tick."""
        n, width = len(counts), self.alone.width
        padding = -n % width
        if alike or n <= width:
            rows, counts = torch.arange(n), counts.clone() if self.stops else counts
        else:
            rows = torch.argsort(order if mode is None else order * modes + mode)
            counts = counts[rows]
        if not padding:
            return rows, counts
        return torch.cat([rows, rows[:1].expand(padding)]), torch.cat([counts, counts.new_zeros(padding)])


def _threads(parts: int) -> int:
    return max(1, min(parts, torch.get_num_threads()))
