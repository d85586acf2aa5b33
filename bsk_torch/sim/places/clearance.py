"""Conditions of a clear view between a satellite and a place, and the tables that they read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from bsk_torch.astro.earth_rotation import IAU_EARTH, Earth
from bsk_torch.astro.eclipse import sunlight_margin
from bsk_torch.astro.ephemeris import earth_fixed_sun
from bsk_torch.astro.frames import sin_elevation
from bsk_torch.astro.geodetic import LARGEST_DEFLECTION, Vertical, axis_shift, vertical_of
from bsk_torch.astro.sight import POLAR_STRETCH, elevation_clearance, line_clearance, max_central_angle, stretch
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.component import Values
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.instruments import Instrument
from bsk_torch.sim.state import StateTable
from bsk_torch.vec3 import Vec3

SLACK = 1e-5  # angle, rad, or fraction by which screens are wider than bounds, which covers rounding


class PlaceTables(NamedTuple):
    """Tables that kinds of places read; N rows of satellites in ``num_envs`` environments.

    Draws and arguments change at resets, so they are read whenever positions are requested.
    """

    drawn: DrawTable  # draws of the scenario, [num_envs, ...] each
    arguments: StateTable  # arguments of satellites and world, [N, ...] each
    world: Values  # arguments of the world that are the same in all environments, such as the ground stations
    instruments: Sequence[Instrument] = ()  # several instruments of the satellites; none if they have a single one
    vertical: Vertical = "radius"  # direction from which elevations over targets are counted
    earth: Earth = IAU_EARTH  # model of the Earth's rotation

    def of_rows(self, name: str, rows: Tensor, place: Tensor) -> Tensor:
        """Return the draws ``name`` [num_envs, P, ...] for satellites ``rows`` [n] and places [n, ...]; [n, ..., ...]."""
        table, row = self.drawn.shared(name)
        envs = rows // self.arguments.count
        envs = envs if row is None else row[envs]
        return table[envs.view(-1, *[1] * (place.ndim - 1)), place]

    def of_envs(self, name: str, rows: Tensor) -> Tensor:
        """Return the draws ``name`` [num_envs, ...] of the environments of satellites ``rows`` [n], [n, ...]."""
        return self.drawn.of_envs(name, rows // self.arguments.count)

    def orientation(self, rows: Tensor, time: Tensor) -> Tensor:
        """Return the matrix [PN] at times [n, ...] s since the reset of satellites ``rows`` [n], [n, ..., 3, 3]."""
        return self.earth.orientation(self._et(rows, time))

    def sun(self, rows: Tensor, time: Tensor) -> Tensor:
        """Return the Earth-fixed position of the Sun, [n, ..., 3] m, at times [n, ...] s since the reset of ``rows`` [n]."""
        return earth_fixed_sun(self._et(rows, time), self.earth.orientation)

    def _et(self, rows: Tensor, time: Tensor) -> Tensor:
        return self.arguments["utc_init"][rows].view(-1, *[1] * (time.ndim - 1)) + time


class Sight(NamedTuple):
    """Satellites B and places L at the same times; all tensors broadcast to [n, ...]."""

    rows: Tensor  # rows of the satellites, [n]
    place: Tensor  # numbers of the places
    time: Tensor  # s since reset
    r_BP_P: Vec3  # Earth-fixed position of the satellite, m
    r_LP_P: Vec3  # Earth-fixed position of the place, m
    tables: PlaceTables  # of the kind, for the position of the Sun


class Clearance(Protocol):
    """One condition of a clear view."""

    def margin(self, sight: Sight) -> Tensor:
        """Return a smooth, dimensionless measure, [n, ...], that is positive where the condition holds.

        The search samples it every 30 s, and looks for extremes between three samples by the parabola through them.
        """

    def reachable(self, sight: Sight, moved_B: Tensor, moved_L: Tensor) -> Tensor:
        """Return False, [n, ...], where the condition cannot hold as long as neither satellite nor place is further away.

        The satellite moves by up to ``moved_B``, the place by up to ``moved_L`` m. True, the default, is always right, but slow.
        """
        return torch.ones_like(sight.r_LP_P.x, dtype=torch.bool)


Limit = float | Callable[[Tensor], Tensor]
"""A number, or a function of the rows [n] of satellites that returns one for each, [n]."""


def limit_of(rows: Tensor, limit: Limit, like: Tensor) -> Tensor:
    """Return a limit for satellites ``rows`` [n], so that it broadcasts with ``like`` [n, ...]."""
    return limit(rows).view(-1, *[1] * (like.ndim - 1)) if callable(limit) else torch.full_like(like[:1], limit)


@dataclass(frozen=True)
class AboveElevation:
    """The satellite is above a minimum elevation over the place; ``sin_min_elevation`` is its sine.

    It is counted from the place's radius, or from the normal of the ellipsoid with ``vertical="wgs84"``.
    """

    sin_min_elevation: Limit
    vertical: Vertical = "radius"

    def margin(self, sight: Sight) -> Tensor:
        """Return how far the satellite is above the least elevation, by :func:`~bsk_torch.astro.sight.elevation_clearance`."""
        least = limit_of(sight.rows, self.sin_min_elevation, sight.r_BP_P.x)
        shift = axis_shift(sight.r_LP_P) if self.vertical == "wgs84" else None
        return elevation_clearance(sight.r_BP_P, sight.r_LP_P, least, shift)

    def reachable(self, sight: Sight, moved_B: Tensor, moved_L: Tensor) -> Tensor:
        """Compare the central angle with the largest one: a point at r that moves by d turns by at most asin(d / r)."""
        r_B, r_L = sight.r_BP_P.norm(), sight.r_LP_P.norm()
        turn = torch.asin((moved_B / r_B).clamp(max=1.0)) + torch.asin((moved_L / r_L).clamp(max=1.0))
        ratio = (r_L - moved_L).clamp(min=0.0) / (r_B + moved_B)
        slack = SLACK + (2.0 * LARGEST_DEFLECTION if self.vertical == "wgs84" else 0.0)
        reach = turn + max_central_angle(ratio, limit_of(sight.rows, self.sin_min_elevation, sight.r_BP_P.x)) + slack
        return sight.r_LP_P.dot(sight.r_BP_P) / (r_B * r_L) > torch.cos(reach.clamp(max=torch.pi))


@dataclass(frozen=True)
class WithinRange:
    """Satellite and place are no further apart than ``max_range`` m."""

    max_range: Limit

    def margin(self, sight: Sight) -> Tensor:
        """Return ``(d_max^2 - d^2) / R^2`` at the distance d; its square is smooth where satellites pass close to each other."""
        line, most = sight.r_LP_P - sight.r_BP_P, limit_of(sight.rows, self.max_range, sight.r_BP_P.x)
        return (most * most - line.dot(line)) * (1.0 / (R_EARTH * R_EARTH))

    def reachable(self, sight: Sight, moved_B: Tensor, moved_L: Tensor) -> Tensor:
        """Compare the distance with the range and the way that both can make."""
        line, reach = sight.r_LP_P - sight.r_BP_P, limit_of(sight.rows, self.max_range, sight.r_BP_P.x)
        most = (reach + moved_B + moved_L) * (1.0 + SLACK)
        return line.dot(line) < most * most


@dataclass(frozen=True)
class ClearOfEarth:
    """The line of sight keeps ``altitude`` m above the Earth, the ellipsoid of lines of sight between satellites.

    Its polar radius is 0.98 of the equatorial one; see :mod:`bsk_torch.sim.access.links.line_of_sight`. For places in
    orbit: a place on the ground lies below the ellipsoid nowhere but near the poles.
    """

    altitude: float = 0.0

    def margin(self, sight: Sight) -> Tensor:
        """Return how far the line of sight passes above the altitude, in Earth radii."""
        pole = Vec3(*(sight.r_BP_P.x.new_full((), axis) for axis in (0.0, 0.0, 1.0)))
        clear = line_clearance(stretch(sight.r_BP_P, pole), stretch(sight.r_LP_P, pole))
        return (clear - self.altitude) * (1.0 / R_EARTH)

    def reachable(self, sight: Sight, moved_B: Tensor, moved_L: Tensor) -> Tensor:
        """Compare the margin with the larger displacement of the two ends, by which it changes at most."""
        return self.margin(sight) + torch.maximum(moved_B, moved_L) * (POLAR_STRETCH * (1.0 + SLACK) / R_EARTH) > 0.0


@dataclass(frozen=True)
class Lit(Clearance):
    """The Sun shines on the place: at least the fraction ``visible`` of its diameter is above the Earth's limb there.

    0 is the edge of the umbra, 1 that of the penumbra; at 0.5 half of the Sun's disc is visible. On the ground, the Sun is above
    the horizon.
    """

    visible: float = 0.0

    def margin(self, sight: Sight) -> Tensor:
        """Return how far the place is in the light, by :func:`~bsk_torch.astro.eclipse.sunlight_margin`."""
        return sunlight_margin(sight.r_LP_P, Vec3.of(sight.tables.sun(sight.rows, sight.time)), self.visible)


@dataclass(frozen=True)
class SunElevation(Clearance):
    """The Sun is at or above an elevation at the place, or at or below it if ``below``; ``sine`` is that of the elevation."""

    sine: Limit
    below: bool = False
    vertical: Vertical = "radius"

    def margin(self, sight: Sight) -> Tensor:
        """Return the difference of the sines; see :func:`bsk_torch.astro.frames.sin_elevation`."""
        return self.margin_at(sight.rows, sight.r_LP_P, sight.time, sight.tables)

    def margin_at(self, rows: Tensor, r_LP_P: Vec3, time: Tensor, tables: PlaceTables) -> Tensor:
        """Return the margin, [n, ...], at places [n, ...] m that satellites ``rows`` [n] see at times [n, ...] s."""
        sine = sin_elevation(Vec3.of(tables.sun(rows, time)), r_LP_P, vertical_of(r_LP_P, self.vertical))
        above = sine - limit_of(rows, self.sine, sine)
        return -above if self.below else above
