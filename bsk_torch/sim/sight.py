"""What is seen from the planned arc: shadow, the ground below, and places on it; by kernels or on tensors."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from bsk_torch.astro.eclipse import in_umbra
from bsk_torch.astro.interpolate import BEFORE, COUNT, coefficients, position, positions
from bsk_torch.astro.roots import find_maximum, find_root, halved, narrowed, next_guess, placed, refined, sections
from bsk_torch.lanes.expr import DOUBLE, TICK
from bsk_torch.lanes.loop import Loop, Samples
from bsk_torch.sim.component import Bus, Track, neighbours, vec
from bsk_torch.sim.paths import ARC, FINE, Sketch
from bsk_torch.sim.sky import SKY, fixed, sky_at
from bsk_torch.sim.span import PLAN_STEP, SPACING
from bsk_torch.vec3 import Vec3

BISECTIONS, ROOT_ITERATIONS, PEAK_ITERATIONS = 10, 12, 25
"""Steps of the searches: ten bisections leave less than the shortest window lasts, which is straight enough for the rest."""

PATH = Track("path", PLAN_STEP, (vec("r", "m", exact=True),), COUNT, BEFORE)

CELL = 16
"""Samples of which only the middle one is compared with all places."""

LOOKS = CELL + 2
"""Samples of a cell that are looked at closely: its own, the first of the next cell, and the one after that."""

RISES, SETS, GLIMPSED, UP = 1, 2, 4, 8
"""Codes of what happens over a place between a sample and the ones before; ``UP`` is told of the ends of a search only."""


class View(NamedTuple):
    """Planned arcs and sky of n satellites, see :class:`bsk_torch.sim.orbit.Arcs`; ``fine`` are samples every 30 s, if known."""

    planned: Samples
    sky: Samples
    fine: Samples | None = None

    def of(self, row: Tensor) -> View:
        """The view of rows [m], which may repeat."""
        return View(*(part and owned(part, row) for part in self))  # type: ignore[arg-type]


def owned(samples: Samples, row: Tensor) -> Samples:
    """The samples of rows [m], which may repeat."""
    return Samples(samples.table, samples.start, row if samples.owner is None else samples.owner[row])


def look_up(track: Track, samples: Samples, time: Tensor) -> tuple[Tensor, Tensor]:
    """Records of a track around times [n], one of each row, and tau; see :func:`bsk_torch.sim.component.neighbours`."""
    row = torch.arange(len(time), device=time.device) if samples.owner is None else samples.owner
    return neighbours(track, samples.table, row, time - samples.start[row])


class Pairs(NamedTuple):
    """Satellites over places: Earth-fixed samples of each pair's satellite, position [m, 3] and least sine of each place [m]."""

    path: Samples
    r_P: Tensor
    sin_min_elevation: Tensor

    def of(self, pair: Tensor) -> Pairs:
        """Some of the pairs."""
        return Pairs(owned(self.path, pair), self.r_P[pair], self.sin_min_elevation[pair])


class Cells(NamedTuple):
    """Where to look closely, [m] s: first sample, end of the cell, and beginning and end of the whole search."""

    first: Tensor
    end: Tensor
    search_begin: Tensor
    search_end: Tensor


class Brackets(NamedTuple):
    """Two times [m] between which a satellite crosses the limit over its place, and the clearances there."""

    a: Tensor
    b: Tensor
    clearance_a: Tensor
    clearance_b: Tensor


class Sight(Protocol):
    """Looks from planned arcs, every 30 s or at crossings."""

    def dark(self, view: View, start: Tensor, count: int) -> Tensor:
        """Whether the umbra covers the satellite at ``count`` samples from ``start`` [n] s on, [n, count]."""

    def ground(self, view: View, start: Tensor, count: int) -> Tensor:
        """Earth-fixed positions at ``count`` samples from ``start`` [n] s on, [n, count, 3] m."""

    def happenings(self, pairs: Pairs, cells: Cells) -> Tensor:
        """Codes [m, LOOKS] of what happens at each sample of a cell; see :func:`happening`."""

    def clearance(self, pairs: Pairs, time: Tensor) -> Tensor:
        """See :func:`clearance`, of each pair at its time [m]."""

    def crossings(self, pairs: Pairs, brackets: Brackets) -> Tensor:
        """Times [m] of the crossings."""

    def peaks(self, pairs: Pairs, a: Tensor, b: Tensor) -> Tensor:
        """Times [m] between a and b when each satellite stands highest over its place."""


