"""Lists of the search of :mod:`bsk_torch.sim.access.passes.passes` by kernels, which look at each number once.

How long a list is shows as it is made. So each kernel is called twice: it makes the list, and copies it into a tensor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.codegen.build import entry, load
from bsk_torch.sim.access.visibility.geometry import SAMPLES_PER_CELL

KERNELS = {"screen": "iiiii" + "ppppp" + "pp", "events": "iiii" + "pppp" + "pp"}
"""Signature of each kernel, whose name is that of its file."""


@cache
def list_kernel(name: str) -> Callable[..., None]:
    """Return a kernel, built or loaded when it is first needed."""
    return entry(load(Path(__file__).with_name(f"{name}.cpp").read_text(), f"search for passes ({name})"), KERNELS[name])


TRACK = 16
"""Samples of a track in the kernel, which fill its vectors."""


class Cells(NamedTuple):
    """Where n satellites are in C cells, and which directions are near then, in float32.

    Attributes:
        middle: Direction in the middle of each cell, [n, C, 3].
        limit: Least product with the direction of a place that may be near, [n, C].
        track: Directions at the samples of each cell, [n, C, K, 3].
        near: Least product with one of these, [n, C].
    """

    middle: Tensor
    limit: Tensor
    track: Tensor
    near: Tensor


def places_near(cells: Cells, r_LP_P: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return row, place and cell, [m] each, of places near satellites: both products exceed their limits.

    Positions ``r_LP_P`` [n or 1, P, 3] m are NaN for missing places. Pairs come in the order of rows, cells and places.
    """
    rows, count = cells.limit.shape
    number, threads = torch.zeros(1, dtype=torch.int64), max(1, min(rows, torch.get_num_threads()))
    index = torch.arange(TRACK).clamp(max=cells.track.shape[2] - 1)
    track = cells.track.permute(0, 1, 3, 2)[..., index]
    tables = [table.contiguous() for table in (r_LP_P, cells.middle, cells.limit, track, cells.near)]
    sizes = rows, count, r_LP_P.shape[1], len(r_LP_P) == 1, threads
    list_kernel("screen")(*sizes, *tables, number, None)
    pairs = torch.empty(3, int(number), dtype=torch.int64)
    list_kernel("screen")(*sizes, *tables, number, pairs)
    row, place, cell = pairs
    return row, place, cell


def sorted_events(codes: Tensor, row: Tensor, place: Tensor, cell: Tensor, last: int) -> Iterator[tuple[Tensor, ...]]:
    """Yield starts, ends and short passes: row, place, sample, and whether an end of the search cuts the pass, [m'] each.

    ``codes`` [m, CLASSIFIED_SAMPLES] are those of samples from the ``cell`` [m] on of each pair of ``row`` [m], ascending, and
    ``place`` [m]; ``last`` is the last sample of the search. Starts and ends are sorted by row, place and time, short passes as
    the pairs are.
    """
    tables = [table.contiguous() for table in (codes, row, place, cell)]
    sizes = len(row), codes.shape[1], SAMPLES_PER_CELL, last
    numbers = torch.zeros(3, dtype=torch.int64)
    list_kernel("events")(*sizes, *tables, numbers, None)
    events = torch.empty(4 * int(numbers.sum()), dtype=torch.int64)
    list_kernel("events")(*sizes, *tables, numbers, events)
    for part in events.split((4 * numbers).tolist()):
        yield tuple(part.view(4, -1))
