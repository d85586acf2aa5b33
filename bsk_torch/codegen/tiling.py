"""Arrangement of rows: in blocks, and in tiles of blocks for groups of rows that run in lockstep.

A block holds as many rows as a vector has lanes, and takes as long as its longest row, in every branch that one of its rows
takes. So rows expected to run for about as long, in the same mode, share a block.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

SPARE = 1 / 16
"""Padding of a tile, as part of its rows, for which no larger tile is taken."""

BLOCKS, TILES = 8, 32
"""Blocks that a tile may have to sort its rows by mode, where there are so many tiles."""


def in_blocks(
    counts: Tensor, expected_ticks: Tensor | None, mode: Tensor | None, modes: int, width: int
) -> tuple[Tensor, Tensor]:
    """Rows in blocks of ``width``, and their numbers of ticks, which a kernel may change; padded with rows that run no tick.

    Args:
        counts: Number of ticks, at most, of each row [n]; copied unless ``expected_ticks`` is None.
        expected_ticks: Number of ticks to be expected of each row [n], or None if all are alike.
        mode: Mode of each row [n], if there are any.
        modes: Number of modes.
        width: Rows of a block.
    """
    n = len(counts)
    padding = -n % width
    if expected_ticks is None or n <= width:
        rows = _in_order(n, padding)
        if padding:
            return rows, torch.constant_pad_nd(counts, (0, padding), 0)
        return rows, counts if expected_ticks is None else counts.clone()
    rows = torch.argsort(expected_ticks if mode is None else expected_ticks * modes + mode)
    counts = counts[rows]
    if not padding:
        return rows, counts
    return torch.cat([rows, rows[:1].expand(padding)]), torch.constant_pad_nd(counts, (0, padding), 0)


@lru_cache(maxsize=32)
def _in_order(n: int, padding: int) -> Tensor:
    """Return the numbers of ``n`` rows, padded with the first one; kernels only read them."""
    with torch.inference_mode(False):
        return torch.constant_pad_nd(torch.arange(n), (0, padding), 0)


@lru_cache(maxsize=32)
def _owners(groups: int, group: int, width: int) -> Tensor:
    """Return the groups of the rows of one block, [1, width]; kernels only read them."""
    with torch.inference_mode(False):
        owners = torch.arange(groups).repeat_interleave(group)
        return torch.constant_pad_nd(owners, (0, width - len(owners)), groups).unsqueeze(0)


class Tiles(NamedTuple):
    """Rows in tiles of blocks: ``rows`` and the group of each, [tiles, lanes]; ``ends`` [groups + 1] are ticks of the groups.

    The last group is that of padding, which runs no tick. ``size`` is the number of tiles, and of blocks in each.
    """

    rows: Tensor
    groups: Tensor
    ends: Tensor
    size: tuple[int, int]


def check_groups(counts: Tensor, group: int) -> None:
    """Raise ValueError for ``counts`` [n] that are not those of groups of ``group`` rows."""
    if len(counts) % group:
        raise ValueError(f"lockstep={group} must divide the number of rows, {len(counts)}")
    if not torch.equal(counts, counts[::group].repeat_interleave(group)):
        first = int(torch.nonzero((counts.view(-1, group) != counts[::group, None]).any(1))[0])
        numbers = counts.view(-1, group)[first].unique().tolist()
        raise ValueError(f"counts of group {first} are {numbers}; rows in lockstep must have the same number of ticks")


def in_tiles(
    counts: Tensor, expected_ticks: Tensor, mode: Tensor | None, group: int, width: int, present: Tensor | None = None
) -> Tiles:
    """Return tiles of whole groups that should take about as long, with rows of like modes in their blocks.

    Rows that are not ``present`` become padding behind the others, which fill their blocks; kernels skip blocks of padding.

    Args:
        counts: Number of ticks, at most, of each row [n].
        expected_ticks: Number of ticks to be expected of each row [n]; the first row of a group to stop ends it.
        mode: Mode of each row [n], if there are any.
        group: Rows of a group.
        width: Rows of a block.
        present: Rows that run, [n] (default: all).
    """
    groups = len(counts) // group
    ends = torch.cat([counts[::group], counts.new_zeros(1)])
    if 0 < len(counts) <= width and present is None:  # one block
        rows = _in_order(len(counts), width - len(counts)).unsqueeze(0)
        return Tiles(rows, _owners(groups, group, width), ends, (1, 1))
    # a tile has as few groups as fill its blocks, or a multiple of them; tiles larger than a cache are slower
    least = next(k for k in range(1, width + 1) if -(k * group) % width <= SPARE * k * group)
    each = max(1, min(groups, least * max(1, min(BLOCKS * width // (least * group), groups // (least * TILES)))))
    shape = -(-groups // each), each * group
    ranked = expected_ticks.view(groups, group).amin(1).argsort()
    rows = _filled((ranked.unsqueeze(1) * group + torch.arange(group)).flatten(), 0, shape)
    owners = _filled(ranked.repeat_interleave(group), groups, shape)
    order = None if mode is None else mode[rows]
    if present is not None:
        absent = ~present[rows]
        owners = torch.where(absent, groups, owners)
        order = absent.long() if order is None else torch.where(absent, order.amax() + 1, order)
    if order is not None:
        alike = order.argsort(dim=1, stable=True)
        rows, owners = rows.gather(1, alike), owners.gather(1, alike)
    padding = 0, -shape[1] % width
    rows, owners = torch.constant_pad_nd(rows, padding, 0), torch.constant_pad_nd(owners, padding, groups)
    return Tiles(rows, owners, ends, (shape[0], rows.shape[1] // width))


def _filled(values: Tensor, filler: int, shape: tuple[int, int]) -> Tensor:
    return torch.constant_pad_nd(values, (0, shape[0] * shape[1] - len(values)), filler).view(shape)