def make_sight(backend: str, device: torch.device) -> Sight:
    """What looks under a back end."""
    return KernelSight() if backend == "compiled" and device.type == "cpu" else TensorSight()


def clearance(r_P: Vec3, site: Vec3, least: Any) -> Any:
    """Cosine of the angle at the Earth's centre between satellite and place, less that at which the elevation is least.

    At elevation e the angle is ``acos(q cos e) - e`` with q the place's radius over the satellite's. Unlike the elevation it is
    nearly a sinusoid of time, so that three samples tell how high a pass between them rises.
    """
    radius, distance = site.norm(), r_P.norm()
    ratio, cos2 = radius / distance, 1.0 - least * least
    limit = ratio * cos2 + least * torch.sqrt(torch.clamp(1.0 - ratio * ratio * cos2, min=0.0))
    return site.dot(r_P) / (radius * distance) - limit


TOLERANCE = 1e-4
"""A parabola through three clearances is that good, and a hundred times better for low orbits."""


def happening(before: Any, here: Any, after: Any, is_first: Any, is_last: Any) -> tuple[Any, Any, Any]:
    """Whether a place rises or sets between the last two of three clearances, and whether it may be glimpsed.

    A glimpse is a maximum near the middle sample that may reach above the limit though no sample does. The first and the last
    three samples of a search stand for the maxima near its ends, too. The first sample may be NaN.
    """
    bend, slope = torch.clamp(2.0 * here - before - after, min=1e-12), after - before
    vertex, top = slope / (2.0 * bend), here + slope * slope / (8.0 * bend)
    below = (before <= 0.0) & (here <= 0.0) & (after <= 0.0) & (top > -TOLERANCE)
    early, late = is_first & (here < before) & (vertex > -1.1), is_last & (here < after) & (vertex < 1.1)
    glimpsed = below & (((here >= before) & (here >= after)) | early | late)
    return (here <= 0.0) & (after > 0.0), (here > 0.0) & (after <= 0.0), glimpsed


def code(before: Any, here: Any, after: Any, time: Any, cells: Cells) -> Any:
    """The code of three clearances, the last one at ``time``; 0 where that is in the next cell or after the search."""
    half = 0.5 * PLAN_STEP
    is_first, is_last = time < cells.search_begin + 5.0 * half, time > cells.search_end - half
    rises, sets, glimpsed = happening(before, here, after, is_first, is_last)
    mine, whole = time < cells.end + half, time < cells.search_end + half
    zero = torch.zeros_like(after)
    found = torch.where(mine & rises, float(RISES), torch.where(mine & sets, float(SETS), zero))
    found = torch.where(whole & glimpsed, found + float(GLIMPSED), found)
    at_end = mine & ((time < cells.search_begin + half) | is_last)
    return torch.where(at_end & (after > 0.0), found + float(UP), found)


# -- on tensors ----------------------------------------------------------------------------------------------------------------


def planned_position(view: View, time: Tensor) -> tuple[Vec3, Bus]:
    """Planned position in N at time [n], and the sky then."""
    nodes, tau = look_up(ARC, view.planned, time)
    records, sky_tau = look_up(SKY, view.sky, time)
    return Vec3.of(positions(nodes, tau * (1.0 / SPACING))), sky_at(records.flatten(1).unbind(-1), sky_tau)


def sampled(view: View, start: Tensor, count: int) -> tuple[Vec3, Bus]:
    """Planned positions and sky at ``count`` samples from ``start`` [n] on, flattened to [n * count]."""
    time = (start.unsqueeze(-1) + PLAN_STEP * torch.arange(count, device=start.device)).flatten()
    view = view.of(torch.arange(len(start), device=start.device).repeat_interleave(count))
    if view.fine is None:
        return planned_position(view, time)
    records, tau = look_up(SKY, view.sky, time)
    return Vec3.of(look_up(FINE, view.fine, time)[0].squeeze(1)), sky_at(records.flatten(1).unbind(-1), tau)


