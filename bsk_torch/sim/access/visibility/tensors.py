"""The geometry of visibility by tensor operations, on any device."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.eclipse import umbra_depth
from bsk_torch.astro.interpolate import positions
from bsk_torch.astro.roots import find_maximum, find_root
from bsk_torch.astro.sight import elevation_clearance
from bsk_torch.sim.access.visibility.geometry import CLASSIFIED_SAMPLES, SearchCells, event_code
from bsk_torch.sim.access.visibility.interface import (
    BISECTIONS,
    CULMINATION_ITERATIONS,
    GROUND_TRACK,
    ROOT_ITERATIONS,
    Brackets,
    PlacePairs,
    Visibility,
)
from bsk_torch.sim.access.visibility.planned import PlannedOrbits, records_around, sample_planned
from bsk_torch.sim.environment.ephemeris import fixed
from bsk_torch.sim.orbit.builder import FINE
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.vec3 import Vec3


class TensorVisibility(Visibility):
    """Visibility by tensor operations."""

    kernels = False

    @override
    def umbra(self, orbits: PlannedOrbits, start: Tensor, count: int) -> Tensor:
        r_BN_N, ephemeris = sample_planned(orbits, start, count)
        return umbra_depth(r_BN_N, ephemeris.r_SN_N).view(-1, count)

    @override
    def ground_track(self, orbits: PlannedOrbits, start: Tensor, count: int) -> Tensor:
        r_BN_N, ephemeris = sample_planned(orbits, start, count)
        return fixed(ephemeris, r_BN_N).stack().view(-1, count, 3)

    @override
    def events(self, pairs: PlacePairs, cells: SearchCells) -> Tensor:
        times = cells.first.unsqueeze(-1) + PLAN_STEP * torch.arange(
            CLASSIFIED_SAMPLES, dtype=cells.first.dtype, device=cells.first.device
        )
        every = pairs.take(torch.arange(len(times), device=times.device).repeat_interleave(CLASSIFIED_SAMPLES))
        r_BP_P = Vec3.of(records_around(FINE, every.track, times.flatten())[0].squeeze(1))
        clearance = elevation_clearance(r_BP_P, Vec3.of(every.r_LP_P), every.sin_min_elevation, every.shift).view(times.shape)
        padded = torch.nn.functional.pad(clearance, (2, 0), value=torch.nan)
        columns = SearchCells(*(part.unsqueeze(-1) for part in cells))
        return event_code(padded[:, :-2], padded[:, 1:-1], clearance, times, columns)

    @override
    def clearance(self, pairs: PlacePairs, time: Tensor) -> Tensor:
        nodes, tau = records_around(GROUND_TRACK, pairs.track, time)
        r_BP_P = Vec3.of(positions(nodes, tau * (1.0 / PLAN_STEP)))
        return elevation_clearance(r_BP_P, Vec3.of(pairs.r_LP_P), pairs.sin_min_elevation, pairs.shift)

    @override
    def crossings(self, pairs: PlacePairs, brackets: Brackets) -> Tensor:
        return find_root(lambda time: self.clearance(pairs, time), *brackets, ROOT_ITERATIONS, BISECTIONS)

    @override
    def culminations(self, pairs: PlacePairs, a: Tensor, b: Tensor) -> Tensor:
        return find_maximum(lambda time: self.clearance(pairs, time), a, b, CULMINATION_ITERATIONS)
