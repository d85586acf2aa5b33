"""Graph of images in time: which target may be imaged when, and which image may follow which.

A node is a window at a time, in cells of one or several ticks. An edge leads to it from the latest time at which another target
may have been imaged before. All rounding is such that what a satellite can do is a path in the graph. Where times depend on the
direction that the satellite comes from, each window has a node for every sector of that direction: an edge leads from any of
them, with times for that sector, to the one that its two targets decide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.lab.bounds.envelope import SOONEST, Envelope, pointing, sector_from
from bsk_torch.lab.bounds.windows import Openings

LINE_OF_SIGHT_RATE = 0.01
"""Bound of the rate, rad/s, at which angles between targets change; 7.5 km/s at 750 km."""

ROUNDING = 2e-5
"""Angle, rad, within which directions agree with those of recorded flights; positions are good to meters."""

PAIRS = 1 << 14
"""Pairs of windows whose angles are computed at once."""

LAST_CLOSINGS = 3
"""Number of next-closing windows to search for one outside a pair."""


def spans(lengths: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the segment and the number in it of each item of consecutive segments of ``lengths`` [n], and where these begin."""
    segment = torch.repeat_interleave(torch.arange(len(lengths)), lengths)
    begin = torch.cumsum(lengths, 0) - lengths
    return segment, torch.arange(len(segment)) - begin[segment], begin


@dataclass(frozen=True)
class ImageGraph:
    """Windows, nodes and edges of the satellites of some episodes; nodes are sorted by satellite, cell, window and sector.

    Attributes:
        ticks: Ticks in a cell.
        cells: Number of cells.
        reach: Cells after which any target may follow any other.
        rows: Number of satellites.
        row, target: Satellite and target of each window, [w].
        window, cell, previous: Window and cell of each node, and the node of that window and sector one cell before, -1 for
            none, [n].
        late: How long after the window of each node its image comes at least, [n] ticks.
        node_begin: First node of each satellite, [rows + 1].
        edge_begin: First edge into each node, [n + 1].
        source, pair: Node that an edge comes from, and its pair of windows, [e] int32.
        pair_from, pair_to, pair_cells: Windows of each pair, and the least cells between images of them, [p].
    """

    ticks: int
    cells: int
    reach: int
    rows: int
    row: Tensor
    target: Tensor
    window: Tensor
    cell: Tensor
    previous: Tensor
    late: Tensor
    node_begin: Tensor
    edge_begin: Tensor
    source: Tensor
    pair: Tensor
    pair_from: Tensor
    pair_to: Tensor
    pair_cells: Tensor


class _Nodes(NamedTuple):
    first: Tensor
    length: Tensor
    begin: Tensor
    number: Tensor


