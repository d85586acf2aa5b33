"""Lists of different lengths, one for each row of a batch, as tables padded with infinity."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def argsort_by_group(group: Tensor, time: Tensor) -> Tensor:
    """Return the order, [m], by group and then by time, s; times that are equal within rounding keep their order.

    One sort by a single number, ``group * 2^k + time`` with 2^k above all times, costs half as much as two sorts. Times are
    rounded to 1e-8 s for hundreds of groups.
    """
    longest = float(time.abs().max()) if len(time) else 0.0
    return torch.argsort(group.to(time.dtype) * 2.0 ** math.ceil(math.log2(longest + 2.0) + 1.0) + time, stable=True)


def tabulate(row: Tensor, time: Tensor, n: int, *others: Tensor) -> tuple[Tensor, ...]:
    """Return tables [n, W] of events in the order of their times, from lists [m], with their rows, in any order.

    The padding is infinity, or zero where ``others``, further columns of the same events, are integers.
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
