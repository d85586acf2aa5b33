"""Windows of passes: the passes themselves, or those of BSK-RL's search, interval after interval.

It propagates its trajectory by one interval at a time. In each interval it samples only the times at which the satellite is
near the place, and takes the first and the last of these for the ends of a window or searches for a crossing next to them. That
has consequences which agents see, and which ``compat="bsk_rl"`` reproduces: an interval that lies within a pass gives no window,
a pass that rises in an interval and outlasts it can be taken for one that sets, and passes are lost where the satellite is near
the place for more than a quarter of a revolution (:mod:`bsk_torch.sim.access.passes.literal_search`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from bsk_torch.sim.access.passes.literal_search import NEAR, searched_by_interval
from bsk_torch.sim.access.passes.passes import SHORTEST_PASS, GroundTrack, Passes, PassSearch
from bsk_torch.sim.orbit.grid import PLAN_STEP

LONG_SPAN = 1.3
"""Angle, rad, by which a satellite may turn about the Earth while it is near a place, at most, for the search to find its pass.

Where both ends of a span of length L are below the limit, scipy's search for a bracket evaluates the elevation 1.618 L behind it.
That point, 2.118 L from the middle, must lie within half a revolution of it: L < 1.48 rad.
"""


class GenerationIntervals(NamedTuple):
    """Intervals for which windows are generated: one up to ``first``, and the others, of equal length, up to ``end``."""

    begin: Tensor  # begin of the first interval and of the search, [n] s
    first: Tensor  # end of the first interval, [n] s
    end: Tensor  # end of the last interval, [n] s
    segment: float  # length of the others, s

    def number(self, row: Tensor, time: Tensor) -> Tensor:
        """Return the number of the interval that holds a time [m] s of a row [m]."""
        later = torch.floor((time - self.first[row]) / self.segment) + 1.0
        return torch.where(time < self.first[row], torch.zeros_like(later), later)

    def start(self, row: Tensor, number: Tensor) -> Tensor:
        """Return the time, [m] s, at which an interval begins."""
        return torch.where(number > 0.0, self.first[row] + (number - 1.0) * self.segment, self.begin[row])


def close_from_start(search: PassSearch, row: Tensor, place: Tensor, start: Tensor, end: Tensor, rise: Tensor) -> Tensor:
    """Return whether the close samples of an interval begin with the interval, [m].

    Close samples are those at a distance below ``1.1 (R - |r_LP|) / sin(e_min)``, 1.1 times the slant range at the minimum
    elevation over a flat Earth, where R is the largest distance from the Earth's center in the interval. The sample at the
    start itself does not matter. Pass m of satellite ``row`` over ``place`` rises at ``rise`` s within an interval from
    ``start`` to ``end`` s.
    """
    first = ((start - search.track.start[row]) / PLAN_STEP).round().long().unsqueeze(-1)
    count = ((end - start) / PLAN_STEP).round().long().unsqueeze(-1)
    number = torch.arange(1 + int(count.max()) if len(count) else 1, device=row.device)
    r_BP_P = search.track.r_BP_P[row.unsqueeze(-1), (first + number).clamp(max=search.track.r_BP_P.shape[1] - 1)]
    _, r_LP_P, sin_min_elevation, _ = search.pairs(row, place)
    highest = torch.where(number <= count, r_BP_P.norm(dim=-1), 0.0).amax(-1)
    threshold = NEAR * (highest - r_LP_P.norm(dim=-1)) / sin_min_elevation
    close = (r_BP_P - r_LP_P.unsqueeze(1)).norm(dim=-1) < threshold.unsqueeze(-1)
    before_rise = (number > 0) & (number * PLAN_STEP < (rise - start).unsqueeze(-1))
    return (close | ~before_rise).all(-1)


def within(passes: Passes, intervals: GenerationIntervals) -> Passes:
    """Return what lies of passes between the begin of the first interval and the end of the last."""
    row, place, opens, closes = passes
    begin, end = intervals.begin[row], intervals.end[row]
    # a pass that rises at the end belongs to the next search, one that sets at the begin to the last one
    kept = (opens < end) & (closes > begin)
    opens, closes = torch.maximum(opens, begin), torch.minimum(closes, end)
    return Passes(*(part[kept] for part in (row, place, opens, closes)))


def true_windows(track: GroundTrack, passes: Passes, intervals: GenerationIntervals) -> Passes:
    """Return the passes between the ends of the intervals, cut there, without the short ones."""
    row = passes.row
    # how long those last that are in progress at an end of the ground track is not known
    in_progress = (passes.open <= track.start[row]) | (passes.close >= track.end[row])
    long = in_progress | (passes.close - passes.open > SHORTEST_PASS)
    return within(Passes(*(part[long] for part in passes)), intervals)


def windows_by_interval(search: PassSearch, passes: Passes, intervals: GenerationIntervals) -> Passes:
    """Return the windows that the search generates, joined where one closes as the next opens.

    Most follow from the passes; satellites and places that are near each other for long are searched one by one.
    """
    long = long_spans(search, intervals)
    if not bool(long.any()):
        return windows_of_short_spans(search, passes, intervals)
    short = ~long[passes.row, passes.place]
    quick = windows_of_short_spans(search, Passes(*(part[short] for part in passes)), intervals)
    return Passes(*(torch.cat(parts) for parts in zip(quick, _searched(search, intervals, long), strict=True)))


def long_spans(search: PassSearch, intervals: GenerationIntervals) -> Tensor:
    """Return which satellites may be near which places, [n, P], for longer than :data:`LONG_SPAN` within an interval.

    A satellite at a distance r of at least r_min is near a place at R_p while its central angle from it is below theta, with
    ``cos theta = (r_min^2 + R_p^2 - d^2) / (2 r_min R_p)`` and d as in :func:`close_from_start`. On an eccentric orbit it turns
    ``(r_max / r_min)^2`` times as fast at one end as at the other.
    """
    r_BP_P, places = search.track.r_BP_P, search.places
    distance, radius = r_BP_P.norm(dim=-1), places.r_LP_P.norm(dim=-1)
    turn = (r_BP_P[:, 1:] * r_BP_P[:, :-1]).sum(-1) / (distance[:, 1:] * distance[:, :-1])
    rate = torch.acos(turn.amin(-1, keepdim=True).clamp(max=1.0)) / PLAN_STEP
    low, high = distance.amin(-1, keepdim=True), distance.amax(-1, keepdim=True)
    reach = NEAR * (high - radius) / places.sin_min_elevation
    cosine = (low**2 + radius**2 - reach**2) / (2.0 * low * radius)
    lasts = (intervals.first - intervals.begin).clamp(min=intervals.segment).unsqueeze(-1)
    angle = torch.minimum(2.0 * torch.acos(cosine.clamp(-1.0, 1.0)), rate * lasts) + 2.0 * rate * PLAN_STEP
    return angle * (high / low) ** 2 > LONG_SPAN


def _searched(search: PassSearch, intervals: GenerationIntervals, chosen: Tensor) -> Passes:
    """Return the windows of satellites and places that are ``chosen`` [n, P], which are searched one by one."""
    found: list[tuple[int, int, float, float]] = []
    for row in torch.nonzero(chosen.any(-1)).squeeze(-1).tolist():
        place = torch.nonzero(chosen[row]).squeeze(-1)
        pairs = search.pairs(torch.full_like(place, row), place)
        first, end = float(intervals.first[row]), float(intervals.end[row])
        windows = searched_by_interval(
            search.track.r_BP_P[row].cpu().numpy(),
            float(search.track.start[row]),
            [float(intervals.begin[row]), *np.arange(first, end + 0.5 * PLAN_STEP, intervals.segment).tolist()],
            pairs.r_LP_P.cpu().numpy(),
            pairs.sin_min_elevation.arcsin().cpu().numpy(),
        )
        found += [(row, int(place[k]), opens, closes) for k, opens, closes in windows]
    device, numbers = chosen.device, list(zip(*found, strict=True)) or [(), (), (), ()]
    kinds = torch.int64, torch.int64, torch.float64, torch.float64
    return Passes(*(torch.tensor(part, dtype=kind, device=device) for part, kind in zip(numbers, kinds, strict=True)))


def windows_of_short_spans(search: PassSearch, passes: Passes, intervals: GenerationIntervals) -> Passes:
    """Return the windows that the search generates for passes, joined where one closes as the next opens.

    A pass within one interval is a window. A pass over several intervals gives a window in its first interval (the head) and one
    in its last (the tail), and none in those that it fills. The head ends with its interval, and is joined to the tail if that
    follows at once; but where the close samples begin with the interval, the rise is taken for a set, and the head reaches from
    the start of the interval to the rise.
    """
    row, place, opens, closes = within(passes, intervals)
    first = intervals.number(row, opens)
    last = intervals.number(row, closes)
    begin, boundary = intervals.start(row, first), intervals.start(row, first + 1.0)
    in_progress, goes_on = opens <= intervals.begin[row], last > first
    rising = torch.nonzero(goes_on & ~in_progress).squeeze(-1)
    reversed_ = torch.zeros_like(goes_on)
    reversed_[rising] = close_from_start(search, *(part[rising] for part in (row, place, begin, boundary, opens)))
    joined = goes_on & (last == first + 1.0) & ~reversed_ & ~in_progress
    head_open = torch.where(reversed_, begin, opens)
    head_close = torch.where(reversed_, opens, torch.where(goes_on & ~joined, boundary, closes))
    short = (opens > begin) & ~goes_on & (closes - opens <= SHORTEST_PASS)
    head = ~(in_progress & goes_on) & ~short
    tail = goes_on & ~joined & (closes < intervals.end[row])
    return Passes(
        torch.cat([row[head], row[tail]]),
        torch.cat([place[head], place[tail]]),
        torch.cat([head_open[head], intervals.start(row, last)[tail]]),
        torch.cat([head_close[head], closes[tail]]),
    )