def image_graph(
    openings: Openings, r_P: Tensor, r_LP_P: Tensor, envelope: Envelope, ticks: int, cells: int, pause: int | None = None
) -> ImageGraph:
    """Return the graph of n satellites.

    Args:
        openings: When images may be completed, windows longer by ``envelope.reserve``.
        r_P: Earth-fixed positions in the middle of each cell, [n, cells, 3] m.
        r_LP_P: Earth-fixed positions of the targets, [n, T, 3] m.
        envelope: Least times between images.
        ticks: Ticks in a cell.
        cells: Number of cells.
        pause: Ticks after which other actions than images may end; None if there are none.
    """
    row, target = openings.row, openings.target
    first, last = openings.first // ticks, openings.last // ticks
    length, rows = last - first + 1, len(r_P)
    window, offset, begin = spans(length)
    cell, n = first[window] + offset, len(window)
    order = torch.argsort((row[window] * cells + cell) * (len(row) + 1) + window)
    number = torch.empty_like(order)
    number[order] = torch.arange(n)
    before = torch.where(offset > 0, number[(torch.arange(n) - 1).clamp(min=0)], -1)[order]
    nodes, slack, sectors = _Nodes(first, length, begin, number), ticks - 1, envelope.sectors + 1
    reach = max(-(-(envelope.longest - slack) // ticks), int(length.max()) if len(length) else 0) + 1
    closings = None if envelope.any == envelope.direct else _closings(openings, rows, pause)
    none = torch.zeros(0, dtype=torch.int64)
    edges, pairs, total = [(none.int(),) * 3], [(none,) * 3], 0
    pointings = _pointings(openings, window, cell, r_P, r_LP_P, envelope)
    for origin, goal in _pairs(row, target, first, last, reach, rows):
        leave, reached = r_LP_P[row[origin], target[origin]], r_LP_P[row[goal], target[goal]]
        new = sector_from(leave, reached, envelope.sectors) if envelope.sectors else torch.zeros_like(origin)
        stays = (reached - leave).norm(dim=-1) < envelope.near
        legs = _legs(openings, nodes, origin, goal, r_P, r_LP_P, closings, ticks)
        least = torch.full_like(origin, cells)
        for sector in range(sectors):
            arrival = _arrivals(legs, pointings[sector], envelope, ticks)
            source, destination, pair, shortest = _edges(nodes, origin, goal, arrival, cells, reach)
            at = destination * sectors + torch.where(stays, sector, new)[pair]
            edges.append(((source * sectors + sector).int(), at.int(), (pair + total).int()))
            least = torch.minimum(least, shortest)
        pairs.append((origin, goal, least))
        total += len(origin)
    source, destination, pair = (torch.cat(column) for column in zip(*edges, strict=True))
    pair_from, pair_to, pair_cells = (torch.cat(column) for column in zip(*pairs, strict=True))
    destination, by = torch.sort(destination, stable=True)
    index, offset = torch.arange(n * sectors) // sectors, torch.arange(n * sectors) % sectors
    return ImageGraph(
        ticks, cells, reach, rows, row, target, window[order][index], cell[order][index],
        previous=torch.where(before[index] < 0, -1, before[index] * sectors + offset),
        late=(cell * ticks - (openings.last - envelope.reserve)[window]).clamp(min=0)[order][index],
        node_begin=torch.searchsorted(row[window][order], torch.arange(rows + 1)) * sectors,
        edge_begin=torch.searchsorted(destination, torch.arange(n * sectors + 1, dtype=torch.int32)),
        source=source[by], pair=pair[by], pair_from=pair_from, pair_to=pair_to, pair_cells=pair_cells,
    )  # fmt: skip


def _pairs(row: Tensor, target: Tensor, first: Tensor, last: Tensor, reach: int, rows: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield windows that an image may leave and those that it may lead to within reach, [p] each."""
    number = torch.bincount(row, minlength=rows).tolist()
    begin = 0
    for count in number:
        part = slice(begin, begin + count)
        opens, closes, kind = first[part], last[part], target[part]
        follows = (opens.unsqueeze(1) < closes) & (opens <= closes.unsqueeze(1) + reach) & (kind.unsqueeze(1) != kind)
        origin, goal = torch.nonzero(follows, as_tuple=True)
        yield from zip((origin + begin).split(PAIRS), (goal + begin).split(PAIRS), strict=True)
        begin += count


class _Closings(NamedTuple):
    """Ticks at which windows close, sorted within each satellite, padded; their windows; and the ticks of other actions."""

    tick: Tensor
    window: Tensor
    pause: int | None


def _closings(openings: Openings, rows: int, pause: int | None) -> _Closings:
    count = torch.bincount(openings.row, minlength=rows)
    width = int(count.max()) + LAST_CLOSINGS if len(count) else LAST_CLOSINGS
    order = torch.argsort(openings.row * (int(openings.last.max()) + 2 if len(openings.row) else 1) + openings.last)
    row = openings.row[order]
    column = torch.arange(len(order)) - (torch.cumsum(count, 0) - count)[row]
    tick = torch.full((rows, width), 1 << 40, dtype=torch.int64)
    window = torch.full((rows, width), -1, dtype=torch.int64)
    tick[row, column], window[row, column] = openings.last[order] - 1, order  # last has a tick of margin
    return _Closings(tick, window, pause)


def _next_closing(closings: _Closings, row: Tensor, after: Tensor, origin: Tensor, goal: Tensor) -> Tensor:
    """Return the first tick behind ``after`` [m] at which a window other than ``origin`` and ``goal`` closes, [m]."""
    big = 1 << 41
    keys = (closings.tick + big * torch.arange(len(closings.tick)).unsqueeze(1)).flatten()
    at = torch.searchsorted(keys, after + 1 - 2 + big * row)  # two ticks of margin
    k = (at.unsqueeze(1) + torch.arange(LAST_CLOSINGS)).clamp(max=len(keys) - 1)
    window = closings.window.flatten()[k]
    excluded = (window == origin.unsqueeze(1)) | (window == goal.unsqueeze(1))
    return torch.where(excluded, 1 << 40, closings.tick.flatten()[k]).amin(1)


def _pointings(openings: Openings, window: Tensor, cell: Tensor, r_P: Tensor, r_LP_P: Tensor, envelope: Envelope) -> list[Tensor]:
    """Return for every sector the direction of satellites that image the ``window`` [n] in a ``cell`` [n], [n, 3] each."""
    row = openings.row[window]
    eye, at, sectors = r_P[row, cell], r_LP_P[row, openings.target[window]], envelope.sectors
    return [pointing(eye, at, torch.full_like(row, sector), envelope.lag, sectors) for sector in range(sectors + 1)]


class _Legs(NamedTuple):
    """Ways from every cell of the first window of every pair to its second window: what does not depend on the sector.

    The node and the cell where they begin, the direction of the second target, and when another window may close, if ever.
    """

    node: Tensor
    cell: Tensor
    sight: Tensor
    closing: Tensor | None


def _legs(
    openings: Openings,
    nodes: _Nodes,
    origin: Tensor,
    goal: Tensor,
    r_P: Tensor,
    r_LP_P: Tensor,
    closings: _Closings | None,
    ticks: int,
) -> _Legs:
    pair, k, _ = spans(nodes.length[origin])
    cell, row = nodes.first[origin][pair] + k, openings.row[origin][pair]
    sight = torch.nn.functional.normalize(r_LP_P[row, openings.target[goal][pair]] - r_P[row, cell], dim=-1)
    closing = None
    if closings is not None:
        closing = _next_closing(closings, row, cell * ticks, origin[pair], goal[pair])
        if closings.pause is not None:
            closing = torch.minimum(closing, cell * ticks + closings.pause)
    return _Legs(nodes.begin[origin][pair] + k, cell, sight, closing)


def _arrivals(legs: _Legs, pointings: Tensor, envelope: Envelope, ticks: int) -> Tensor:
    """Return the first cell of the image at the end of each leg, for satellites that point as ``pointings`` [n, 3] say."""
    angle = (pointings[legs.node] * legs.sight).sum(-1).clamp(-1.0, 1.0).acos()
    late = 0.5 * (ticks - 1) * envelope.step  # between the middle of a cell and its ticks, s
    angle = (angle - late * LINE_OF_SIGHT_RATE - ROUNDING).clamp(min=0.0)
    earliest = legs.cell * ticks
    arrival = earliest + envelope.least(angle, direct=True)
    if legs.closing is not None:
        indirect = torch.maximum(earliest + envelope.least(angle, direct=False), legs.closing + SOONEST)
        arrival = torch.minimum(arrival, indirect)
    return torch.maximum(arrival // ticks, legs.cell + 1)


def _edges(
    nodes: _Nodes, origin: Tensor, goal: Tensor, arrival: Tensor, cells: int, reach: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return source, destination and pair of every edge, and the least cells of every pair."""
    pair, k, _ = spans(nodes.length[origin])
    cell = nodes.first[origin][pair] + k
    span, offset, begin = spans(nodes.length[goal])
    to = (arrival - nodes.first[goal][pair]).clamp(min=0)
    inside = to < nodes.length[goal][pair]
    latest = torch.zeros(len(span), dtype=torch.int64)
    latest.scatter_reduce_(0, (begin[pair] + to)[inside], (cell + 1)[inside], "amax")
    stride = cells + 2
    latest = torch.cummax(span * stride + latest, 0).values - span * stride - 1
    time = nodes.first[goal][span] + offset
    valid = (latest >= 0) & (time - latest < reach)
    least = torch.full((len(origin),), cells, dtype=torch.int64).scatter_reduce(0, pair, arrival - cell, "amin")
    span, time, latest = span[valid], time[valid], latest[valid]
    i, j = origin[span], goal[span]
    source = nodes.number[nodes.begin[i] + latest - nodes.first[i]]
    return source, nodes.number[nodes.begin[j] + time - nodes.first[j]], span, least
