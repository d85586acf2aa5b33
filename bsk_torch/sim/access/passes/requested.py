"""Passes over places of requests: within the off-nadir angle, and the time, of each."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import positions
from bsk_torch.astro.roots import find_root
from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim.access.passes.passes import GroundTrack, Passes, PassSearch
from bsk_torch.sim.access.visibility.interface import GROUND_TRACK, Visibility
from bsk_torch.sim.access.visibility.planned import records_around
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.places import Sites
from bsk_torch.sim.places.requested import DUE, DURATION, MAX_OFF_NADIR, NO_OFF_NADIR, RELEASE, RequestPlaces
from bsk_torch.sim.state import look_up

VERTICAL_SLACK = 4e-3
"""Angle, rad, by which a minimum elevation is lowered that stands for an off-nadir angle; above that between two verticals."""

PIECE = 120.0  # longest piece of a pass, s, at whose ends the off-nadir angle is compared with its limit
ROOT_ITERATIONS = 8  # of regula falsi on a piece: the angle is nearly straight there, or a hyperbola


def request_passes(
    places: RequestPlaces,
    rows: Tensor,
    track: GroundTrack,
    visibility: Visibility,
    span: tuple[Tensor, Tensor],
    chosen: Tensor | None = None,
) -> Passes:
    """Return the parts of passes in which satellites ``rows`` [n] can look at requests, or at the ``chosen`` [n, K] ones.

    Parts that are too short for a look may lack, except those that reach beyond a ``span``, from and to [n] s.
    """
    sites, most = places.sites(rows), places.tables.of_envs(MAX_OFF_NADIR, rows)
    if chosen is not None:
        shift = None if sites.shift is None else look_up(sites.shift, chosen)
        sites = Sites(look_up(sites.r_LP_P, chosen), look_up(sites.sin_min_elevation, chosen), shift)
        most = look_up(most, chosen)
    limited = bool((most < NO_OFF_NADIR).any())
    if limited:
        sites = sites._replace(sin_min_elevation=torch.maximum(sites.sin_min_elevation, _lowest_elevation(sites, track, most)))
    passes = PassSearch(visibility, track, sites).passes()
    if chosen is not None:
        passes = passes._replace(place=chosen[passes.row, passes.place])
    if limited:
        passes = within_off_nadir(places, rows, track, _useful(places, rows, span, passes))
    return in_time(places, rows, passes)


def _useful(places: RequestPlaces, rows: Tensor, span: tuple[Tensor, Tensor], passes: Passes) -> Passes:
    """Return the passes that have room for a look between release and due time, or reach beyond the span."""
    seconds = places.value(DURATION, rows[passes.row], passes.place)
    opens, closes = _timely(places, rows, passes)
    goes_on = (passes.open <= span[0][passes.row]) | (passes.close >= span[1][passes.row])
    kept = (opens < closes) & (goes_on | (closes - opens >= seconds))
    return Passes(*(part[kept] for part in passes))


def _lowest_elevation(sites: Sites, track: GroundTrack, most: Tensor) -> Tensor:
    """Return the sine of an elevation, [n, P], below which the off-nadir angle exceeds ``most`` [n, P] rad everywhere on a track.

    In the triangle of the Earth's center, the place at R and the satellite at r, ``R cos(el) = r sin(off-nadir)``. The farthest
    point of the track has the lowest elevation.
    """
    farthest = track.r_BP_P.norm(dim=-1).amax(-1, keepdim=True)
    cosine = (farthest / sites.r_LP_P.norm(dim=-1) * most.sin()).clamp(max=1.0)
    return torch.sin((torch.acos(cosine.nan_to_num(nan=1.0)) - VERTICAL_SLACK).clamp(min=0.0))


def within_off_nadir(places: RequestPlaces, rows: Tensor, track: GroundTrack, passes: Passes) -> Passes:
    """Return the parts of passes in which the angle between target and the Earth's center is at most that of the request.

    With the satellite at r and the target at p, ``-r . (p - r) >= |r| |p - r| cos(most)``. Passes are searched in pieces of up to
    two minutes, and in two at least: between them lies the culmination. On eccentric orbits, parts shorter than a piece may be
    missed.
    """
    most = places.value(MAX_OFF_NADIR, rows[passes.row], passes.place)
    free = most >= NO_OFF_NADIR
    others, limited = (Passes(*(part[mask] for part in passes)) for mask in (free, ~free))
    cosine = most[~free].cos()
    r_LP_P = places.position(rows[limited.row], limited.place, limited.open)

    def margin(number: Tensor, time: Tensor) -> Tensor:
        nodes, tau = records_around(GROUND_TRACK, Samples(track.r_BP_P, track.start, limited.row[number]), time)
        r_BP_P = positions(nodes, tau * (1.0 / PLAN_STEP))
        line = r_LP_P[number] - r_BP_P
        return -(r_BP_P * line).sum(-1) / (r_BP_P.norm(dim=-1) * line.norm(dim=-1)) - cosine[number]

    pieces = torch.ceil((limited.close - limited.open) / PIECE).long().clamp(min=2)
    number = torch.repeat_interleave(pieces + 1)  # the pass of each end of a piece
    k = torch.arange(len(number), device=number.device) - (torch.cumsum(pieces + 1, 0) - pieces - 1)[number]
    time = torch.lerp(limited.open[number], limited.close[number], k.to(track.start.dtype) / pieces[number])
    f = margin(number, time)
    inside, last = f >= 0.0, k == pieces[number]
    edge = torch.nonzero((inside != inside.roll(-1)) & ~last).squeeze(-1)
    crossing = find_root(lambda t: margin(number[edge], t), time[edge], time[edge + 1], f[edge], f[edge + 1], ROOT_ITERATIONS)
    # of each pass, parts begin and end in turn
    starts, stops = torch.nonzero(inside & (k == 0)).squeeze(-1), torch.nonzero(inside & last).squeeze(-1)
    rises, sets = ~inside[edge], inside[edge]
    begin = _ordered(torch.cat([starts, edge[rises]]), torch.cat([time[starts], crossing[rises]]))
    end = _ordered(torch.cat([stops, edge[sets]]), torch.cat([time[stops], crossing[sets]]))
    own = number[begin[0]]
    parts = Passes(limited.row[own], limited.place[own], begin[1], end[1])
    return Passes(*(torch.cat(pair) for pair in zip(others, parts, strict=True)))


def _ordered(index: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
    order = torch.argsort(index)
    return index[order], time[order]


def in_time(places: RequestPlaces, rows: Tensor, passes: Passes) -> Passes:
    """Return the parts of passes between release and due time of their requests."""
    opens, closes = _timely(places, rows, passes)
    kept = opens < closes
    return Passes(*(part[kept] for part in (passes.row, passes.place, opens, closes)))


def _timely(places: RequestPlaces, rows: Tensor, passes: Passes) -> tuple[Tensor, Tensor]:
    row = rows[passes.row]
    release, due = (places.value(name, row, passes.place) for name in (RELEASE, DUE))
    return torch.maximum(passes.open, release), torch.minimum(passes.close, due)


def long_enough(places: RequestPlaces, rows: Tensor, windows: Passes, until: Tensor) -> Passes:
    """Return the windows of satellites ``rows`` [n] that last as long as a look, or beyond ``until`` [n] s."""
    seconds = places.value(DURATION, rows[windows.row], windows.place)
    kept = (windows.close - windows.open >= seconds) | (windows.close >= until[windows.row])
    return Passes(*(part[kept] for part in windows))
