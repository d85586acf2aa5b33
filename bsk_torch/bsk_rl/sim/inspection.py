"""Which points of a spacecraft have been inspected, and which were lit, in the runs of one episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from bsk_torch.constants import NANO
from bsk_torch.sim.fleet import Fleet
from bsk_torch.sim.tick.trace import Flight
from bsk_torch.tasks.inspection.flags import Records, find_flags
from bsk_torch.tasks.inspection.points import point_columns

Place = tuple[int, int]
"""Type of a satellite, and its row among the satellites of the type."""


class Found(NamedTuple):
    """Points that a satellite has inspected, and that were lit, [P] bool each."""

    inspected: np.ndarray
    illuminated: np.ndarray


class Inspection:
    """Finds the flags of all points of a spacecraft in the runs of one episode, by bsk_rl's rules.

    The rules are those of :mod:`bsk_torch.tasks.inspection.flags`, for :class:`~bsk_torch.bsk_rl.scene.rso_points.RSOPoint`.

    In the first two records of an episode the RSO has no attitude yet: they count as inspected, and as lit only where the length
    of the step, rounded, is not that of its records: bsk_rl's test of the beginning of an episode.
    """

    def __init__(self, fleet: Fleet, rso: Place, inspectors: Sequence[Place], points: Sequence[object]) -> None:
        self.fleet, self.rso, self.inspectors = fleet, rso, list(inspectors)
        vectors = (np.array([getattr(point, name) for point in points], dtype=float) for name in ("r_PB_B", "n_B"))
        limits = (
            np.array([getattr(point, name) for point in points], dtype=float)
            for name in ("theta_max", "range_max", "theta_solar_max", "min_illumination_factor")
        )
        self.columns = point_columns(*(torch.from_numpy(part) for part in (*vectors, *limits)))
        self._found = {place: self._nothing() for place in self.inspectors}
        fleet.flight_observers.append(self._look)

    def _nothing(self) -> Found:
        return Found(*np.zeros((2, self.columns.shape[-1]), dtype=bool))

    def stop(self) -> None:
        """Observe no further runs."""
        self.fleet.flight_observers.remove(self._look)

    def take(self, inspector: Place) -> Found:
        """Return what an inspector has found since the last call, and forget it."""
        points, self._found[inspector] = self._found[inspector], self._nothing()
        return points

    def _look(self, flight: Flight) -> None:
        ticks = int(flight.ticks.max()) if len(flight.ticks) else 0
        if not ticks:
            return
        chief = flight.traces[self.rso[0]]
        assert chief is not None
        compiled = self.fleet.simulators[self.rso[0]].type.options.backend == "compiled"
        # points may be lit from the third record of the episode on if bsk_rl recognizes its step
        simulator, begun_now = self.fleet.simulators[0], int(flight.since[0]) == 0
        recognized = begun_now and int(flight.ticks[0]) * simulator.h_ns * NANO - simulator.h * int(flight.ticks[0]) == 0.0
        count, seen_from = torch.tensor([ticks]), torch.zeros(1, dtype=torch.int64)
        lit_from = torch.tensor([2 if recognized else 0])
        for place in self.inspectors:
            k, row = place
            inspectors = flight.traces[k]
            assert inspectors is not None
            rows = torch.tensor([self.rso[1]]), torch.tensor([row])
            records = Records(chief, rows[0], inspectors, rows[1], count, seen_from, lit_from)
            new = find_flags(self.columns, records, compiled)
            self._found[place] = Found(*(old | flags[0].numpy() for old, flags in zip(self._found[place], new, strict=True)))
