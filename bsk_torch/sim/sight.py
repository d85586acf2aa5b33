"""What is seen from the planned arc: shadow, and elevations over places on the ground; by kernels or on tensors."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from bsk_torch.astro.eclipse import in_umbra
from bsk_torch.astro.frames import sin_elevation
from bsk_torch.astro.interpolate import position, positions
from bsk_torch.astro.roots import find_maximum, find_root, narrowed, next_guess, placed, refined, sections
from bsk_torch.lanes.loop import Loop, Samples
from bsk_torch.sim.component import Bus, Track, neighbours, vec
from bsk_torch.sim.orbit import ARC
from bsk_torch.sim.paths import ARC_TRACK, SAMPLE_TRACK, SKY_TRACK, Sketch
from bsk_torch.sim.sky import SKY, fixed, sky_at
from bsk_torch.sim.span import PLAN_STEP, SPACING
from bsk_torch.vec3 import Vec3

ROOT_ITERATIONS, PEAK_ITERATIONS = 20, 25

FINE = Track("fine", PLAN_STEP, (vec("r", "m", exact=True),), count=1)


class Places(NamedTuple):
    """Places on the ground: Earth-fixed positions [S, 3], m, and sines of the least elevation [S]."""

    r_P: Tensor
    sin_min_elevation: Tensor


class View(NamedTuple):
    """Planned arcs and sky of n satellites, see :class:`bsk_torch.sim.orbit.Arcs`; ``fine`` are samples every 30 s, if known."""

    planned: Samples
    sky: Samples
    fine: Samples | None = None

    def of(self, row: Tensor) -> View:
        """The view of rows [m], which may repeat."""
        parts = (s and Samples(s.table, s.start, row if s.owner is None else s.owner[row]) for s in self)
        return View(*parts)  # type: ignore[arg-type]

    def track(self, track: Track, samples: Samples, time: Tensor) -> tuple[Tensor, Tensor]:
        """Records of a track around times [n], one of each row, and tau; see :func:`bsk_torch.sim.component.neighbours`."""
        row = torch.arange(len(time), device=time.device) if samples.owner is None else samples.owner
        return neighbours(track, samples.table, row, time - samples.start[row])


class Brackets(NamedTuple):
    """Two times [m] between which the elevation over a place crosses its limit, and the heights above the limit there."""

    a: Tensor
    b: Tensor
    height_a: Tensor
    height_b: Tensor


class Heights(NamedTuple):
    """Samples of elevations: codes [n, K] of what happens, see :func:`happening`.

    Of short searches only, also the sine of each elevation less its place's limit [n, K, S], and the distance from the Earth's
    centre [n, K], m.
    """

    codes: Tensor
    above: Tensor
    radius: Tensor


class Sight(Protocol):
    """Looks from planned arcs, every 30 s or at crossings."""

    def dark(self, view: View, start: Tensor, count: int) -> Tensor:
        """Whether the umbra covers the satellite at ``count`` samples from ``start`` [n] s on, [n, count]."""

    def heights(self, view: View, start: Tensor, count: int, places: Places, whole: bool) -> Heights:
        """Samples of the elevations, ``count`` from ``start`` [n] s on; of a ``whole`` episode only what happens."""

    def height(self, view: View, places: Places, time: Tensor) -> Tensor:
        """Sine of the elevation of each row over its place less the limit, at time [n]."""

    def crossings(self, view: View, places: Places, brackets: Brackets) -> Tensor:
        """Times [n] of the crossings over ``places``, one for each row."""

    def peaks(self, view: View, places: Places, a: Tensor, b: Tensor) -> Tensor:
        """Times [n] between a and b when each row stands highest over its place."""


def make_sight(backend: str, device: torch.device) -> Sight:
    """What looks under a back end."""
    return KernelSight() if backend == "compiled" and device.type == "cpu" else TensorSight()


# -- on tensors ----------------------------------------------------------------------------------------------------------------


def planned_position(view: View, time: Tensor) -> tuple[Vec3, Bus]:
    """Planned position in N at time [n], and the sky then."""
    nodes, tau = view.track(ARC, view.planned, time)
    records, sky_tau = view.track(SKY, view.sky, time)
    return Vec3.of(positions(nodes, tau * (1.0 / SPACING))), sky_at(records.flatten(1).unbind(-1), sky_tau)


RISES, SETS, GLIMPSED = 1, 2, 4
"""Codes of what happens over a place between a sample and the ones before."""

PER_PLACE = 8
"""The code of a place counts this much more than that of the place before; doubles hold those of :data:`MOST_PLACES`."""

MOST_PLACES = 17


def happening(before: Any, here: Any, after: Any) -> Any:
    """Code of three samples of the height over a place, the first of which may be NaN.

    A rise or set lies between the last two. A glimpse is a maximum near the middle one that may reach above the limit though no
    sample does.
    """
    bend = torch.clamp(2.0 * here - before - after, min=1e-12)
    highest = here + 0.5 * (before - after) * (before - after) / bend
    glimpsed = (here >= before) & (here >= after) & (here <= 0.0) & (highest > -0.01)
    zero = torch.zeros_like(after)
    passes = torch.where(
        (here <= 0.0) & (after > 0.0), float(RISES), torch.where((here > 0.0) & (after <= 0.0), float(SETS), zero)
    )
    return torch.where(glimpsed, passes + float(GLIMPSED), passes)


def sampled(view: View, start: Tensor, count: int) -> tuple[Vec3, Bus]:
    """Planned positions and sky at ``count`` samples from ``start`` [n] on, flattened to [n * count]."""
    time = (start.unsqueeze(-1) + PLAN_STEP * torch.arange(count, device=start.device)).flatten()
    view = view.of(torch.arange(len(start), device=start.device).repeat_interleave(count))
    if view.fine is None:
        return planned_position(view, time)
    records, tau = view.track(SKY, view.sky, time)
    return Vec3.of(view.track(FINE, view.fine, time)[0].squeeze(1)), sky_at(records.flatten(1).unbind(-1), tau)


class TensorSight:
    """Looks with tensor operations."""

    def dark(self, view: View, start: Tensor, count: int) -> Tensor:
        """See :class:`Sight`."""
        r, sky = sampled(view, start, count)
        return in_umbra(r, sky.r_sun).view(-1, count)

    def heights(self, view: View, start: Tensor, count: int, places: Places, whole: bool) -> Heights:
        """See :class:`Sight`."""
        r, sky = sampled(view, start, count)
        r_P = fixed(sky, r).map(lambda x: x.view(-1, count, 1))
        above = sin_elevation(r_P, Vec3.of(places.r_P)) - places.sin_min_elevation
        padded = torch.nn.functional.pad(above, (0, 0, 2, 0), value=torch.nan)
        codes = happening(padded[:, :-2], padded[:, 1:-1], above)
        weights = PER_PLACE ** torch.arange(above.shape[-1], dtype=torch.float64, device=above.device)
        return Heights((codes * weights).sum(-1), above, r.norm().view(-1, count))

    def height(self, view: View, places: Places, time: Tensor) -> Tensor:
        """See :class:`Sight`."""
        r, sky = planned_position(view, time)
        return sin_elevation(fixed(sky, r), Vec3.of(places.r_P)) - places.sin_min_elevation

    def crossings(self, view: View, places: Places, brackets: Brackets) -> Tensor:
        """See :class:`Sight`."""
        return find_root(lambda time: self.height(view, places, time), *brackets, ROOT_ITERATIONS)

    def peaks(self, view: View, places: Places, a: Tensor, b: Tensor) -> Tensor:
        """See :class:`Sight`."""
        return find_maximum(lambda time: self.height(view, places, time), a, b, PEAK_ITERATIONS)


# -- kernels -------------------------------------------------------------------------------------------------------------------


class KernelSight:
    """Looks with kernels whose ticks are samples or iterations."""

    def dark(self, view: View, start: Tensor, count: int) -> Tensor:
        """See :class:`Sight`."""
        written = torch.empty(len(start), count, 1, dtype=torch.float64)
        _sample(dark_kernel(view.fine is not None), view, start, written)
        return written.squeeze(-1) > 0.5

    def heights(self, view: View, start: Tensor, count: int, places: Places, whole: bool) -> Heights:
        """See :class:`Sight`."""
        s = len(places.r_P)
        written = torch.empty(len(start), count, 1 if whole else s + 2, dtype=torch.float64)
        shared = torch.cat([places.r_P, places.sin_min_elevation.unsqueeze(-1)], -1).flatten()
        _sample(heights_kernel(s, view.fine is not None, whole), view, start, written, shared, memory=2 * s)
        codes = written[..., 0].contiguous()
        none = written[..., :0]
        return Heights(codes, none, none) if whole else Heights(codes, written[..., 2:], written[..., 1])

    def height(self, view: View, places: Places, time: Tensor) -> Tensor:
        """See :class:`Sight`."""
        state = torch.stack([time, time])
        _search(height_kernel(), view, places, state, 1)
        return state[1]

    def crossings(self, view: View, places: Places, brackets: Brackets) -> Tensor:
        """See :class:`Sight`."""
        state = torch.stack([next_guess(*brackets), *brackets])
        _search(crossing_kernel(), view, places, state, ROOT_ITERATIONS)
        return state[2]

    def peaks(self, view: View, places: Places, a: Tensor, b: Tensor) -> Tensor:
        """See :class:`Sight`."""
        left, right = ((time, self.height(view, places, time)) for time in sections(a, b))
        first, last, new = narrowed(a, b, *left, *right)
        state = torch.stack([new, first, last, *left, *right])
        _search(peak_kernel(), view, places, state, PEAK_ITERATIONS)
        return 0.5 * (state[1] + state[2])


def _search(kernel: Loop, view: View, places: Places, state: Tensor, iterations: int) -> None:
    own = torch.cat([places.r_P.mT, places.sin_min_elevation.unsqueeze(0)]).contiguous()
    counts = torch.full((state.shape[1],), iterations)
    kernel(state, counts, (view.sky, view.planned), own=own)


def _sample(kernel: Loop, view: View, start: Tensor, written: Tensor, shared: Tensor | None = None, memory: int = 0) -> None:
    state = torch.full((1 + memory, len(start)), torch.nan, dtype=torch.float64)
    state[0] = start
    counts = torch.full(start.shape, written.shape[1])
    kernel(state, counts, (view.sky, view.fine or view.planned), shared=shared, written=written)


def _position(sketch: Sketch, fine: bool = False) -> tuple[Any, Vec3, Bus]:
    """Time of the tick, planned position and sky."""
    (time,) = sketch.planes("state", 1)
    if fine:
        x, y, z = sketch.records(2, 3)
        return time, Vec3(x, y, z), sketch.sky()
    path, s = sketch.path(2)
    return time, position(path, s), sketch.sky()


def _loop(name: str, sketch: Sketch, outputs: list[Any], written: list[Any], fine: bool = False) -> Loop:
    return Loop(name, sketch.program, outputs, (SKY_TRACK, SAMPLE_TRACK if fine else ARC_TRACK), written, clock="state_0")


@cache
def dark_kernel(fine: bool) -> Loop:
    """Samples of the umbra."""
    sketch = Sketch()
    time, r, sky = _position(sketch, fine)
    dark = in_umbra(r, sky.r_sun)
    return _loop("eclipse search", sketch, [time + PLAN_STEP], [dark], fine)


@cache
def heights_kernel(places: int, fine: bool, whole: bool) -> Loop:
    """Samples of the elevations; shared are position and least sine of each place, the state remembers two samples."""
    sketch = Sketch()
    time, r, sky = _position(sketch, fine)
    r_P, sites = fixed(sky, r), sketch.planes("shared", 4 * places)
    before, here = (sketch.planes("state", places, first=1 + k * places) for k in (0, 1))
    found = [sin_elevation(r_P, Vec3(*sites[k : k + 3])) - sites[k + 3] for k in range(0, 4 * places, 4)]
    total = torch.zeros_like(time)
    for k, heights in enumerate(zip(before, here, found, strict=True)):
        total = total + happening(*heights) * float(PER_PLACE**k)
    outputs, written = [time + PLAN_STEP, *here, *found], [total] if whole else [total, r.norm(), *found]
    return _loop("station search", sketch, outputs, written, fine)


def _height(sketch: Sketch) -> tuple[Any, Any]:
    """Time of the tick, and height over the place whose position and least sine are ``own``."""
    time, r, sky = _position(sketch)
    *site, least = sketch.planes("own", 4)
    return time, sin_elevation(fixed(sky, r), Vec3(*site)) - least


@cache
def height_kernel() -> Loop:
    """The height at one time."""
    sketch = Sketch()
    return _loop("station elevation", sketch, list(_height(sketch)), [])


@cache
def crossing_kernel() -> Loop:
    """Iterations of the search for a crossing."""
    sketch = Sketch()
    time, found = _height(sketch)
    a, b, height_a, height_b = sketch.planes("state", 4, first=1)
    narrower = refined(a, b, height_a, height_b, time, found)
    return _loop("station crossings", sketch, [next_guess(*narrower), *narrower], [])


@cache
def peak_kernel() -> Loop:
    """Iterations of the search for the highest point of a pass."""
    sketch = Sketch()
    time, found = _height(sketch)
    a, b, left, height_left, right, height_right = sketch.planes("state", 6, first=1)
    points = placed(left, height_left, right, height_right, time, found)
    a, b, new = narrowed(a, b, *points)
    return _loop("station passes", sketch, [new, a, b, *points], [])
