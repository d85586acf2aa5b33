"""Windows of passes: the passes themselves, or what bsk_rl makes of them, interval after interval.

bsk_rl propagates its trajectory by one interval at a time. In each interval it samples only the times at which the satellite is
near the place, and takes the first and the last of these for the ends of a window or searches for a crossing next to them. That
has consequences which agents see, and which ``compat="bsk_rl"`` reproduces: an interval that lies within a pass gives no window,
and a pass that rises in an interval and outlasts it can be taken for one that sets.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.sim.access.passes import SHORTEST_PASS, GroundTrack, Passes, PassSearch
from bsk_torch.sim.orbit.grid import PLAN_STEP


class GenerationIntervals(NamedTuple):
    """Intervals for which windows are generated: one up to ``first``, and the others, of equal length, up to ``end``.

    Attributes:
        begin: Begin of the first interval and of the search, [n] s.
        first: End of the first interval, [n] s.
        end: End of the last interval, [n] s.
        segment: Length of the others, s.
    """

    begin: Tensor
    first: Tensor
    end: Tensor
    segment: float

    def number(self, row: Tensor, time: Tensor) -> Tensor:
        """Return the number of the interval that holds a time [m] s of a row [m]."""
        later = torch.floor((time - self.first[row]) / self.segment) + 1.0
        return torch.where(time < self.first[row], torch.zeros_like(later), later)

    def start(self, row: Tensor, number: Tensor) -> Tensor:
        """Return the time, [m] s, at which an interval begins."""
        return torch.where(number > 0.0, self.first[row] + (number - 1.0) * self.segment, self.begin[row])


def close_from_start(search: PassSearch, row: Tensor, place: Tensor, start: Tensor, end: Tensor, rise: Tensor) -> Tensor:
    """Return whether bsk_rl's close samples of an interval begin with the interval, [m].

    Close samples are those at a distance below ``1.1 (R - |r_LP|) / sin(e_min)``, 1.1 times the slant range at the minimum
    elevation over a flat Earth, where R is the largest distance from the Earth's center in the interval. The sample at the start
    itself does not matter.

    Args:
        search: Ground track and places.
        row: Satellite of each pass.
        place: Place of each pass.
        start: Begin of the interval, s.
        end: End of the interval, s.
        rise: Time of the rise within the interval, s.
    """
    first = ((start - search.track.start[row]) / PLAN_STEP).round().long().unsqueeze(-1)
    count = ((end - start) / PLAN_STEP).round().long().unsqueeze(-1)
    number = torch.arange(1 + int(count.max()) if len(count) else 1, device=row.device)
    r_BP_P = search.track.r_BP_P[row.unsqueeze(-1), (first + number).clamp(max=search.track.r_BP_P.shape[1] - 1)]
    _, r_LP_P, sin_min_elevation = search.pairs(row, place)
    highest = torch.where(number <= count, r_BP_P.norm(dim=-1), 0.0).amax(-1)
    threshold = 1.1 * (highest - r_LP_P.norm(dim=-1)) / sin_min_elevation
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


def windows_of_bsk_rl(search: PassSearch, passes: Passes, intervals: GenerationIntervals) -> Passes:
    """Return the windows that bsk_rl generates for passes, joined where one closes as the next opens.

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
