"""Interface of the geometry of visibility."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from torch import Tensor

from bsk_torch.astro.interpolate import BEFORE, COUNT
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.access.visibility.geometry import SearchCells
from bsk_torch.sim.access.visibility.planned import PlannedOrbits, take_rows
from bsk_torch.sim.component import Track, vec
from bsk_torch.sim.orbit.grid import PLAN_STEP

BISECTIONS, ROOT_ITERATIONS, CULMINATION_ITERATIONS = 10, 12, 25
"""Steps of the searches. Ten bisections of 30 s leave less than the shortest pass: there the clearance is nearly straight, and
regula falsi converges."""

GROUND_TRACK = Track("path", PLAN_STEP, (vec("r_BN_P", "m", exact=True),), COUNT, BEFORE)
"""Earth-fixed positions every 30 s, interpolated in between."""


class PlacePairs(NamedTuple):
    """Pairs of a satellite and a place."""

    track: Samples  # Earth-fixed samples of the satellite of each pair
    r_LP_P: Tensor  # Earth-fixed position of each place, [m, 3] m
    sin_min_elevation: Tensor  # sine of the minimum elevation at each place, [m]
    shift: Tensor | None = None  # axis_shift of each place, [m] m; None for elevations from the radius

    def take(self, index: Tensor) -> PlacePairs:
        """Return the pairs ``index``, which may repeat."""
        shift = None if self.shift is None else self.shift[index]
        return PlacePairs(take_rows(self.track, index), self.r_LP_P[index], self.sin_min_elevation[index], shift)


class Brackets(NamedTuple):
    """Times ``a`` and ``b`` [m], s, between which the clearance changes its sign, and the clearances at these times."""

    a: Tensor
    b: Tensor
    clearance_a: Tensor
    clearance_b: Tensor


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