class TensorSight:
    """Looks with tensor operations."""

    def dark(self, view: View, start: Tensor, count: int) -> Tensor:
        """See :class:`Sight`."""
        r, sky = sampled(view, start, count)
        return in_umbra(r, sky.r_sun).view(-1, count)

    def ground(self, view: View, start: Tensor, count: int) -> Tensor:
        """See :class:`Sight`."""
        r, sky = sampled(view, start, count)
        return fixed(sky, r).stack().view(-1, count, 3)

    def happenings(self, pairs: Pairs, cells: Cells) -> Tensor:
        """See :class:`Sight`."""
        times = cells.first.unsqueeze(-1) + PLAN_STEP * torch.arange(LOOKS, device=cells.first.device)
        every = pairs.of(torch.arange(len(times), device=times.device).repeat_interleave(LOOKS))
        r_P = Vec3.of(look_up(FINE, every.path, times.flatten())[0].squeeze(1))
        found = clearance(r_P, Vec3.of(every.r_P), every.sin_min_elevation).view(times.shape)
        padded = torch.nn.functional.pad(found, (2, 0), value=torch.nan)
        return code(padded[:, :-2], padded[:, 1:-1], found, times, Cells(*(part.unsqueeze(-1) for part in cells)))

    def clearance(self, pairs: Pairs, time: Tensor) -> Tensor:
        """See :class:`Sight`."""
        nodes, tau = look_up(PATH, pairs.path, time)
        return clearance(Vec3.of(positions(nodes, tau * (1.0 / PLAN_STEP))), Vec3.of(pairs.r_P), pairs.sin_min_elevation)

    def crossings(self, pairs: Pairs, brackets: Brackets) -> Tensor:
        """See :class:`Sight`."""
        return find_root(lambda time: self.clearance(pairs, time), *brackets, ROOT_ITERATIONS, BISECTIONS)

    def peaks(self, pairs: Pairs, a: Tensor, b: Tensor) -> Tensor:
        """See :class:`Sight`."""
        return find_maximum(lambda time: self.clearance(pairs, time), a, b, PEAK_ITERATIONS)


# -- kernels -------------------------------------------------------------------------------------------------------------------


class KernelSight:
    """Looks with kernels whose ticks are samples or iterations."""

    def dark(self, view: View, start: Tensor, count: int) -> Tensor:
        """See :class:`Sight`."""
        return _sampled(dark_kernel(view.fine is not None), view, start, count, 1).squeeze(-1) > 0.5

    def ground(self, view: View, start: Tensor, count: int) -> Tensor:
        """See :class:`Sight`."""
        return _sampled(ground_kernel(view.fine is not None), view, start, count, 3)

    def happenings(self, pairs: Pairs, cells: Cells) -> Tensor:
        """See :class:`Sight`."""
        written = torch.empty(len(cells.first), LOOKS, 1, dtype=torch.float64)
        state = torch.full((3, len(cells.first)), torch.nan, dtype=torch.float64)
        state[0] = cells.first
        _run(happening_kernel(), pairs, state, LOOKS, (cells.end, cells.search_begin, cells.search_end), written)
        return written.squeeze(-1)

    def clearance(self, pairs: Pairs, time: Tensor) -> Tensor:
        """See :class:`Sight`."""
        state = torch.stack([time, time])
        _run(clearance_kernel(), pairs, state, 1)
        return state[1]

    def crossings(self, pairs: Pairs, brackets: Brackets) -> Tensor:
        """See :class:`Sight`."""
        state = torch.stack([0.5 * (brackets.a + brackets.b), *brackets])
        _run(crossing_kernel(), pairs, state, BISECTIONS + ROOT_ITERATIONS)
        return state[2]

    def peaks(self, pairs: Pairs, a: Tensor, b: Tensor) -> Tensor:
        """See :class:`Sight`."""
        left, right = ((time, self.clearance(pairs, time)) for time in sections(a, b))
        first, last, new = narrowed(a, b, *left, *right)
        state = torch.stack([new, first, last, *left, *right])
        _run(peak_kernel(), pairs, state, PEAK_ITERATIONS)
        return 0.5 * (state[1] + state[2])


