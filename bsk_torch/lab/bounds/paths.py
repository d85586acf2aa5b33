"""Paths in a graph of images in which every target counts once: an upper bound by Lagrange multipliers, and near-optimal paths.

The bound of multipliers l >= 0, one for each target, and m >= 0 of the lateness, is

    sum_t l_t + m L + sum_s max over paths of satellite s of sum_(images) (p_t - l_t - m d)

with priorities p, the time d by which an image comes after its window, and the budget L of that time: paths may image a target
again and again, and may be late at will, which the multipliers make expensive. For all l and m it is no less than what any paths
collect that image each target once and together are no later than L. The multipliers descend along subgradients (images of a
target minus one, the lateness minus L), with momentum, by steps after Polyak. Paths remember which of a few neighbors of the last
target, those that are the quickest to come back from, they have imaged just before, and do not image them again. (Ng-routes of
Baldacci, Mingozzi and Roberti, "New route relaxation and pricing strategies for the vehicle routing problem", Operations Research
59, 2011.)
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.codegen.build import entry, load
from bsk_torch.lab.bounds.graph import ImageGraph

SOURCE = Path(__file__).with_name("paths.cpp")
"""The search for paths, in C++."""

SIGNATURE = "iiiiiii" + "p" * 14 + "i" + "p" * 6 + "i"

ROUNDING = 1e-12
"""Fraction by which sums of priorities may differ in another order."""

UNIT = 20.0
"""Lateness is counted in that of so many images, each as late as can be, so that steps suit all multipliers."""

MOST_IMAGES = 4096
"""Maximum number of returned images per episode."""


class Paths(NamedTuple):
    """What multipliers have shown of E episodes.

    Attributes:
        upper: No paths collect more, [E].
        lower: Sum collected by the best paths found, each target once, [E].
        price: Multiplier of the lateness, [E], per tick.
        nodes: Nodes of these paths, [E, MOST_IMAGES], -1 behind them.
    """

    upper: Tensor
    lower: Tensor
    price: Tensor
    nodes: Tensor


def neighbours(graph: ImageGraph, bits: int) -> Tensor:
    """Return the windows that paths remember at each window, those with the shortest way and back, [w, bits]; -1 for none."""
    windows, pairs = len(graph.row), len(graph.pair_from)
    memory = torch.full((windows, bits), -1, dtype=torch.int64)
    if not pairs or not bits:
        return memory
    key = graph.pair_from * windows + graph.pair_to
    key, order = torch.sort(key)
    back = graph.pair_to * windows + graph.pair_from
    at = torch.searchsorted(key, back).clamp(max=pairs - 1)
    cycle = torch.where(key[at] == back, graph.pair_cells + graph.pair_cells[order][at], graph.cells * 2)
    usable = cycle < graph.cells
    origin, goal, cycle = graph.pair_from[usable], graph.pair_to[usable], cycle[usable]
    by = torch.argsort(origin * (2 * graph.cells + 1) + cycle, stable=True)
    origin, goal = origin[by], goal[by]
    rank = torch.arange(len(origin)) - torch.searchsorted(origin, origin)
    close = rank < bits
    memory[origin[close], rank[close]] = goal[close]
    return memory


def best_paths(
    graph: ImageGraph,
    priority: Tensor,
    *,
    satellites: int = 1,
    budget: float = math.inf,
    iterations: int,
    bits: int = 4,
    gap: float = 1e-3,
) -> Paths:
    """Return bounds on what paths of the satellites of E episodes collect; see the module.

    Args:
        graph: Rows e * satellites + s are satellite s of episode e.
        priority: What the first image of each target pays, [E, T].
        satellites: Satellites of an episode.
        budget: Ticks by which images of an episode may together come after their windows.
        iterations: Number of subgradients.
        bits: Number of neighbors that paths remember.
        gap: Fraction by which upper and lower bound of an episode may differ in the end.
    """
    episodes, targets = priority.shape
    visible = torch.zeros_like(priority)
    visible[graph.row // satellites, graph.target] = 1.0
    payments = (priority * visible).clamp(min=0.0).double().contiguous()
    upper, lower = payments.sum(1), torch.zeros(episodes, dtype=torch.float64)
    multiplier = 0.9 * payments
    unit = UNIT * max(1.0, float(graph.late.max()) if len(graph.late) else 1.0)
    price, most = torch.zeros_like(lower), torch.full_like(lower, budget / unit)
    nodes = torch.full((episodes, MOST_IMAGES), -1, dtype=torch.int64)
    memory = neighbours(graph, bits)
    arrays = (
        graph.target, graph.window, graph.cell, graph.previous, graph.node_begin, graph.edge_begin, graph.source, graph.pair,
        graph.pair_from, graph.pair_to, memory, graph.late.double() / unit, most,
    )  # fmt: skip
    sizes = episodes, satellites, targets, graph.cells, graph.reach, bits, len(graph.pair_from)
    run = entry(load(SOURCE.read_text(), "bound of images"), SIGNATURE)
    tolerance = torch.tensor([gap], dtype=torch.float64)
    inputs = (*(a.contiguous() for a in arrays), payments)
    run(*sizes, *inputs, iterations, tolerance, multiplier, price, lower, upper, nodes, MOST_IMAGES)
    upper = torch.maximum(upper, lower) * (1.0 + ROUNDING)
    return Paths(upper, lower, price / unit, nodes)
