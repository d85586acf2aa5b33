"""Upper bound on what satellites collect that image targets, for one satellite or for a constellation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bsk_torch._checks import whole
from bsk_torch.env.base import Tasking
from bsk_torch.lab.bounds.envelope import Envelope
from bsk_torch.lab.bounds.graph import ImageGraph, image_graph
from bsk_torch.lab.bounds.paths import best_paths
from bsk_torch.lab.bounds.tasks import check_task, payment, shortest_pause
from bsk_torch.lab.bounds.windows import Openings, openings, satellite_positions
from bsk_torch.sats import BoundImagingSatellite

WINDOWS = 20_000
"""Windows whose graph is kept in memory at once, about a gigabyte where targets are dense; fewer with sectors."""


@dataclass(frozen=True)
class ImagingBound:
    """Bounds of N episodes.

    Attributes:
        upper: No policy collects more, under the assumptions of :func:`imaging_bound`, [N].
        in_view: What the targets pay that come into view at all, [N].
        lower: Return of the best schedule found in the relaxation, [N]; a satellite may be unable to fly it. The optimum of the
            relaxation with these minimum times between images lies between this and ``upper``.
        target, tick: That schedule: targets by index, and the ticks at which their steps end, up to the reserve of the envelope
            late, [N, K]; -1 behind the last. Of a constellation, the images of one satellite follow those of the one before.
        satellite: Which satellite of the episode takes each image, [N, K].
    """

    upper: Tensor
    in_view: Tensor
    lower: Tensor
    target: Tensor
    tick: Tensor
    satellite: Tensor


def imaging_bound(
    env: Tasking, *, envelope: Envelope | None = None, iterations: int = 60, bits: int = 4, cell: int = 2, gap: float = 1e-3
) -> ImagingBound:
    """Return an upper bound on the return of each episode that has just begun.

    The bound is that of a relaxation: images of targets within their windows, as the environment finds them, with times between
    successive images of a satellite, and each target pays once. It assumes that

    * successive images are no closer in time than ``envelope`` says, or, where it has a reserve, images come no later than that
      after their windows on the clock of its times, and together no later than its lateness allows
      (:mod:`bsk_torch.lab.bounds.envelope`): it rests on recorded flights, not on a proof;
    * no image is carried over from a step that has just ended (:func:`~bsk_torch.lab.bounds.transitions.carried_over`); what
      policies collect alongside such images lies below the bound in any case;
    * power, storage and the first slew cost nothing; dying pays nothing.

    With the least times of single slews and full episodes of AEOS-v1 it is hardly lower than ``in_view``, whatever the number of
    targets tried. ``Envelope.load(SUSTAINED)`` has times that policies do not beat for long; with 10,000 targets, they lower the
    bound by more than a third, in more than ten times the computation: paths also remember the direction that satellites
    come from. Energy and storage of AEOSPower-v1 would suffice for images of all targets in view, so that constraints on them
    would not lower it (``docs/studies/bounds.md`` has the figures).

    Targets pay once by multipliers (:mod:`bsk_torch.lab.bounds.paths`); time is in cells of some ticks, rounded in favor of
    the satellite. In a constellation all satellites share the targets: the sum of their paths under the same multipliers.

    Args:
        env: An environment after ``reset``; what it returns afterwards does not change.
        envelope: Times between images (default: the least ones of single slews of the presets' agile satellite).
        iterations: Subgradients for the multipliers.
        bits: Neighbors that paths remember; each doubles the time.
        cell: Ticks in a cell, 1 or 2.
        gap: Fraction by which ``upper`` and ``lower`` may differ in the end.

    Raises:
        ValueError: For a task that the bound does not cover, before anything is computed, and for numbers out of range.
    """
    envelope = envelope or Envelope.load()
    check_task(env, envelope)
    whole("iterations", iterations, 1)
    if whole("cell", cell, 1) > 2 or whole("bits", bits, 0) > 8:
        raise ValueError(
            f"cell={cell}, bits={bits}: cells have 1 or 2 ticks, the least time between images; paths remember up to 8"
        )
    satellite = next(part for part in env.fleet.satellites if isinstance(part, BoundImagingSatellite))
    payments, count = payment(env), satellite.simulator.state.count
    limit = satellite.simulator.state.of_env(env.state.limit_ticks)
    windows = openings(satellite, limit)
    pause, parts = shortest_pause(env, satellite), []
    for envs in _batches(windows, len(payments), count, WINDOWS // (envelope.sectors + 1)):
        graph = graph_of(satellite, windows, envs, count, envelope, cell, int(limit.max()), pause)
        budget = count * envelope.most_late(int(limit.max()))
        paths = best_paths(graph, payments[envs], satellites=count, budget=budget, iterations=iterations, bits=bits, gap=gap)
        parts.append((paths, _schedule(graph, paths.nodes, count)))
    width = max(schedule[0].shape[1] for _, schedule in parts)
    columns = zip(*(schedule for _, schedule in parts), strict=True)
    pad = torch.nn.functional.pad
    target, tick, owner = (torch.cat([pad(x, (0, width - x.shape[1]), value=-1) for x in column]) for column in columns)
    visible = torch.zeros_like(payments)
    visible[windows.row // count, windows.target] = 1.0
    upper, lower = (torch.cat([getattr(paths, name) for paths, _ in parts]) for name in ("upper", "lower"))
    return ImagingBound(upper, (payments * visible).sum(1), lower, target, tick, owner)


def _batches(windows: Openings, envs: int, count: int, most: int) -> list[Tensor]:
    """Return consecutive episodes with together at most so many windows, one episode at least."""
    number = torch.bincount(windows.row // count, minlength=envs).tolist()
    batches, size = [[0]], number[0]
    for k in range(1, envs):
        if size + number[k] > most:
            batches.append([])
            size = 0
        batches[-1].append(k)
        size += number[k]
    return [torch.tensor(batch) for batch in batches]


def graph_of(
    satellite: BoundImagingSatellite,
    windows: Openings,
    envs: Tensor,
    count: int,
    envelope: Envelope,
    cell: int,
    limit: int,
    pause: int | None,
) -> ImageGraph:
    """Return the graph of some episodes.

    Args:
        satellite: Satellites of the environment, ``count`` in each episode.
        windows: When images of all episodes may be completed.
        envs: Consecutive episodes, [n].
        count: Satellites of an episode.
        envelope: Least times between images.
        cell: Ticks in a cell.
        limit: Largest number of ticks of an episode; orbits are solved that far, and images of the graph may come
            ``envelope.reserve`` later.
        pause: Ticks after which other actions than images may end; None if there are none.
    """
    rows = (envs.unsqueeze(1) * count + torch.arange(count)).flatten()
    inside = (windows.row >= rows[0]) & (windows.row <= rows[-1])
    row, target, first, last = (column[inside] for column in windows)
    some = Openings(row - rows[0], target, first, last + envelope.reserve)
    cells, h = (limit + envelope.reserve) // cell + 1, satellite.simulator.h
    middle = (torch.arange(cells, dtype=torch.float64) * cell + 0.5 * (cell - 1)).clamp(max=float(limit)) * h
    r_P = satellite_positions(satellite, rows.repeat_interleave(cells), middle.repeat(len(rows))).view(len(rows), cells, 3)
    r_LP_P = satellite.simulator.scenario_state["target_r_LP_P"][envs].repeat_interleave(count, 0)
    return image_graph(some, r_P, r_LP_P, envelope, cell, cells, pause)


def _schedule(graph: ImageGraph, nodes: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return targets, ticks and satellites of the images at ``nodes`` [E, K], by satellite and time."""
    exists = nodes >= 0
    width = max(1, int(exists.sum(1).max()))
    nodes, exists = nodes[:, :width], exists[:, :width]
    node = nodes.clamp(min=0)
    window = graph.window[node] if len(graph.window) else node
    row = graph.row[window] if len(graph.row) else node
    tick = (graph.cell[node] + 1) * graph.ticks - 1 if len(graph.window) else node
    key = torch.where(exists, row * (graph.cells * graph.ticks + 1) + tick, 1 << 60)
    order = torch.argsort(key, dim=1)
    exists = exists.gather(1, order)
    target = graph.target[window] if len(graph.row) else node
    return tuple(torch.where(exists, value.gather(1, order), -1) for value in (target, tick, row % count))  # type: ignore[return-value]
