"""Where satellites are during an episode, in what light, and when images are possible: what bounds and schedules read."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.ephemeris import sun_position
from bsk_torch.astro.interpolate import positions
from bsk_torch.constants import AU, SOLAR_FLUX
from bsk_torch.env import SatelliteTasking
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sim.component import neighbours
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_at, fixed
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.builder import ARC
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING
from bsk_torch.sim.places import TARGET_KIND
from bsk_torch.vec3 import Vec3

CHUNK = 1 << 18
"""Positions interpolated at once."""

TICKS = 512
"""Ticks for which sunlight is computed at once."""


def satellite_positions(satellite: BoundAccessSatellite, rows: Tensor, time: Tensor) -> Tensor:
    """Return Earth-fixed positions of ``rows`` [m] at ``time`` [m] s since reset, [m, 3] m, on the orbits that ticks fly.

    The orbits must be solved that far.
    """
    parts = [_positions(satellite, *part) for part in zip(rows.split(CHUNK), time.split(CHUNK), strict=True)]
    return torch.cat(parts) if parts else time.new_zeros(0, 3)


def _positions(satellite: BoundAccessSatellite, rows: Tensor, time: Tensor) -> Tensor:
    arcs = satellite.simulator.lookahead.flight
    records, since = neighbours(EPHEMERIS_TRACK, arcs.ephemeris, rows, time - arcs.start[rows])
    ephemeris = ephemeris_at(records.flatten(1).unbind(-1), since)
    return torch.stack(list(fixed(ephemeris, Vec3.of(inertial_positions(arcs, rows, time)))), -1)


def inertial_positions(arcs: Arcs, rows: Tensor, time: Tensor) -> Tensor:
    """Return the positions of ``rows`` [m] at ``time`` [m] s since reset on the orbits that ticks fly, [m, 3] m in N."""
    nodes, tau = neighbours(ARC, arcs.flown, rows, time - arcs.start[rows] + LEAD_NODES * NODE_SPACING)
    return positions(nodes, tau / NODE_SPACING)


def sunlight(env: SatelliteTasking, rows: Tensor, ticks: Tensor) -> tuple[Tensor, Tensor]:
    """Return the illuminated fraction of the Sun and its flux, W/m^2, in ``rows`` [n] at the end of ``ticks`` [T], [n, T] each.

    The episodes must have just begun, and their orbits must be solved in advance. As in a tick, the shadow is computed for the
    position of the previous tick.
    """
    parts = [_sunlight(env, rows, part) for part in ticks.split(TICKS)]
    lit, flux = (torch.cat(columns, 1) for columns in zip(*parts, strict=True))
    return lit, flux


def _sunlight(env: SatelliteTasking, rows: Tensor, ticks: Tensor) -> tuple[Tensor, Tensor]:
    arcs, h = env.simulator.arcs, env.simulator.h
    owner, tick = rows.repeat_interleave(len(ticks)), ticks.repeat(len(rows))
    sun = sun_position(arcs.et[owner] + tick * h)
    lit = illumination(Vec3.of(inertial_positions(arcs, owner, (tick - 1) * h)), Vec3.of(sun))
    flux = SOLAR_FLUX * AU * AU / (sun - inertial_positions(arcs, owner, tick * h)).square().sum(-1)
    return lit.view(len(rows), -1), flux.view(len(rows), -1)


class Openings(NamedTuple):
    """When images may be completed, one entry for each window of each satellite, in the order of opening.

    Attributes:
        row: Satellite, [w].
        target: Index of the target, [w].
        first: First tick since reset at which a step may end with the image, [w].
        last: Last such tick, [w].
    """

    row: Tensor
    target: Tensor
    first: Tensor
    last: Tensor


def openings(satellite: BoundAccessSatellite, limit_ticks: Tensor) -> Openings:
    """Return when images may be completed up to the tick ``limit_ticks`` [N] of each satellite.

    An image is seen in the tick after the one in which the instrument may take it, and a window's end is seen at the first tick
    at or after it. One tick more is allowed on both sides: windows are those of the planned orbit, ticks fly another one that is
    meters away.
    """
    h = satellite.simulator.h
    opens, close, place = satellite.find_windows(limit_ticks.double() * h, TARGET_KIND)
    row, k = torch.nonzero(torch.isfinite(close), as_tuple=True)
    first = (torch.floor(opens[row, k] / h).long() - 1).clamp(min=1)
    last = torch.minimum(torch.ceil(close[row, k] / h).long() + 1, limit_ticks[row])
    valid = first <= last
    row, first, last, target = row[valid], first[valid], last[valid], place[row, k][valid]
    order = torch.argsort(row * (int(limit_ticks.max()) + 1) + first, stable=True)
    return Openings(row[order], target[order], first[order], last[order])
