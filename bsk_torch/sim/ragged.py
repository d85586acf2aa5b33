"""Lists of different lengths, one for each row of a batch, as tables padded with infinity."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def sorted_by(group: Tensor, time: Tensor) -> Tensor:
    """Order [m] by group, then time, both [m], s; times that rounding cannot tell apart within a group come as they are.

    One sort of one number, ``group * 2^k + time``, costs half of two: times are rounded to 1e-8 s for hundreds of groups.
    """
    longest = float(time.abs().max()) if len(time) else 0.0
    return torch.argsort(group * 2.0 ** math.ceil(math.log2(longest + 2.0) + 1.0) + time, stable=True)


def tabulate(row: Tensor, time: Tensor, n: int, *others: Tensor) -> tuple[Tensor, ...]:
    """Tables [n, W] of events in the order of their times, from lists in any order; ``others`` are columns of the same events.

    Args:
        row: Row of each event, [m].
        time: Time of each event, [m]; infinity where a row has fewer events than columns.
        n: Number of rows.
        *others: Further columns [m]; infinity, or zero where they are integers, where there is no event.
    """
    order = sorted_by(row, time)
    sorted_row, counts = row[order], torch.bincount(row, minlength=n)
    rank = torch.arange(len(row), device=row.device) - (torch.cumsum(counts, 0) - counts)[sorted_row]
    width = max(1, int(counts.max()) if len(row) else 1)

    def table(column: Tensor) -> Tensor:
        empty = torch.full((n, width), math.inf if column.is_floating_point() else 0, dtype=column.dtype, device=row.device)
        empty[sorted_row, rank] = column[order]
        return empty

    return tuple(table(column) for column in (time, *others))


def widened(table: Tensor, width: int) -> Tensor:
    """The table with at least ``width`` columns."""
    extra = width - table.shape[1]
    value = math.inf if table.is_floating_point() else 0
    return torch.nn.functional.pad(table, (0, extra), value=value) if extra > 0 else table


def stored(table: Tensor, rows: Tensor, new: Tensor) -> Tensor:
    """The table with ``new`` [n, W] in ``rows`` [n], wider where that needs it."""
    width = max(table.shape[1], new.shape[1])
    table = widened(table, width)
    table[rows] = widened(new, width)
    return table