def _run(
    kernel: Loop, pairs: Pairs, state: Tensor, ticks: int, more: tuple[Tensor, ...] = (), written: Tensor | None = None
) -> None:
    own = torch.stack([*pairs.r_P.unbind(-1), pairs.sin_min_elevation, *more])
    kernel(state, ticks, (pairs.path,), own=own, written=written)


def _sampled(kernel: Loop, view: View, start: Tensor, count: int, width: int) -> Tensor:
    written = torch.empty(len(start), count, width, dtype=torch.float64)
    kernel(start.unsqueeze(0).clone(), count, (view.sky, view.fine or view.planned), written=written)
    return written


def _sample_kernel(name: str, fine: bool, what: Any) -> Loop:
    """A kernel that writes what a function of planned position and sky finds at samples; the state is the time."""
    sketch = Sketch()
    (time,) = sketch.planes("state", 1)
    if fine:
        r = Vec3(*sketch.records(2, 3))
    else:
        path, s = sketch.path(2)
        r = position(path, s)
    tracks = SKY, FINE if fine else ARC
    return Loop(name, sketch.program, [time + PLAN_STEP], tracks, what(r, sketch.sky()), clock="state_0")


@cache
def dark_kernel(fine: bool) -> Loop:
    """Samples of the umbra."""
    return _sample_kernel("eclipse search", fine, lambda r, sky: [in_umbra(r, sky.r_sun)])


@cache
def ground_kernel(fine: bool) -> Loop:
    """Samples of the Earth-fixed position."""
    return _sample_kernel("ground track", fine, lambda r, sky: list(fixed(sky, r)))


def _pair(sketch: Sketch, track: Track) -> tuple[Any, Any]:
    """Time of the tick, and clearance over the place whose position and least sine are ``own``."""
    (time,) = sketch.planes("state", 1)
    *site, least = sketch.planes("own", 4)
    planes = sketch.records(1, 3 * track.count)
    nodes = [Vec3(*planes[k : k + 3]) for k in range(0, len(planes), 3)]
    r_P = nodes[0] if track.count == 1 else position(coefficients(nodes), sketch.tau(1) * (1.0 / PLAN_STEP))
    return time, clearance(r_P, Vec3(*site), least)


def _pair_kernel(name: str, sketch: Sketch, track: Track, outputs: list[Any], written: list[Any]) -> Loop:
    return Loop(name, sketch.program, outputs, (track,), written, clock="state_0")


@cache
def happening_kernel() -> Loop:
    """Codes of samples; the state remembers two clearances."""
    sketch = Sketch()
    time, found = _pair(sketch, FINE)
    before, here = sketch.planes("state", 2, first=1)
    end, search_begin, search_end = sketch.planes("own", 3, first=4)
    written = code(before, here, found, time, Cells(time, end, search_begin, search_end))
    return _pair_kernel("access search", sketch, FINE, [time + PLAN_STEP, here, found], [written])


@cache
def clearance_kernel() -> Loop:
    """The clearance at one time."""
    sketch = Sketch()
    return _pair_kernel("access clearance", sketch, PATH, list(_pair(sketch, PATH)), [])


@cache
def crossing_kernel() -> Loop:
    """Iterations of the search for a crossing."""
    sketch = Sketch()
    time, found = _pair(sketch, PATH)
    a, b, clearance_a, clearance_b = sketch.planes("state", 4, first=1)
    bracket = a, b, clearance_a, clearance_b, time, found
    number: Any = sketch.program.input(("ticks", "now"), DOUBLE, TICK)
    both = zip(halved(*bracket), refined(*bracket), strict=True)
    a, b, clearance_a, clearance_b = (torch.where(number <= float(BISECTIONS), x, y) for x, y in both)
    guess = torch.where(number < float(BISECTIONS), 0.5 * (a + b), next_guess(a, b, clearance_a, clearance_b))
    return _pair_kernel("access crossings", sketch, PATH, [guess, a, b, clearance_a, clearance_b], [])


@cache
def peak_kernel() -> Loop:
    """Iterations of the search for the highest point of a pass."""
    sketch = Sketch()
    time, found = _pair(sketch, PATH)
    a, b, left, height_left, right, height_right = sketch.planes("state", 6, first=1)
    points = placed(left, height_left, right, height_right, time, found)
    a, b, new = narrowed(a, b, *points)
    return _pair_kernel("access passes", sketch, PATH, [new, a, b, *points], [])
