"""Places in orbit, without attitude or tick: debris, satellites of others, a catalog to look at."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.astro.mean_orbit import mean_position
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.places.base import DrawnPlaces, Places
from bsk_torch.sim.places.clearance import Clearance, PlaceTables
from bsk_torch.vec3 import Mat3

SPEED_MARGIN = 1.02  # factor of the bound of speeds, for the short-period terms of J2


class OrbitingPlaces(DrawnPlaces):
    """Places on orbits about an oblate Earth, in closed form: six numbers each are all that an episode keeps.

    Positions differ from those that satellites would fly by about half a kilometer (median) and up to a few kilometers in two
    hours, see ``tests/astro/test_mean_orbit.py``: tenths of a second of an orbit.
    """

    def __init__(
        self,
        tables: PlaceTables,
        orbits: str,
        clearances: Sequence[Clearance],
        *,
        advice: str = Places.advice,
    ) -> None:
        """Describe places by what the scenario draws.

        Args:
            tables: Tables of the simulation.
            orbits: Name of the draw of mean elements at time zero, [num_envs, P, 6]: what
                :func:`bsk_torch.astro.mean_orbit.mean_elements` returns for positions and velocities.
            clearances: See :class:`~bsk_torch.sim.places.base.DrawnPlaces`.
            advice: Likewise.
        """
        super().__init__(tables, clearances, advice=advice)
        self._orbits = orbits

    @property
    @override
    def count(self) -> int:
        return self.tables.drawn[self._orbits].shape[1]

    @override
    def position(self, rows: Tensor, place: Tensor, time: Tensor) -> Tensor:
        r_LN_N = mean_position(self.tables.of_rows(self._orbits, rows, place), time)
        return (Mat3.of(self.tables.orientation(rows, time)) @ r_LN_N).stack()

    @override
    def max_speed(self, rows: Tensor) -> Tensor:  # the speed at perigee, and that of the Earth's rotation at apogee
        oe = self.tables.of_envs(self._orbits, rows)
        a, e = oe[..., 0], oe[..., 1]
        perigee = torch.sqrt(MU_EARTH / a * (1.0 + e) / (1.0 - e))
        return SPEED_MARGIN * (perigee + EARTH_ROTATION_RATE * a * (1.0 + e))
