"""Lists of different lengths, one for each row of a batch, as tables padded with infinity."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def argsort_by_group(group: Tensor, time: Tensor) -> Tensor:
    """Return the order, [m], by group and then by time; times that are equal within rounding keep their order.

    One sort by a single number, ``group * 2^k + time`` with 2^k above all times, costs half as much as two sorts. Times are
    rounded to 1e-8 s for hundreds of groups.

    Args:
        group: Group of each entry, [m] integers.
        time: Time of each entry, [m] s.
    """
    longest = float(time.abs().max()) if len(time) else 0.0
    return torch.argsort(group.to(time.dtype) * 2.0 ** math.ceil(math.log2(longest + 2.0) + 1.0) + time, stable=True)


def tabulate(row: Tensor, time: Tensor, n: int, *others: Tensor) -> tuple[Tensor, ...]:
    """Return tables [n, W] of events in the order of their times, from lists in any order.

    Args:
        row: Row of each event, [m].
        time: Time of each event, [m]; the padding of its table is infinity.
        n: Number of rows.
        *others: Further columns of the same events, [m]; the padding is infinity, or zero for integers.
    """
    order = argsort_by_group(row, time)
    sorted_row, counts = row[order], torch.bincount(row, minlength=n)
    rank = torch.arange(len(row), device=row.device) - (torch.cumsum(counts, 0) - counts)[sorted_row]
    width = max(1, int(counts.max()) if len(row) else 1)

    def table(column: Tensor) -> Tensor:
        padding = math.inf if column.is_floating_point() else 0
        empty = torch.full((n, width), padding, dtype=column.dtype, device=row.device)
        empty[sorted_row, rank] = column[order]
        return empty

    return tuple(table(column) for column in (time, *others))
