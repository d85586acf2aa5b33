"""Tables of access windows and queries on them, as pure functions."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.sim.access.passes.passes import Passes

TIME_ROUNDING = 1e-12  # windows that close less than this, s, after a query count as closed

TIE_BREAK = 1e-7
"""Windows that are cut at the same time are sorted by place, as if each closed so much later, s, than the one before."""

FULL_SORT_MARGIN = 48
"""Tables of at most twice as many windows as a query wants and so many more are sorted as a whole: that is the faster way."""

BLOCK_MARGIN = 16  # of longer tables, the first block has so many windows more than the query wants
BLOCK_GROWTH = 4  # ratio of the lengths of successive blocks


class Windows(NamedTuple):
    """Windows of n satellites, [n, W] each, sorted by closing time."""

    open: Tensor  # opening time, s since reset
    close: Tensor  # closing time, s since reset; infinity for the padding of rows that have fewer windows than others
    place: Tensor

    def take(self, rows: Tensor) -> Windows:
        """Return the windows of ``rows`` [m]."""
        return Windows(*(table[rows] for table in self))

    def gather(self, index: Tensor) -> Windows:
        """Return the windows in the columns ``index`` [n, K] of each row."""
        return Windows(*(table.gather(1, index) for table in self))

    def put(self, rows: Tensor, other: Windows) -> Windows:
        """Return a copy in which ``other``, of equal width, replaces ``rows`` [m]."""
        return Windows(*(mine.index_copy(0, rows, theirs) for mine, theirs in zip(self, other, strict=True)))


class Candidates(NamedTuple):
    """Windows [n, K] as a query sees them: cut at the end of what has been generated."""

    windows: Windows
    valid: Tensor  # whether each of them answers the query
    is_cut: Tensor  # whether the end of what has been generated cuts them, those that close there included

    @property
    def sort_key(self) -> Tensor:
        """Closing times with ties broken; infinity for windows that do not answer the query."""
        close = self.windows.close
        tie_break = torch.where(self.is_cut, self.windows.place.to(close.dtype) * TIE_BREAK, 0.0)
        return torch.where(self.valid, close + tie_break, torch.inf)


def candidates(windows: Windows, time: Tensor, until: Tensor, allowed: Tensor | None) -> Candidates:
    """Return the windows [n, K] as a query at ``time`` [n] s sees them.

    Windows that have closed do not count, nor those that open after ``until`` [n] s, the end of what has been generated, where
    those in progress are cut. Of places, those count that are ``allowed`` [n, P]; all for None.
    """
    end = until.unsqueeze(-1)
    now = (time + TIME_ROUNDING).unsqueeze(-1)
    valid = (windows.open < end) & (windows.close >= now) & (end >= now) & (windows.close < torch.inf)
    if allowed is not None:
        valid = valid & allowed.gather(1, windows.place)
    is_cut = windows.close >= end  # those that a search by intervals ends there, too
    return Candidates(Windows(windows.open, torch.minimum(windows.close, end), windows.place), valid, is_cut)


def next_to_close(
    windows: Windows, time: Tensor, until: Tensor, width: int, allowed: Tensor | None, block: int | None = None
) -> tuple[Windows, Tensor]:
    """Return the windows that close next after ``time`` [n] s, [n, width] each, and their number, [n].

    The last window is repeated where there are fewer than ``width``. Tables of many targets hold hundreds of windows, of which
    a query wants a few, and sorting them dominates its cost. But uncut windows are sorted already, so a ``block`` of them from
    the first that has not closed (default: ``width + BLOCK_MARGIN``) is enough for most rows; the remaining rows get longer
    blocks. ``until`` [n] s and ``allowed`` [n, P] are those of :func:`candidates`.
    """
    total, block = windows.close.shape[1], block or width + BLOCK_MARGIN
    if not is_long(total, width):
        return _first_to_close(candidates(windows, time, until, allowed), width)
    first = torch.searchsorted(windows.close, (time + TIME_ROUNDING).unsqueeze(-1)).squeeze(-1)
    some = _block_candidates(windows, first, block, time, until, allowed)
    slot = torch.where(some.valid, (torch.cumsum(some.valid, 1) - 1).clamp(max=width), width)
    number = torch.arange(block, device=time.device).expand_as(slot)
    column = torch.zeros(len(time), width + 1, dtype=torch.long, device=time.device).scatter(1, slot, number)[:, :width]
    found = some.valid.sum(1).clamp(max=width)
    result = some.windows.gather(_repeat_last(column, found, width))
    # cut windows are sorted by place, so some beyond the block may come before those in it: only uncut ones are certain
    rest = torch.nonzero((some.valid & (some.windows.close < until.unsqueeze(-1))).sum(1) < width).squeeze(-1)
    if not len(rest):
        return result, found
    few, mine = windows.take(rest), None if allowed is None else allowed[rest]
    longest = max(1, total - int(first[rest].min()))
    if longest > BLOCK_GROWTH * block:
        late, number = next_to_close(few, time[rest], until[rest], width, mine, BLOCK_GROWTH * block)
    else:
        late, number = _first_to_close(_block_candidates(few, first[rest], longest, time[rest], until[rest], mine), width)
    return result.put(rest, late), found.index_copy(0, rest, number)


def is_long(total: int, width: int) -> bool:
    """Return whether a table of ``total`` columns is looked at in blocks; a row without windows shows another padding then."""
    return total > 2 * width + FULL_SORT_MARGIN


def _block_candidates(
    windows: Windows, first: Tensor, count: int, time: Tensor, until: Tensor, allowed: Tensor | None
) -> Candidates:
    """Return ``count`` windows from column ``first`` [n] on; those beyond the table are invalid."""
    index = first.unsqueeze(-1) + torch.arange(count, device=time.device)
    last = windows.close.shape[1] - 1
    some = candidates(windows.gather(index.clamp(max=last)), time, until, allowed)
    return some._replace(valid=some.valid & (index <= last))


def _first_to_close(some: Candidates, width: int) -> tuple[Windows, Tensor]:
    """Return the ``width`` candidates that close first, the last repeated where there are fewer, and their number, [n]."""
    key = some.sort_key
    found = some.valid.sum(1).clamp(max=width)
    if width == 1:
        order = key.argmin(1, keepdim=True)
    else:
        order = torch.sort(key, dim=1, stable=True).indices[:, :width]
        order = torch.nn.functional.pad(order, (0, width - order.shape[1]))
    return some.windows.gather(_repeat_last(order, found, width)), found


def _repeat_last(column: Tensor, found: Tensor, width: int) -> Tensor:
    """Return columns [n, width], of which the first ``found`` [n] are valid, with the last valid one repeated."""
    slot = torch.minimum(torch.arange(width, device=column.device), (found - 1).clamp(min=0).unsqueeze(-1))
    return column.gather(1, slot)


def join_at(old: Passes, new: Passes, begin: Tensor) -> Passes:
    """Return old and new windows, joined where an old one closes and a new one of the same place opens at ``begin`` [n] s."""
    ends = torch.nonzero(old.close == begin[old.row]).squeeze(-1)
    starts = torch.nonzero(new.open == begin[new.row]).squeeze(-1)
    most = 1 + int(torch.cat([old.place, new.place]).max()) if len(old.place) + len(new.place) else 1
    keys = [part.row[index] * most + part.place[index] for part, index in ((old, ends), (new, starts))]
    order = torch.argsort(keys[0])
    ends, key = ends[order], keys[0][order]
    at = torch.searchsorted(key, keys[1]).clamp(max=max(0, len(key) - 1))
    pairs = torch.nonzero(key[at] == keys[1]).squeeze(-1) if len(key) else at[:0]
    opens = new.open.index_copy(0, starts[pairs], old.open[ends[at[pairs]]])
    stays = torch.ones(len(old.row), dtype=torch.bool, device=begin.device)
    stays[ends[at[pairs]]] = False
    kept, new = Passes(*(part[stays] for part in old)), new._replace(open=opens)
    return Passes(*(torch.cat(parts) for parts in zip(kept, new, strict=True)))
