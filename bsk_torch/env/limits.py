"""Ends of episodes in ticks."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import coverage
from bsk_torch.constants import NANO

ENDLESS = 2**31
"""Seconds after which Basilisk's clock stops an episode without limit; the Sun's ephemeris ends earlier."""


def whole_limit(limit: Tensor, et: Tensor, h_ns: int) -> tuple[Tensor, Tensor]:
    """Return time limits [n] s as numbers of ticks of ``h_ns`` nanoseconds, and the duration of these ticks in seconds.

    Episodes without limit end with the ephemeris; they begin at ET ``et`` [n] s.
    """
    seconds = torch.where(torch.isfinite(limit), limit, torch.clamp(coverage()[1] - et, max=ENDLESS))
    ticks = torch.ceil(torch.floor(seconds * 1e9 + 0.5) / h_ns)
    return ticks.long(), torch.where(torch.isfinite(limit), ticks * (h_ns * NANO), limit)
