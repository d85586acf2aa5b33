"""Places that move on the Earth, along great circles: ships, aircraft, clouds."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.sim.places.base import DrawnPlaces, Places
from bsk_torch.sim.places.clearance import Clearance, PlaceTables


class GreatCirclePlaces(DrawnPlaces):
    """Places that move along great circles of the Earth-fixed sphere through their starting points, at constant speed.

    The position is ``r = r0 cos(s) + |r0| d sin(s)`` with ``s = v t / |r0|``, where d is the unit vector of the course at r0.
    """

    def __init__(
        self,
        tables: PlaceTables,
        start: str,
        velocity: str,
        clearances: Sequence[Clearance],
        *,
        exists: str | None = None,
        advice: str = Places.advice,
    ) -> None:
        """Describe places by what the scenario draws.

        Args:
            tables: Tables of the simulation.
            start: Name of the draw of positions at time zero, [num_envs, P, 3] m, Earth-fixed.
            velocity: Name of the draw of velocities then, [num_envs, P, 3] m/s relative to the Earth; what they have along the
                vertical does not count.
            clearances: See :class:`~bsk_torch.sim.places.base.DrawnPlaces`, as for the other arguments.
            exists: Likewise.
            advice: Likewise.
        """
        super().__init__(tables, clearances, exists=exists, advice=advice)
        self._start, self._velocity = start, velocity

    @property
    @override
    def count(self) -> int:
        return self.tables.drawn[self._start].shape[1]

    @override
    def position(self, rows: Tensor, place: Tensor, time: Tensor) -> Tensor:
        r, v = (self.tables.of_rows(name, rows, place) for name in (self._start, self._velocity))
        radius = r.norm(dim=-1, keepdim=True)
        v = v - r * ((v * r).sum(-1, keepdim=True) / (radius * radius))
        speed = v.norm(dim=-1, keepdim=True)
        angle = speed / radius * time.unsqueeze(-1)
        course = v / torch.where(speed > 0.0, speed, torch.ones_like(speed))
        return r * torch.cos(angle) + course * (radius * torch.sin(angle))

    @override
    def max_speed(self, rows: Tensor) -> Tensor:
        return self.tables.of_envs(self._velocity, rows).norm(dim=-1)
