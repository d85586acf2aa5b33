"""Places of requests, each with its own times and limits; a scenario draws them."""

from __future__ import annotations

import copy

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.sim.places.base import DrawnTargets, Sites

RELEASE, DUE, DURATION = "target_release", "target_due", "target_duration"
"""Names of the drawn times of requests, s since reset, and of the time for which each is looked at, s; [num_envs, P]."""

MIN_ELEVATION, MAX_OFF_NADIR = "target_min_elevation", "target_max_off_nadir"
"""Names of their drawn limits, rad, [num_envs, P]; :data:`NO_OFF_NADIR` for none."""

NO_OFF_NADIR = 0.5 * torch.pi


class RequestPlaces(DrawnTargets):
    """Targets with windows from their release to their due time, above a minimum elevation and within an off-nadir angle of each.

    The minimum elevation of the satellite, and its light, hold as well. Windows that are shorter than the look of the request are
    none.
    """

    @classmethod
    def of(cls, targets: DrawnTargets) -> RequestPlaces:
        """Return the places of requests at ``targets``."""
        made = copy.copy(targets)
        made.__class__ = cls
        return made  # type: ignore[return-value]

    def value(self, name: str, rows: Tensor, place: Tensor) -> Tensor:
        """Return the drawn values ``name``, [m], of places [m] that satellites ``rows`` [m] see."""
        return self.tables.of_rows(name, rows, place)

    @override
    def sites(self, rows: Tensor) -> Sites:
        sites = super().sites(rows)
        least = self.tables.of_envs(MIN_ELEVATION, rows).sin()
        return sites._replace(sin_min_elevation=torch.maximum(sites.sin_min_elevation, least))
