"""Passes of satellites over places on the ground, for all satellites and places of a batch at once.

The search has three stages. A coarse screen compares every place with one sample in eight, as a matrix product of unit
vectors, and the places that this leaves with the samples around it, which drops most pairs. The remaining pairs are classified at
every sample, 30 s apart. Crossings of the elevation limit are then refined by root finding on an interpolated ground track.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.geodetic import LARGEST_DEFLECTION
from bsk_torch.astro.sight import max_central_angle
from bsk_torch.codegen.build import entry, load
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.access.visibility.geometry import ABOVE_LIMIT, RISE, SAMPLES_PER_CELL, SET, SHORT_PASS, SearchCells
from bsk_torch.sim.access.visibility.interface import Brackets, PlacePairs, Visibility
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.places import Sites
from bsk_torch.sim.state import entries

SHORTEST_PASS = 0.1  # passes between two samples that last no longer than this, s, are dropped

SCREEN_PRODUCTS, DEVICE_SCREEN_PRODUCTS = 1 << 20, 1 << 26
"""Products of the coarse screen held at once: on the CPU, so that they fit into its cache, and on other devices."""

SCREEN_SLACK = 1e-5
"""Angle, rad, that the coarse screen adds to the reach of a cell: the products are float32, with errors of 1e-7."""

NEAREST = 0.6
"""Largest turn between a moment and the nearest sample, as part of that between samples: half, and more where it speeds up."""


class GroundTrack(NamedTuple):
    """Earth-fixed positions of satellites, [n, K, 3] m, every 30 s from ``start`` [n] s on."""

    r_BP_P: Tensor
    start: Tensor

    @property
    def end(self) -> Tensor:
        """Time of the last sample, [n] s."""
        return self.start + PLAN_STEP * (self.r_BP_P.shape[1] - 1)

    def time(self, row: Tensor, sample: Tensor) -> Tensor:
        """Return the times, s, of the samples with these numbers on the tracks of these rows, of shapes that broadcast."""
        return self.start[row] + PLAN_STEP * sample.to(self.start.dtype)  # never of torch's default type, which may be short


TRACK = 16
"""Samples of a track in the kernel, which fill its vectors."""


class Cells(NamedTuple):
    """Where n satellites are in C cells, and which directions are near then, in float32.

    Attributes:
        middle: Direction in the middle of each cell, [n, C, 3].
        limit: Least product with the direction of a place that may be near, [n, C].
        track: Directions at the samples of each cell, [n, C, K, 3].
        near: Least product with one of these, [n, C].
    """

    middle: Tensor
    limit: Tensor
    track: Tensor
    near: Tensor


class PassEvents(NamedTuple):
    """Events of passes: row, place and sample of each, and whether the search begins or ends within the pass, 1 or 0; [m]."""

    row: Tensor
    place: Tensor
    sample: Tensor
    at_edge: Tensor


class Passes(NamedTuple):
    """Passes of satellite ``row`` over ``place`` from ``open`` to ``close``, s, [m] each.

    Passes in progress at either end of the search are cut there.
    """

    row: Tensor
    place: Tensor
    open: Tensor
    close: Tensor


def coarse_screen(track: GroundTrack, places: Sites, kernels: bool = True) -> tuple[Tensor, Tensor, Tensor]:
    """Return row, place and cell, [m] each, of all pairs that may be visible from within a cell; a superset of those that are.

    They come in the order of rows, cells and places. ``kernels`` find them, or tensors.

    From its middle sample, a satellite turns by at most psi within a cell (one more sample on both sides included), and a place
    is visible within the central angle theta_max of its subsatellite point. So a place can be visible during the cell only if

        angle(place, middle sample) <= psi + theta_max,

    with theta_max for the lowest limit, the lowest place and the highest altitude in the cell, which makes it largest. That is
    a comparison of the scalar product of two unit vectors with the cosine of the right-hand side: one matrix product for all.
    Of the places that are left, those can be visible that are as near to one of the samples of the cell, with :data:`NEAREST` of
    the largest angle between two successive samples in place of psi.
    """
    samples = track.r_BP_P.shape[1]
    half = SAMPLES_PER_CELL // 2
    middle = (
        torch.arange(-(-(samples - 1) // SAMPLES_PER_CELL), device=track.r_BP_P.device).unsqueeze(-1) * SAMPLES_PER_CELL + half
    )
    around = (middle + torch.arange(-half - 1, half + 2, device=middle.device)).clamp(0, samples - 1)
    distance = track.r_BP_P.norm(dim=-1)
    unit = (track.r_BP_P / distance.unsqueeze(-1))[:, around]
    unit_middle = unit[:, :, half + 1]
    cos_psi = (unit * unit_middle.unsqueeze(2)).sum(-1).amin(-1)
    cos_step = (unit[:, :, 1:] * unit[:, :, :-1]).sum(-1).amin(-1)
    radius = places.r_LP_P.norm(dim=-1)
    ratio = radius.nan_to_num(nan=torch.inf).amin(-1, keepdim=True) / distance[:, around].amax(-1)
    theta_max = max_central_angle(ratio, places.sin_min_elevation.amin(-1, keepdim=True))
    slack = SCREEN_SLACK if places.shift is None else SCREEN_SLACK + 2.0 * LARGEST_DEFLECTION  # which turns theta_max, too
    turns = torch.acos(cos_psi.clamp(max=1.0)), NEAREST * torch.acos(cos_step.clamp(max=1.0))
    limit, near = (torch.cos((turn + theta_max + slack).clamp(max=torch.pi)).float() for turn in turns)
    cells = Cells(unit_middle.float(), limit, unit.float(), near)
    if kernels:
        return places_near(cells, places.r_LP_P)
    return _near_on_tensors(cells, places.r_LP_P.float() / radius.float().unsqueeze(-1))


def _near_on_tensors(cells: Cells, places: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the same as :func:`places_near`; ``places`` [n or 1, P, 3] are directions.

    Products with the NaN of missing places exceed nothing.
    """
    room = SCREEN_PRODUCTS if places.device.type == "cpu" else DEVICE_SCREEN_PRODUCTS
    at_once = max(1, room // (cells.limit.shape[1] * places.shape[1]))
    crossings = []
    for first in range(0, len(cells.limit), at_once):
        part = Cells(*(table[first : first + at_once] for table in cells))
        directions = places if len(places) == 1 else places[first : first + at_once]
        row, cell, place = torch.nonzero(part.middle @ directions.mT > part.limit.unsqueeze(-1), as_tuple=True)
        direction = directions[row if len(places) > 1 else torch.zeros_like(row), place]
        nearest = (part.track[row, cell] * direction.unsqueeze(1)).sum(-1).amax(-1)
        kept = torch.nonzero(nearest > part.near[row, cell]).squeeze(-1)
        crossings.append((row[kept] + first, place[kept], cell[kept]))
    row, place, cell = (torch.cat(parts) for parts in zip(*crossings, strict=True))
    return row, place, cell


class PassSearch:
    """Search for the passes of n satellites over their places during the samples of a ground track."""

    def __init__(self, visibility: Visibility, track: GroundTrack, places: Sites) -> None:
        """Screen all pairs and classify the samples of those that remain."""
        self.visibility, self.track, self.places = visibility, track, places
        row, place, cell = coarse_screen(track, places, visibility.kernels)
        begin, end, first = track.start[row], track.end[row], track.time(row, SAMPLES_PER_CELL * cell)
        cells = SearchCells(first, torch.minimum(first + PLAN_STEP * SAMPLES_PER_CELL, end), begin, end)
        # half a step early, so that rounding of a sample's time does not lead to the sample before
        codes = visibility.events(self.pairs(row, place, 0.5 * PLAN_STEP), cells)
        sort = sorted_events if visibility.kernels else sorted_on_tensors
        self._starts, self._ends, self._short = map(PassEvents._make, sort(codes, row, place, cell, track.r_BP_P.shape[1] - 1))

    def pairs(self, row: Tensor, place: Tensor, early: float = 0.0) -> PlacePairs:
        """Return the pairs of satellites ``row`` [m] and places ``place`` [m]; ground tracks begin ``early`` s sooner."""
        owner = row if len(self.places.r_LP_P) > 1 else torch.zeros_like(row)
        samples = Samples(self.track.r_BP_P, self.track.start - early, row)
        r_LP_P, sine, shift = self.places
        return PlacePairs(
            samples, entries(r_LP_P, owner, place), sine[owner, place], None if shift is None else shift[owner, place]
        )

    def passes(self) -> Passes:
        """Return all passes, in no particular order; FloatingPointError for a ground track that no orbit has."""
        # of each pair, rises and sets alternate once the ends of the search are counted, so both sorted lists match
        starts, ends = self._starts, self._ends
        if len(starts.row) != len(ends.row):
            raise FloatingPointError("passes rise more often than they set, or the other way: a ground track is that of no orbit")
        long = Passes(starts.row, starts.place, self._times(starts), self._times(ends))
        return Passes(*(torch.cat(parts) for parts in zip(long, self._short_passes(), strict=True)))

    def _times(self, events: PassEvents) -> Tensor:
        """Return the times of events, [m] s: crossings of the limit, or the ends of the search."""
        times = self.track.time(events.row, events.sample)
        inner = torch.nonzero(events.at_edge == 0).squeeze(-1)
        row, place, b = events.row[inner], events.place[inner], times[inner]
        a, pairs = self.track.time(row, events.sample[inner] - 1), self.pairs(row, place)
        brackets = Brackets(a, b, *(self.visibility.clearance(pairs, time) for time in (a, b)))
        return times.index_copy(0, inner, self.visibility.crossings(pairs, brackets))

    def _short_passes(self) -> Passes:
        row, place, k, _ = self._short
        a, b = self.track.time(row, k - 2), self.track.time(row, k)
        pairs = self.pairs(row, place)
        culmination = self.visibility.culminations(pairs, a, b)
        top = self.visibility.clearance(pairs, culmination)
        keep = torch.nonzero(top > 0.0).squeeze(-1)
        row, place, a, b, culmination, top = (x[keep] for x in (row, place, a, b, culmination, top))
        pairs = pairs.take(keep)
        edges = (Brackets(outer, culmination, self.visibility.clearance(pairs, outer), top) for outer in (a, b))
        opens, closes = (self.visibility.crossings(pairs, brackets) for brackets in edges)
        long = closes - opens > SHORTEST_PASS
        return Passes(*(x[long] for x in (row, place, opens, closes)))


def sorted_on_tensors(codes: Tensor, row: Tensor, place: Tensor, cell: Tensor, last: int) -> Iterator[tuple[Tensor, ...]]:
    """Yield the same as :func:`~bsk_torch.sim.access.passes.passes.sorted_events`."""
    bits = codes.to(torch.uint8)
    pair, k = torch.nonzero(bits, as_tuple=True)
    code, sample = bits[pair, k], cell[pair] * SAMPLES_PER_CELL + k
    above = (code & ABOVE_LIMIT) > 0
    parts = ((code & RISE) > 0, above & (sample == 0)), ((code & SET) > 0, above & (sample == last))
    most = 1 + int(place.max()) if len(place) else 1
    for inner, edge in parts:
        index = torch.nonzero(inner | edge).squeeze(-1)
        index = index[torch.argsort(row[pair[index]] * most + place[pair[index]], stable=True)]
        yield row[pair[index]], place[pair[index]], sample[index], edge[index].long()
    index = torch.nonzero(code & SHORT_PASS).squeeze(-1)
    yield row[pair[index]], place[pair[index]], sample[index], torch.zeros_like(index)


# -- lists made by kernels -----------------------------------------------------------------------------------------------------


KERNELS = {"screen": "iiiii" + "ppppp" + "pp", "events": "iiii" + "pppp" + "pp"}
"""Signature of each kernel, whose name is that of its file."""


@cache
def list_kernel(name: str) -> Callable[..., None]:
    """Return a kernel, built or loaded when it is first needed."""
    return entry(load(Path(__file__).with_name(f"{name}.cpp").read_text(), f"search for passes ({name})"), KERNELS[name])


def places_near(cells: Cells, r_LP_P: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return row, place and cell, [m] each, of places near satellites: both products exceed their limits.

    Positions ``r_LP_P`` [n or 1, P, 3] m are NaN for missing places. Pairs come in the order of rows, cells and places.
    """
    rows, count = cells.limit.shape
    number, threads = torch.zeros(1, dtype=torch.int64), max(1, min(rows, torch.get_num_threads()))
    index = torch.arange(TRACK).clamp(max=cells.track.shape[2] - 1)
    track = cells.track.permute(0, 1, 3, 2)[..., index]
    tables = [table.contiguous() for table in (r_LP_P, cells.middle, cells.limit, track, cells.near)]
    sizes = rows, count, r_LP_P.shape[1], len(r_LP_P) == 1, threads
    list_kernel("screen")(*sizes, *tables, number, None)
    pairs = torch.empty(3, int(number), dtype=torch.int64)
    list_kernel("screen")(*sizes, *tables, number, pairs)
    row, place, cell = pairs
    return row, place, cell


def sorted_events(codes: Tensor, row: Tensor, place: Tensor, cell: Tensor, last: int) -> Iterator[tuple[Tensor, ...]]:
    """Yield starts, ends and short passes: row, place, sample, and whether an end of the search cuts the pass, [m'] each.

    ``codes`` [m, CLASSIFIED_SAMPLES] are those of samples from the ``cell`` [m] on of each pair of ``row`` [m], ascending, and
    ``place`` [m]; ``last`` is the last sample of the search. Starts and ends are sorted by row, place and time, short passes as
    the pairs are.
    """
    tables = [table.contiguous() for table in (codes, row, place, cell)]
    sizes = len(row), codes.shape[1], SAMPLES_PER_CELL, last
    numbers = torch.zeros(3, dtype=torch.int64)
    list_kernel("events")(*sizes, *tables, numbers, None)
    events = torch.empty(4 * int(numbers.sum()), dtype=torch.int64)
    list_kernel("events")(*sizes, *tables, numbers, events)
    for part in events.split((4 * numbers).tolist()):
        yield tuple(part.view(4, -1))
