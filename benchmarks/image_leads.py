"""Times between images that satellites cannot beat for long: fitted to flights, with a bound on how far ahead they get.

A single slew may be much shorter than usual, because the satellite was on its way already; that luck does not repeat. So let f
be a time for every angle from where a satellite points to its next target, and let a clock run behind the images of a flight at
ticks t_k::

    v_1 = t_1,  v_k = max(t_k, v_(k-1) + f(angle from pointing s_(k-1) at target k-1 to target k, seen at v_(k-1)))

The sector s_k that the satellite comes from is decided by the positions of targets k-1 and k, and by s_(k-1) where they are near
one another (:mod:`bsk_torch.lab.bounds.envelope`); the first image has none. The lead v_k - t_k is how far the satellite is
ahead of these times: that of a leaky bucket. Images at v_k instead of t_k are f apart. With the end b_k of the window of image k,

    l_k = max(0, v_k - b_k)

is how late it is there: at most its lead, and mostly nothing, since few images are taken at the end of their window. Where no
image is later than a reserve R, and all of a flight together no later than a budget L, a bound over schedules with times f,
windows that close R later and lateness of at most L together holds for all such flights, whatever the order of their images: f
may depend on anything that the order of the targets and the clock decide, since a schedule has the same. With f near the usual
times hardly an image is late; with R = 0 every single transition would have to obey f. (The bucket is that of Cruz, "A calculus
for network delay", IEEE Transactions on Information Theory 37, 1991.)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.frames import angle_between
from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import Policy
from bsk_torch.lab.bounds.envelope import SOONEST, Envelope, pointing, quantile, sector_from
from bsk_torch.lab.bounds.transitions import image_steps, imaging_satellite
from bsk_torch.lab.bounds.windows import openings, satellite_positions

if TYPE_CHECKING:
    import numpy as np

NODES, SPACING = 7, 20
"""Positions kept behind every image, and ticks between them: 60 s, between which parabolas are good to meters."""

PEAKS = 6
"""Most constraints that a flight adds in a round of the fit."""


class ImageSequences(NamedTuple):
    """Images of R flights in the order in which they were taken.

    Attributes:
        tick: Ticks at which their steps ended, [R, K]; -1 behind the last.
        r_LP_P: Earth-fixed positions of their targets, [R, K, 3] m.
        r_P: Earth-fixed positions of the satellite then and every :data:`SPACING` ticks later, [R, K, NODES, 3] m.
        closes: Last tick of the window of each image, [R, K]; -1 behind the last.
        returns: Return of each flight, [R]; with images that were carried over.
        carried: Number of excluded images that were carried over.
    """

    tick: Tensor
    r_LP_P: Tensor
    r_P: Tensor
    closes: Tensor
    returns: Tensor
    carried: int

    @classmethod
    def joined(cls, parts: list[ImageSequences]) -> ImageSequences:
        """The flights of all ``parts``."""
        width = max(part.tick.shape[1] for part in parts)
        tick, closes = (torch.cat([_padded(part[k], width, -1) for part in parts]) for k in (0, 3))  # type: ignore[arg-type]
        places, nodes = (torch.cat([_padded(part[k], width, 0) for part in parts]) for k in (1, 2))  # type: ignore[arg-type]
        returns = torch.cat([part.returns for part in parts])
        return cls(tick, places, nodes, closes, returns, sum(part.carried for part in parts))

    @property
    def transitions(self) -> int:
        """Number of pairs of successive images."""
        return int((self.tick[:, 1:] >= 0).sum())


def _padded(table: Tensor, width: int, value: float) -> Tensor:
    more = table.new_full((len(table), width - table.shape[1], *table.shape[2:]), value)
    return torch.cat([table, more], 1)


def record_images(env: SatelliteTasking, policy: Policy, seed: int) -> ImageSequences:
    """Play one episode in each row to its end and return its images, without those that were carried over.

    ValueError for a satellite that takes no images.
    """
    parts, carried, closing = [], 0, _closings(env, seed)
    returns = torch.zeros(len(env.env_ids), dtype=torch.float64)
    for step in image_steps(env, policy, seed):
        row = torch.nonzero(step.fresh).flatten()
        later = step.now[row].unsqueeze(1) + SPACING * torch.arange(NODES)
        time = later.clamp(max=int(env.state.limit_ticks.max())).flatten() * env.simulator.h
        nodes = satellite_positions(step.satellite, row.repeat_interleave(NODES), time).view(-1, NODES, 3)
        target = step.target[row]
        parts.append((row, step.now[row], step.r_LP_P[row, target], nodes, closing(row, target, step.now[row])))
        carried += int(step.carried.sum())
        returns += step.reward
    row, tick, place, nodes, close = (torch.cat(column) for column in zip(*parts, strict=True))
    row, order = torch.sort(row, stable=True)
    count = torch.bincount(row, minlength=len(returns))
    column = torch.arange(len(row)) - (torch.cumsum(count, 0) - count)[row]
    shape = len(count), max(1, int(count.max()))
    ticks, closes = (torch.full(shape, -1, dtype=torch.int64).index_put((row, column), x[order]) for x in (tick, close))
    places = place.new_zeros(*shape, 3).index_put((row, column), place[order])
    later = nodes.new_zeros(*shape, NODES, 3).index_put((row, column), nodes[order])
    return ImageSequences(ticks, places, later, closes, returns, carried)


def _closings(env: SatelliteTasking, seed: int) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """Return a function of satellites, targets and ticks: the last tick of the window in which a step ended with an image."""
    satellite = imaging_satellite(env)
    env.set_seed(seed)
    env.reset()
    limit = env.state.limit_ticks
    windows = openings(satellite, limit)
    targets, ticks = int(windows.target.max()) + 1, int(limit.max()) + 1
    key, order = torch.sort((windows.row * targets + windows.target) * ticks + windows.last)

    def closing(row: Tensor, target: Tensor, tick: Tensor) -> Tensor:
        at = torch.searchsorted(key, (row * targets + target) * ticks + tick).clamp(max=len(key) - 1)
        window = order[at]
        matches = (windows.row[window] == row) & (windows.target[window] == target)
        return torch.where(matches, windows.last[window], tick)  # an image outside of windows is as late as it is ahead

    return closing


class Leads(NamedTuple):
    """How far satellites are ahead of times between images.

    Attributes:
        lead: Lead at each image, [R, K] int64 ticks.
        angle: Angle to the target of each image from where the satellite points at the one before, as seen at the time of the
            clock, [R, K] rad; NaN for the first image and behind the last.
    """

    lead: Tensor
    angle: Tensor


def leads(images: ImageSequences, envelope: Envelope) -> Leads:
    """Return how far the satellites of all flights are ahead of the times of ``envelope``; see the module.

    Satellites are followed for 60 s behind each image; the clock of a longer lead sees them where they are then.
    """
    tick, lead = images.tick, torch.zeros_like(images.tick)
    angle = torch.full(tick.shape, torch.nan, dtype=torch.float64)
    sector = sectors_of(images, envelope)
    for k in range(1, tick.shape[1]):  # the clock of an image starts from that of the one before; all flights at once
        exists, before = tick[:, k] >= 0, lead[:, k - 1]
        position = _later(images.r_P[:, k - 1], before)
        start = pointing(position, images.r_LP_P[:, k - 1], sector[:, k - 1], envelope.lag, envelope.sectors)
        slew = angle_between(start, images.r_LP_P[:, k] - position)
        advance = before + envelope.least(slew.nan_to_num(), direct=True) - (tick[:, k] - tick[:, k - 1])
        lead[:, k] = torch.where(exists, advance.clamp(min=0), 0)
        angle[:, k] = torch.where(exists, slew, torch.nan)
    return Leads(lead, angle)


def lateness(images: ImageSequences, envelope: Envelope) -> Tensor:
    """Return how late all images are on the clock of ``envelope``, [R, K] int64 ticks; see the module."""
    late = images.tick + leads(images, envelope).lead - images.closes
    return torch.where(images.tick >= 0, late.clamp(min=0), 0)


def sectors_of(images: ImageSequences, envelope: Envelope) -> Tensor:
    """Return the sector that each image is approached from, [R, K]; ``envelope.sectors`` as long as there is none."""
    sectors = torch.full_like(images.tick, envelope.sectors)
    if envelope.sectors:
        before, at = images.r_LP_P[:, :-1], images.r_LP_P[:, 1:]
        new = sector_from(before, at, envelope.sectors)
        stays = (at - before).norm(dim=-1) < envelope.near
        for k in range(1, sectors.shape[1]):
            sectors[:, k] = torch.where(stays[:, k - 1], sectors[:, k - 1], new[:, k - 1])
    return sectors


def _later(nodes: Tensor, ticks: Tensor) -> Tensor:
    """Return positions [R, 3] some ``ticks`` [R] behind the first of ``nodes`` [R, NODES, 3], by a parabola through three."""
    at = (ticks.double() / SPACING).clamp(max=NODES - 1)
    first = at.long().clamp(max=NODES - 3)
    s = (at - first).unsqueeze(1)
    a, b, c = (nodes[torch.arange(len(nodes)), first + k] for k in range(3))
    return a * (0.5 * (1.0 - s) * (2.0 - s)) + b * (s * (2.0 - s)) + c * (0.5 * s * (s - 1.0))


def bins_of(angle: Tensor, width: float, bins: int) -> Tensor:
    """Return how many of the angles, of any shape, lie in each bin, [bins]; NaN count nowhere."""
    values = angle[torch.isfinite(angle)]
    return torch.bincount((values / width).long().clamp(0, bins - 1), minlength=bins)


def sustained_envelope(
    images: ImageSequences,
    *,
    reserve: int,
    step: float,
    arguments: Mapping[str, str],
    weight: Tensor | None = None,
    width: float = 0.02,
    bins: int = 70,
    margin: int = 6,
    enough: int = 500,
    rounds: int = 30,
    lag: float = 0.0,
    sectors: int = 0,
    near: float = 0.0,
    share: float = 0.5,
) -> Envelope:
    """Return times between images that no flight is ever ahead of by more than the reserve of the envelope.

    A linear program maximizes ``sum_b weight_b f_b`` over times f that do not descend and are no longer than a quantile (by
    default the median) of their bin, under constraints that are added where a flight gets too far ahead: over the images in
    which its lead grew, the times must add up to no more than the time that it took, and the reserve.

    Args:
        images: Flights.
        reserve: Lead that the times are chosen for, ticks. The reserve of the envelope is the largest lead that remains after
            rounding, and ``margin``.
        step: Length of a tick, s.
        arguments: Arguments of the satellite.
        weight: Importance of each bin, [bins] (default: the number of recorded transitions in it).
        width: Width of the bins, rad.
        bins: Number of bins.
        margin: Ticks.
        enough: Number of transitions without which the quantile of a bin is not trusted: bins behind the last that has so many
            are no longer than that one.
        rounds: Maximum number of rounds of the program.
        lag: Angle by which satellites point short of targets, rad, on the side that they come from.
        sectors: Number of directions that are told apart for the lag.
        near: Distance between targets, m, below which the sector stays.
        share: Share of the transitions of a bin that are quicker than its longest admitted time; the rest may have waited.

    Raises:
        ValueError: For a share beyond 0 to 1, if no bin has enough transitions, or for a reserve longer than the recorded
            positions reach.
    """
    if not 0 <= reserve + margin <= (NODES - 1) * SPACING:
        raise ValueError(
            f"reserve={reserve}, margin={margin}: leads can be followed up to {(NODES - 1) * SPACING} ticks together"
        )
    if not 0.0 < share < 1.0:
        raise ValueError(f"share={share:g}: a share of the transitions lies between 0 and 1")
    soonest = (SOONEST,) * bins
    base = Envelope(width, soonest, soonest, step, dict(arguments), images.transitions, lag=lag, sectors=sectors, near=near)
    angle = leads(images, base).angle
    valid = torch.isfinite(angle[:, 1:])
    number = bins_of(angle, width, bins)
    trusted = torch.nonzero(number >= max(1, enough)).flatten()
    if not len(trusted):
        raise ValueError(
            f"{images.transitions} transitions: no bin of the angle has {enough} of them, so no times can be fitted; fly more "
            "episodes"
        )
    usual = quantile(angle[:, 1:][valid], images.tick.diff(dim=1)[valid], width, bins, share).clamp(min=SOONEST)
    usual = usual[torch.arange(bins).clamp(max=int(trusted[-1]))]
    worth = (number if weight is None else weight).double()
    worth = worth / worth.sum() + 1e-6  # bins without weight are as long as the constraints allow
    table, rows, limits = usual, [], []
    for _ in range(rounds):
        growth = leads(images, _with(base, table))
        counts, most = _constraints(images, growth, reserve, width, bins)
        if not len(most):
            break
        rows.append(counts)
        limits.append(most)
        table = _longest(torch.cat(rows), torch.cat(limits), worth, usual)
    envelope = _with(base, table)
    largest = int(leads(images, envelope).lead.max())
    return replace(envelope, typical=tuple(usual.tolist()), reserve=largest + margin)


def _with(envelope: Envelope, table: Tensor) -> Envelope:
    ticks = tuple(table.tolist())
    return replace(envelope, direct=ticks, any=ticks)


def _constraints(images: ImageSequences, growth: Leads, reserve: int, width: float, bins: int) -> tuple[Tensor, Tensor]:
    """Return constraints ``counts @ f <= most``, [c, bins] and [c], of the times in which leads grew beyond the reserve.

    One for the largest lead of each stretch without lead zero, of at most PEAKS stretches of a flight.
    """
    lead, k = growth.lead, torch.arange(growth.lead.shape[1])
    stretch = (lead == 0).cumsum(1)  # an image without lead starts a stretch
    start = torch.where(lead == 0, k, 0).cummax(1).values
    size = lead.shape[1] + 1
    top = torch.zeros(len(lead), size, dtype=torch.int64).scatter_reduce(1, stretch, lead, "amax")
    peaks = top.topk(min(PEAKS, size), 1)
    row, column = torch.nonzero(peaks.values > reserve, as_tuple=True)
    inside = stretch[row] == peaks.indices[row, column].unsqueeze(1)
    peak = torch.where(inside, lead[row], -1).argmax(1)
    begin = start[row, peak]
    counted = (k > begin.unsqueeze(1)) & (k <= peak.unsqueeze(1))
    index = (growth.angle[row].nan_to_num() / width).long().clamp(0, bins - 1)
    counts = torch.zeros(len(row), bins, dtype=torch.int64).scatter_add(1, index, counted.long())
    return counts, reserve + images.tick[row, peak] - images.tick[row, begin]


def _longest(counts: Tensor, most: Tensor, worth: Tensor, usual: Tensor) -> Tensor:
    """Return the times, [bins] ticks, of the greatest worth under ``counts @ f <= most``, rounded down."""
    import numpy as np
    from scipy.optimize import linprog
    from scipy.sparse import csr_matrix, diags, vstack

    bins = len(usual)
    ascending = diags([np.ones(bins - 1), -np.ones(bins - 1)], [0, 1], shape=(bins - 1, bins))
    matrix = vstack([ascending, csr_matrix(counts.double().numpy())]).tocsr()
    limit: np.ndarray = np.concatenate([np.zeros(bins - 1), most.double().numpy()])
    limits = [(float(SOONEST), float(time)) for time in usual.tolist()]
    solution = linprog(-worth.numpy(), A_ub=matrix, b_ub=limit, bounds=limits, method="highs")
    if solution.x is None:
        raise ValueError(f"no times between images keep within the reserve: {solution.message}")
    return torch.from_numpy(np.floor(solution.x + 1e-6)).long()
