"""What lies ahead of the satellites of a simulation: places in view, eclipses. Queries extend the look-ahead as they need it."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor

from bsk_torch.astro.interpolate import COUNT
from bsk_torch.rand import first_key
from bsk_torch.sim.access import LOOKAHEAD, Access, PlacesOf, Windows
from bsk_torch.sim.search import Places
from bsk_torch.sim.span import PLAN_STEP
from bsk_torch.sim.world import station_arrays

if TYPE_CHECKING:
    from bsk_torch.sim.simulator import Simulator

TARGETS = "target_r_LP_P"
"""Name under which scenarios draw the places that are to be imaged."""

HINTS = {
    "ground_station": "add stations to world_args['groundStationsData'], lower gsMinimumElevation",
    "target": "all have been imaged, or too few lie below the orbit: ask for more targets, lower imageTargetMinimumElevation",
}
"""What to do when nothing comes into view."""


def places_in_view(simulator: Simulator) -> dict[str, PlacesOf]:
    """What the satellites can see, by type of opportunity."""
    kinds: dict[str, PlacesOf] = {}
    if "groundStationsData" in simulator.world_args.table:
        arrays = station_arrays(simulator.world_args.draw(first_key(1)))
        r_P = arrays["station_positions"].view(1, 3, -1).mT.contiguous().to(simulator.device)
        stations = Places(r_P, arrays["station_sin_elevations"].to(simulator.device))
        kinds["ground_station"] = lambda rows: stations
    if TARGETS in simulator.tables and "imageTargetMinimumElevation" in simulator.sat_args.table:
        kinds["target"] = lambda rows: _targets(simulator, rows)
    return kinds


def _targets(simulator: Simulator, rows: Tensor) -> Places:
    """Targets of the present episodes of ``rows``."""
    envs = rows // simulator.count
    r_P, exists = simulator.tables[TARGETS][envs], simulator.tables["target_exists"][envs] > 0.5
    least = torch.sin(simulator.drawn["imageTargetMinimumElevation"][rows]).unsqueeze(-1)
    return Places(torch.where(exists.unsqueeze(-1), r_P, torch.nan), least.expand_as(exists))


def positions(simulator: Simulator, kind: str, place: Tensor) -> Tensor:
    """Earth-fixed positions [N, n, 3], m, of places [N, n] of a kind."""
    if kind == "target":
        return simulator.look_up(simulator.tables[TARGETS], place)
    return cast("Access", simulator.access).kinds[kind](simulator.all_rows).r_P[0, place]


def next_eclipse(simulator: Simulator) -> tuple[Tensor, Tensor]:
    """Next start and end of an eclipse, [N] s since reset; see :meth:`bsk_torch.sim.eclipse.EclipseTable.query`."""
    time = simulator.sim_time
    simulator.reach(simulator.eclipses.needs(time))
    return simulator.eclipses.query(time)


def next_windows(
    simulator: Simulator,
    kind: str,
    width: int,
    allowed: Tensor | None = None,
    count: Tensor | None = None,
    last: Tensor | None = None,
    may_see_nothing: bool = False,
) -> tuple[Windows, Tensor]:
    """The windows over a kind of places that close next, [N, width], and how many of them there are, [N].

    The last is repeated where there are fewer. Segments are added until ``count`` windows are known.

    Args:
        simulator: Whose satellites ask.
        kind: A key of ``simulator.access.kinds``.
        width: Number of windows.
        allowed: Which places count, [N, P]; all of them unless given.
        count: How many each environment asks for, [N], at most ``width``, which it is unless given.
        last: Time, [N] s, from which on no segments are added; in any case no more than
            :data:`~bsk_torch.sim.access.LOOKAHEAD` are.
        may_see_nothing: Whether there may be none at all; look-ahead then ends as many segments from now, so that queries in vain
            do not add segments again and again.

    Raises:
        RuntimeError: Where a window is asked for, there is none within the look-ahead, and there must be one.
    """
    access, time = cast("Access", simulator.access), simulator.sim_time
    wanted = torch.full_like(simulator.ticks, width) if count is None else count
    windows, found = access.next(kind, time, width, allowed)
    short = rows = torch.nonzero(found < wanted).squeeze(-1)
    if not len(rows):
        return windows, found
    limit = (time if may_see_nothing else access.until) + LOOKAHEAD * access.segment
    limit = limit if last is None else torch.minimum(limit, last)
    while True:
        some = None if allowed is None else allowed[rows]
        rows = access.reveal(kind, rows, time[rows], wanted[rows], limit[rows], some)
        if not len(rows):
            break
        target = torch.zeros_like(time)
        target[rows] = access.ready[rows] + max(access.ahead * access.segment, PLAN_STEP * COUNT)
        simulator.reach(target)
        access.extend(rows, time)
    simulator.eclipses.sampled = torch.maximum(simulator.eclipses.sampled, access.until)
    more, number = access.next(kind, time, width, allowed, short)
    windows = Windows(*(a.index_copy(0, short, b) for a, b in zip(windows, more, strict=True)))
    found = found.index_copy(0, short, number)
    none = [] if may_see_nothing else torch.nonzero((found == 0) & (wanted > 0)).squeeze(-1).tolist()
    if none:
        raise RuntimeError(
            f"no {kind} comes into view of environments {none[:5]} within {LOOKAHEAD * access.segment:g} s; {HINTS[kind]}, "
            "or build the satellite with may_see_nothing=True"
        )
    return windows, found
