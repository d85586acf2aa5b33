"""Samples that ticks read, supplied by what knows them, such as a scenario, and not by the simulation itself."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.component import Track


class TrackSource(Protocol):
    """Supplies the samples of a track to the N satellites of a simulation; see ``Simulator.sources``."""

    def reach(self, time: Tensor) -> None:
        """Make the samples of runs from now on reach ``time`` [N] s."""

    def samples(self) -> Samples:
        """Return the samples for all N rows."""


def no_samples(track: Track, rows: int, device: torch.device) -> Samples:
    """Return samples for N rows where nothing supplies them: zeros."""
    table = torch.zeros(1, track.count, track.width, dtype=torch.float64, device=device)
    return Samples(table, table.new_zeros(1), torch.zeros(rows, dtype=torch.int64, device=device))
