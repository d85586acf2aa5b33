"""Kernels that repeat ticks, as Python sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.lanes import kernel
from bsk_torch.lanes.emit import SIGNATURE, TrackShape, loop_source
from bsk_torch.lanes.expr import Plane, Program


class Samples(NamedTuple):
    """A track's records: ``table`` [N, R, C], and time ``start`` [N], s, of the first one.

    ``owner`` is the row of both for each row of a run, where they are not the same.
    """

    table: Tensor
    start: Tensor
    owner: Tensor | None = None


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
    ) -> None:
        """Build the kernel, or load it; ``name`` says in messages what is being compiled."""
        source = loop_source(program, outputs, tracks, kernel.INCLUDE, written, clock, schedule, stop)
        library = kernel.load(source, name)
        self.tracks, self.stops = tuple(tracks), stop is not None
        self.width: int = library.lanes_width()
        self._run = kernel.entry(library, SIGNATURE + "pppi" * len(tracks))

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
            written: What each tick writes [n, L, C''], which changes; its rows may lie apart.

        Returns:
            Number of ticks that each row has run, [n].

        Raises:
            ValueError: For a tensor that is not contiguous, or a table with too few records.
        """
        alike = isinstance(counts, int)
        counts = torch.full(state.shape[1:], counts) if isinstance(counts, int) else counts
        for tensor in (state, counts, shared, own, mode, flags, ticks, schedule, *(part for t in tracks for part in t)):
            if tensor is not None and not tensor.is_contiguous():
                raise ValueError(
                    f"a kernel got a tensor {list(tensor.shape)} with strides {tensor.stride()}; it must be contiguous"
                )
        for track, samples in zip(self.tracks, tracks, strict=True):
            if samples.table.shape[1] < track.count:
                raise ValueError(
                    f"a kernel got a table {list(samples.table.shape)}; it must have at least {track.count} records a row"
                )
        n, modes = len(counts), 1 if flags is None else flags.shape[1]
        rows, ends = self._blocks(counts, alike, counts if order is None else order, mode, modes)
        blocks = len(rows) // self.width
        self._run(
            *(blocks, max(1, min(blocks, torch.get_num_threads())), rows, ends, n, state, shared, own, flags, modes),
            *(mode, ticks, nanoseconds, schedule, written, 0 if written is None else written.stride(0)),
            *(part for t in tracks for part in (t.table, t.start, t.owner, t.table.shape[1])),
        )
        return torch.empty_like(counts).index_copy_(0, rows[:n], ends[:n]) if self.stops else counts

    def _blocks(self, counts: Tensor, alike: bool, order: Tensor, mode: Tensor | None, modes: int) -> tuple[Tensor, Tensor]:
        """Rows in blocks of like durations and modes, and their numbers of ticks; padded with rows that run no tick."""
        n = len(counts)
        padding = -n % self.width
        if alike or n <= self.width:
            rows, counts = torch.arange(n), counts.clone() if self.stops else counts
        else:
            rows = torch.argsort(order if mode is None else order * modes + mode)
            counts = counts[rows]
        if not padding:
            return rows, counts
        return torch.cat([rows, rows[:1].expand(padding)]), torch.cat([counts, counts.new_zeros(padding)])
