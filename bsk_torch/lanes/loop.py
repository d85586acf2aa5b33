"""Kernels that repeat ticks, as Python sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.lanes import kernel
from bsk_torch.lanes.emit import SIGNATURE, Track, loop_source
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
        tracks: Sequence[Track],
        written: Sequence[Plane] = (),
        clock: str = "ticks",
        schedule: int = 0,
    ) -> None:
        """Build the kernel, or load it; ``name`` says in messages what is being compiled."""
        source = loop_source(program, outputs, tracks, kernel.INCLUDE, written, clock, schedule)
        library = kernel.load(source, name)
        self.width: int = library.lanes_width()
        self._run = kernel.entry(library, SIGNATURE + "pppi" * len(tracks))

    def __call__(
        self,
        state: Tensor,
        counts: Tensor,
        tracks: Sequence[Samples],
        *,
        shared: Tensor | None = None,
        own: Tensor | None = None,
        mode: Tensor | None = None,
        flags: Tensor | None = None,
        ticks: Tensor | None = None,
        nanoseconds: int = 0,
        schedule: Tensor | None = None,
        written: Tensor | None = None,
    ) -> None:
        """Run ``counts`` [n] ticks of every column of ``state`` [C, n], which changes, as does ``written`` [n, L, C'].

        Rows of ``written`` may lie apart; everything else must be contiguous, else ValueError.
        """
        parts = [part for t in tracks for part in t]
        for tensor in (state, shared, own, mode, flags, ticks, schedule, *parts):
            if tensor is not None and not tensor.is_contiguous():
                raise ValueError(
                    f"a kernel got a tensor {list(tensor.shape)} with strides {tensor.stride()}; it must be contiguous"
                )
        modes = 1 if flags is None else flags.shape[1]
        rows, ends = self._blocks(counts, mode, modes)
        self._run(
            *(len(rows) // self.width, torch.get_num_threads(), rows, ends, counts.shape[0], state, shared, own, flags, modes),
            *(mode, ticks, nanoseconds, schedule, written, 0 if written is None else written.stride(0)),
            *(part for t in tracks for part in (t.table, t.start, t.owner, t.table.shape[1])),
        )

    def _blocks(self, counts: Tensor, mode: Tensor | None, modes: int) -> tuple[Tensor, Tensor]:
        """Rows in blocks of like durations and modes, and their numbers of ticks; padded with rows that run no tick."""
        n = len(counts)
        padding = -n % self.width
        if n <= self.width:
            order = torch.arange(n)
        else:
            order = torch.argsort(counts if mode is None else counts * modes + mode)
            counts = counts[order]
        if not padding:
            return order, counts
        return torch.cat([order, order[:1].expand(padding)]), torch.cat([counts, counts.new_zeros(padding)])
