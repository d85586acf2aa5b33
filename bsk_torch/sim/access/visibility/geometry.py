"""Formulas of the elevation limit and of passes between samples, for tensors and for the values of a kernel alike."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.sim.orbit.grid import PLAN_STEP

SAMPLES_PER_CELL = 8
"""Samples of a cell, the unit of the coarse screen, which compares only the middle one with all places."""

CLASSIFIED_SAMPLES = SAMPLES_PER_CELL + 2
"""Samples classified for each cell: its own and two more, so that each triple of neighbors is complete in some cell."""

RISE, SET, SHORT_PASS, ABOVE_LIMIT = 1, 2, 4, 8
"""Bits of an event code; ``ABOVE_LIMIT`` is set at the first and last sample of a search only."""

CULMINATION_TOLERANCE = 1e-4
"""Error bound of the maximum of a parabola through three clearances 30 s apart; for low circular orbits it is 1e-6."""


class SearchCells(NamedTuple):
    """Cells whose samples are to be classified: times in s, [m] each."""

    first: Tensor
    end: Tensor
    search_begin: Tensor  # first sample of the whole search
    search_end: Tensor  # last sample of the whole search


def classify(before: Tensor, here: Tensor, after: Tensor, is_first: Tensor, is_last: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Classify three successive clearances, of which the first may be NaN: rise or set of the last two, possible short pass.

    A short pass lies between two samples: no sample is above the limit, but the culmination may be: ``f_max`` is above
    -:data:`CULMINATION_TOLERANCE`. With the samples at x = -1, 0 and 1, the parabola through them has its maximum f_max at
    x_max::

        bend = 2 f(0) - f(-1) - f(1)     slope = f(1) - f(-1)
        x_max = slope / (2 bend)         f_max = f(0) + slope^2 / (8 bend)

    Each culmination belongs to the triple in whose middle the largest sample is. The first and the last triple of a search also
    cover maxima near its two ends, for which no such triple exists.
    """
    bend, slope = torch.clamp(2.0 * here - before - after, min=1e-12), after - before
    x_max, f_max = slope / (2.0 * bend), here + slope * slope / (8.0 * bend)
    below = (before <= 0.0) & (here <= 0.0) & (after <= 0.0) & (f_max > -CULMINATION_TOLERANCE)
    # x_max is an estimate: a tenth of a step of slack keeps maxima that lie just inside the search
    early, late = is_first & (here < before) & (x_max > -1.1), is_last & (here < after) & (x_max < 1.1)
    short_pass = below & (((here >= before) & (here >= after)) | early | late)
    return (here <= 0.0) & (after > 0.0), (here > 0.0) & (after <= 0.0), short_pass


def event_code(before: Tensor, here: Tensor, after: Tensor, time: Tensor, cells: SearchCells) -> Tensor:
    """Return the event code of three successive clearances, the last at ``time`` s, as a sum of bits in floating point.

    Events behind the end of the cell (which the next cell reports) or of the search are left out.
    """
    half = 0.5 * PLAN_STEP  # sample times are compared half a step off, out of reach of rounding
    is_first, is_last = time < cells.search_begin + 5.0 * half, time > cells.search_end - half
    rises, sets, short_pass = classify(before, here, after, is_first, is_last)
    in_cell, in_search = time < cells.end + half, time < cells.search_end + half
    zero = torch.zeros_like(after)
    code = torch.where(in_cell & rises, float(RISE), torch.where(in_cell & sets, float(SET), zero))
    code = torch.where(in_search & short_pass, code + float(SHORT_PASS), code)
    at_end = in_cell & ((time < cells.search_begin + half) | is_last)
    return torch.where(at_end & (after > 0.0), code + float(ABOVE_LIMIT), code)
