"""Interface of the geometry of visibility."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor

from bsk_torch.sim.access.visibility.geometry import SearchCells
from bsk_torch.sim.access.visibility.pairs import Brackets, PlacePairs
from bsk_torch.sim.access.visibility.planned import PlannedOrbits


class Visibility(Protocol):
    """Visibility along planned orbits of n satellites, every 30 s or at the times at which an elevation limit is crossed."""

    kernels: bool
    """Whether kernels compute it, and queries of windows and eclipses too."""

    def umbra(self, orbits: PlannedOrbits, start: Tensor, count: int) -> Tensor:
        """Return :func:`~bsk_torch.astro.eclipse.umbra_depth` at ``count`` samples from ``start`` [n] s on, [n, count]."""

    def ground_track(self, orbits: PlannedOrbits, start: Tensor, count: int) -> Tensor:
        """Return Earth-fixed positions at ``count`` samples from ``start`` [n] s on, [n, count, 3] m."""

    def events(self, pairs: PlacePairs, cells: SearchCells) -> Tensor:
        """Return event codes, [m, CLASSIFIED_SAMPLES]; see :func:`bsk_torch.sim.access.visibility.geometry.event_code`."""

    def clearance(self, pairs: PlacePairs, time: Tensor) -> Tensor:
        """Return the clearance of each pair at its time [m] s, [m]; see ``elevation_clearance``."""

    def crossings(self, pairs: PlacePairs, brackets: Brackets) -> Tensor:
        """Return the times at which the clearance is zero between the bracketing times, [m] s."""

    def culminations(self, pairs: PlacePairs, a: Tensor, b: Tensor) -> Tensor:
        """Return the times of the largest clearance between ``a`` and ``b`` [m], [m] s."""
