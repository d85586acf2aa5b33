"""The geometry of visibility by kernels whose ticks are samples or iterations of a search."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.eclipse import umbra_depth
from bsk_torch.astro.interpolate import coefficients, position
from bsk_torch.astro.roots import halved, narrowed, next_guess, placed, refined, sections
from bsk_torch.astro.sight import elevation_clearance
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.stored import stored_kernel
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
from bsk_torch.sim.access.visibility.planned import PlannedOrbits
from bsk_torch.sim.access.visibility.tensors import TensorVisibility
from bsk_torch.sim.component import Bus, Track
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, fixed
from bsk_torch.sim.orbit.builder import FINE, KernelBuilder
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.vec3 import Vec3


class KernelVisibility(Visibility):
    """Visibility by kernels, on the CPU."""

    kernels = True

    @override
    def umbra(self, orbits: PlannedOrbits, start: Tensor, count: int) -> Tensor:
        return _run_samples(umbra_kernel(), orbits, start, count, 1).squeeze(-1)

    @override
    def ground_track(self, orbits: PlannedOrbits, start: Tensor, count: int) -> Tensor:
        return _run_samples(ground_track_kernel(), orbits, start, count, 3)

    @override
    def events(self, pairs: PlacePairs, cells: SearchCells) -> Tensor:
        written = torch.empty(len(cells.first), CLASSIFIED_SAMPLES, 1, dtype=torch.float64)
        state = torch.full((3, len(cells.first)), torch.nan, dtype=torch.float64)
        state[0] = cells.first
        limits = cells.end, cells.search_begin, cells.search_end
        _run_pairs(event_kernel, pairs, state, CLASSIFIED_SAMPLES, limits, written)
        return written.squeeze(-1)

    @override
    def clearance(self, pairs: PlacePairs, time: Tensor) -> Tensor:
        state = torch.stack([time, time])
        _run_pairs(clearance_kernel, pairs, state, 1)
        return state[1]

    @override
    def crossings(self, pairs: PlacePairs, brackets: Brackets) -> Tensor:
        state = torch.stack([0.5 * (brackets.a + brackets.b), *brackets])
        _run_pairs(crossing_kernel, pairs, state, BISECTIONS + ROOT_ITERATIONS)
        return state[2]

    @override
    def culminations(self, pairs: PlacePairs, a: Tensor, b: Tensor) -> Tensor:
        first_third, right = ((time, self.clearance(pairs, time)) for time in sections(a, b))
        first, last, new = narrowed(a, b, *first_third, *right)
        state = torch.stack([new, first, last, *first_third, *right])
        _run_pairs(culmination_kernel, pairs, state, CULMINATION_ITERATIONS)
        return 0.5 * (state[1] + state[2])


def _run_pairs(
    kernel: Callable[[bool], Kernel],
    pairs: PlacePairs,
    state: Tensor,
    ticks: int,
    limits: tuple[Tensor, ...] = (),
    written: Tensor | None = None,
) -> None:
    geodetic = pairs.shift is not None
    shift = (pairs.shift,) if geodetic else ()
    own = torch.stack([*pairs.r_LP_P.unbind(-1), pairs.sin_min_elevation, *shift, *limits])
    kernel(geodetic)(state, ticks, (pairs.track,), own=own, written=written)


def _run_samples(kernel: Kernel, orbits: PlannedOrbits, start: Tensor, count: int, width: int) -> Tensor:
    written = torch.empty(len(start), count, width, dtype=torch.float64)
    kernel(start.unsqueeze(0).clone(), count, (orbits.ephemeris, orbits.samples), written=written)
    return written


def _sample_kernel(name: str, function: Callable[[Vec3, Bus], list[Tensor]]) -> Kernel:
    """Return a kernel that writes a function of planned position and ephemeris at each sample; its state is the time."""
    builder = KernelBuilder()
    (time,) = builder.planes("state", 1)
    written = function(Vec3(*builder.records(2, 3)), builder.ephemeris())
    return Kernel(name, builder.loop([time + PLAN_STEP], written, (EPHEMERIS_TRACK, FINE), time))


@stored_kernel
def umbra_kernel() -> Kernel:
    """Return the kernel that writes how deep a satellite is in the umbra."""
    return _sample_kernel("eclipse search", lambda r_BN_N, ephemeris: [umbra_depth(r_BN_N, ephemeris.r_SN_N)])


@stored_kernel
def ground_track_kernel() -> Kernel:
    """Return the kernel that writes the Earth-fixed position."""
    return _sample_kernel("ground track", lambda r_BN_N, ephemeris: list(fixed(ephemeris, r_BN_N)))


def _time_and_clearance(builder: KernelBuilder, track: Track, geodetic: bool) -> tuple[Tensor, Tensor]:
    """Return the time of the tick and the clearance then.

    The place's position, the sine of the limit and, if ``geodetic``, the shift of the place are the ``own`` planes.
    """
    (time,) = builder.planes("state", 1)
    *site, sin_min_elevation = builder.planes("own", 4)
    shift = builder.planes("own", 1, first=4)[0] if geodetic else None
    planes = builder.records(1, 3 * track.count)
    nodes = [Vec3(*planes[k : k + 3]) for k in range(0, len(planes), 3)]
    r_BP_P = nodes[0] if track.count == 1 else position(coefficients(nodes), builder.tau(1) * (1.0 / PLAN_STEP))
    return time, elevation_clearance(r_BP_P, Vec3(*site), sin_min_elevation, shift)


def _pair_kernel(name: str, builder: KernelBuilder, track: Track, outputs: Sequence[Tensor], written: Sequence[Tensor]) -> Kernel:
    (time,) = builder.planes("state", 1)
    return Kernel(name, builder.loop(outputs, written, (track,), time))


@stored_kernel
def event_kernel(geodetic: bool) -> Kernel:
    """Return the kernel that writes event codes; its state is the time and the last two clearances."""
    builder = KernelBuilder()
    time, clearance = _time_and_clearance(builder, FINE, geodetic)
    before, here = builder.planes("state", 2, first=1)
    end, search_begin, search_end = builder.planes("own", 3, first=5 if geodetic else 4)
    written = event_code(before, here, clearance, time, SearchCells(time, end, search_begin, search_end))
    return _pair_kernel("access search", builder, FINE, [time + PLAN_STEP, here, clearance], [written])


@stored_kernel
def clearance_kernel(geodetic: bool) -> Kernel:
    """Return the kernel that computes the clearance at one time."""
    builder = KernelBuilder()
    return _pair_kernel("access clearance", builder, GROUND_TRACK, list(_time_and_clearance(builder, GROUND_TRACK, geodetic)), [])


@stored_kernel
def crossing_kernel(geodetic: bool) -> Kernel:
    """Return the kernel of the search for a crossing: first bisections, then regula falsi; see ``roots.find_root``."""
    builder = KernelBuilder()
    time, clearance = _time_and_clearance(builder, GROUND_TRACK, geodetic)
    a, b, clearance_a, clearance_b = builder.planes("state", 4, first=1)
    bracket = a, b, clearance_a, clearance_b, time, clearance
    number = builder.number("ticks_now")
    both = zip(halved(*bracket), refined(*bracket), strict=True)
    a, b, clearance_a, clearance_b = (torch.where(number <= float(BISECTIONS), x, y) for x, y in both)
    guess = torch.where(number < float(BISECTIONS), 0.5 * (a + b), next_guess(a, b, clearance_a, clearance_b))
    return _pair_kernel("access crossings", builder, GROUND_TRACK, [guess, a, b, clearance_a, clearance_b], [])


@stored_kernel
def culmination_kernel(geodetic: bool) -> Kernel:
    """Return the kernel of the golden-section search for a culmination; see ``roots.find_maximum``."""
    builder = KernelBuilder()
    time, clearance = _time_and_clearance(builder, GROUND_TRACK, geodetic)
    a, b, left, clearance_left, right, clearance_right = builder.planes("state", 6, first=1)
    points = placed(left, clearance_left, right, clearance_right, time, clearance)
    a, b, new = narrowed(a, b, *points)
    return _pair_kernel("access passes", builder, GROUND_TRACK, [new, a, b, *points], [])


def make_visibility(backend: str, device: torch.device) -> Visibility:
    """Return the implementation for a back end: kernels for ``"compiled"`` on the CPU, else tensor operations."""
    return KernelVisibility() if backend == "compiled" and device.type == "cpu" else TensorVisibility()
