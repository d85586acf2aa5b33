"""Python interface of kernels that repeat ticks."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.codegen import build, cpp
from bsk_torch.codegen.ir import Loop
from bsk_torch.codegen.passes import lower
from bsk_torch.codegen.tiling import check_groups, in_blocks, in_tiles


class Samples(NamedTuple):
    """A track's records: ``table`` [N, R, C], and time ``start`` [N], s, of the first one.

    ``owner`` is the row of both for each row of a run, where they are not the same.
    """

    table: Tensor
    start: Tensor
    owner: Tensor | None = None


class Printed(NamedTuple):
    """A loop without a stop as C++: its source, the types of its parameters, and what calls check."""

    source: str
    signature: str
    records: Sequence[int]  # least number of records of each track
    writes: int  # numbers written in each tick

    @staticmethod
    def of(loop: Loop, lockstep: bool = False) -> Printed:
        """Print a loop."""
        lowered = lower(loop, lockstep)
        return Printed(cpp.source(lowered, build.INCLUDE), cpp.signature(lowered), loop.records, loop.writes)


class Entry(NamedTuple):
    """A library: rows in a block, and its function."""

    width: int
    run: Callable[..., None]

    @staticmethod
    def of(loop: Loop | Printed, lockstep: bool, name: str) -> Entry:
        """Build the library of a loop, or load it; ``name`` is used in messages."""
        printed = loop if isinstance(loop, Printed) else Printed.of(loop, lockstep)
        library = build.load(printed.source, name)
        return Entry(library.lanes_width(), build.entry(library, printed.signature))


class Kernel:
    """A compiled loop.

    A loop with a stop has two libraries: one in which each row ends by itself, and one in which groups of rows run in lockstep.
    """

    def __init__(self, name: str, loop: Loop | Printed, lockstep: int = 1) -> None:
        """Build the library for groups of ``lockstep`` rows, or load it; the other one waits until it is needed.

        ``name`` is used in messages.
        """
        self.name, self.stops = name, isinstance(loop, Loop) and loop.stop is not None
        self.loop = loop if isinstance(loop, Printed) or self.stops else Printed.of(loop)
        self.build(lockstep)

    @cached_property
    def independent(self) -> Entry:
        """The library in which every row has its own end."""
        return Entry.of(self.loop, False, self.name)

    @cached_property
    def lockstep(self) -> Entry:
        """The library in which the rows of a group end together."""
        if not self.stops:
            raise ValueError(f"the {self.name} has no stop: its rows cannot run in lockstep")
        return Entry.of(self.loop, True, f"{self.name} in lockstep")

    def build(self, lockstep: int) -> Entry:
        """Return the library for groups of ``lockstep`` rows, which is built or loaded first, so that no call has to wait."""
        return self.lockstep if self.stops and lockstep > 1 else self.independent

    def __call__(
        self,
        state: Tensor,
        counts: Tensor | int,
        tracks: Sequence[Samples],
        *,
        expected_ticks: Tensor | None = None,
        shared: Tensor | None = None,
        own: Tensor | None = None,
        mode: Tensor | None = None,
        flags: Tensor | None = None,
        ticks: Tensor | None = None,
        nanoseconds: int = 0,
        schedule: Tensor | None = None,
        written: Tensor | None = None,
        lockstep: int = 1,
        present: Tensor | None = None,
    ) -> Tensor:
        """Run ``counts`` [n] ticks of every column of ``state`` [C, n], or as many as there are until the kernel's stop.

        Args:
            state: State [C, n], which changes.
            counts: Number of ticks, at most, of each row [n], or of all of them.
            tracks: Records of each track.
            expected_ticks: Number of ticks to be expected of each row [n], where it differs from ``counts``; it affects the
                speed only.
            shared: Numbers that all rows share.
            own: Numbers of each row [C', n].
            mode: Column of ``flags`` for each row [n].
            flags: Flags [F, M] of the modes.
            ticks: Number of ticks before the first, [n].
            nanoseconds: Length of a tick.
            schedule: Numbers of each tick [K, S].
            written: What each tick writes [n, L, C''], which changes; its rows may lie apart. None if it writes nothing.
            lockstep: Rows 0 to lockstep - 1 are the first group, and so on: where the kernel has a stop, the rows of a group,
                whose ``counts`` are equal, all end in the tick in which the first of them stops.
            present: Rows that run, [n] (default: all). The others remain unchanged.

        Returns:
            Number of ticks that each row has run, [n]; of rows that are not present, that of their group, or ``counts``.

        Raises:
            ValueError: For a tensor that is not contiguous or of another type, a table with too few records, a mode without
                flags, groups that do not fit the rows, or no room for what the kernel writes.
        """
        is_uniform = isinstance(counts, int)
        counts = torch.full(state.shape[1:], counts) if isinstance(counts, int) else counts
        _check_tensors((state, counts, shared, own, mode, flags, ticks, schedule, *itertools.chain(*tracks)))
        for least, samples in zip(self.loop.records, tracks, strict=True):
            if samples.table.shape[1] < least:
                raise ValueError(f"a kernel got a table {list(samples.table.shape)}; it must have at least {least} records a row")
        if (written is None) == bool(self.loop.writes):
            must = "must not" if written is None else "must"
            raise ValueError(f"the {self.name} writes {self.loop.writes} numbers a tick; written {must} be None")
        n, modes = len(counts), 1 if flags is None else flags.shape[1]
        if mode is not None and n:
            low, high = map(int, torch.aminmax(mode))
            if low < 0 or high >= modes:
                raise ValueError(f"a kernel got modes from {low} to {high}; they must lie in [0, {modes - 1}]")
        packs = n, state, shared, own, flags, modes, mode, ticks, nanoseconds, schedule
        records = [part for t in tracks for part in (t.table, t.start, t.owner, t.table.shape[1])]
        expected, entry = counts if expected_ticks is None else expected_ticks, self.build(lockstep)
        if self.stops and lockstep > 1:
            check_groups(counts, lockstep)
            tiles = in_tiles(counts, expected, mode, lockstep, entry.width, present)
            room = () if written is None else (written, written.stride(0))
            threads = max(1, min(tiles.size[0], torch.get_num_threads()))
            entry.run(*tiles.size, threads, tiles.rows, tiles.groups, tiles.ends, *packs, *room, *records)
            return tiles.ends[:-1].repeat_interleave(lockstep)
        if present is not None:
            all_counts, is_uniform = counts, False
            counts, expected = (torch.where(present, ticks, 0) for ticks in (counts, expected))
        rows, ends = in_blocks(counts, None if is_uniform else expected, mode, modes, entry.width)
        blocks = len(rows) // entry.width
        stride = 0 if written is None else written.stride(0)
        entry.run(blocks, max(1, min(blocks, torch.get_num_threads())), rows, ends, *packs, written, stride, *records)
        ran = torch.empty_like(counts).index_copy_(0, rows[:n], ends[:n]) if self.stops else counts
        return ran if present is None else torch.where(present, ran, all_counts)

    def fly(
        self,
        state: Tensor,
        counts: Tensor,
        tracks: Sequence[Samples],
        shared: Tensor,
        own: Tensor,
        mode: Tensor,
        flags: Tensor,
        ticks: Tensor,
        nanoseconds: int,
    ) -> None:
        """Run ``counts`` [n] ticks of a kernel without stops that writes nothing, with arguments that are known to be right."""
        entry, modes = self.independent, flags.shape[1]
        records = [part for t in tracks for part in (t.table, t.start, t.owner, t.table.shape[1])]
        rows, ends = in_blocks(counts, counts, mode, modes, entry.width)
        blocks = len(rows) // entry.width
        threads = max(1, min(blocks, torch.get_num_threads()))
        entry.run(
            blocks, threads, rows, ends, len(counts), state, shared, own, flags, modes, mode, ticks, nanoseconds, None, None, 0,
            *records,
        )  # fmt: skip


def _check_tensors(tensors: Iterable[Tensor | None]) -> None:
    for tensor in tensors:
        if tensor is not None and not tensor.is_contiguous():
            raise ValueError(f"a kernel got a tensor {list(tensor.shape)} with strides {tensor.stride()}; it must be contiguous")
        if tensor is not None and tensor.dtype not in (torch.float64, torch.int64):
            raise ValueError(f"a kernel got a tensor {list(tensor.shape)} of {tensor.dtype}; it must be float64 or int64")
