"""Observations of the areas below the orbit, and of what recording them would bring."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, whole
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, earth_orientation
from bsk_torch.obs.base import Observation, Values
from bsk_torch.obs.candidates import CandidateProperties
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING
from bsk_torch.sim.places import STATION_KIND
from bsk_torch.tasks.areas.scene import AREA_KIND, RECORDED, Areas
from bsk_torch.vec3 import Mat3, Vec3

HORIZON = 5700.0
"""Longest time observed, s: about one revolution."""

SOON = 240.0
"""Time that divides ``opens_soon`` and ``closes_soon`` by e, s: about that of a turn."""

INTERVALS = (60.0,) * 8 + (120.0,) * 8 + (300.0,) * 8
"""Intervals of :class:`AreaOutlook`, s: those that begin soon are short."""

STATIONS = 6
"""Number of passes over ground stations that :class:`AreaOutlook` looks at."""


class Passes(NamedTuple):
    """What is known of the windows of n areas, [N, n] each; times are from now on, s.

    Attributes:
        opens: Time until the window opens, negative where it has.
        closes: Time until it closes.
        weight: Weight of the area.
        remaining: Due share of its surface.
        gain: The part of ``remaining`` that a scan along the rest of the window would record.
        offset: Distance of its center from the plane of the track, left of it, as a fraction of the reach.
        exists: Whether there is such a window.
    """

    opens: Tensor
    closes: Tensor
    weight: Tensor
    remaining: Tensor
    gain: Tensor
    offset: Tensor
    exists: Tensor


def area_passes(satellite: BoundAccessSatellite, n: int) -> Passes:
    """Return what is known of the ``n`` areas whose windows close next."""
    ahead = satellite.find_next_opportunities(n, AREA_KIND)
    scenario: Areas = satellite.scenario
    simulator = satellite.simulator
    now, env = simulator.state.sim_time.unsqueeze(-1), simulator.of_env(satellite.fleet.all_envs).unsqueeze(-1)
    index, opens = scenario.index[env, ahead.place], ahead.open - now
    recorded = scenario.memory[RECORDED]
    recorded = _rows(recorded.flatten(0, 1), env * recorded.shape[1] + ahead.place)
    share = _rows(scenario.share, index) * scenario.due(recorded, simulator.state.ticks.view(-1, 1, 1))
    left_axis, forward_axis = _track(satellite, ahead)
    half = 0.5 * scenario.swath
    in_strip = _along(scenario.cells, index, left_axis).abs_() <= half
    open_now = torch.nonzero(opens <= 0.0).unbind(1)  # few: elsewhere all cells are ahead
    ahead_now = _along(scenario.cells, index[open_now], Vec3(*(part[open_now] for part in forward_axis))) >= -half
    in_strip[open_now] &= ahead_now
    return Passes(
        opens=opens,
        closes=ahead.close - now,
        weight=scenario.weight[env, ahead.place],
        remaining=share.sum(-1),
        gain=(share * in_strip).sum(-1),
        offset=Vec3.of(scenario.center[index]).dot(left_axis) / scenario.reach[index],
        exists=ahead.mask,
    )


def _rows(table: Tensor, index: Tensor) -> Tensor:
    """Return the rows [..., C] of a table [L, C] with indices [...], several times as fast as by brackets."""
    return table.index_select(0, index.flatten()).view(*index.shape, table.shape[1])


def _along(cells: Vec3, index: Tensor, direction: Vec3) -> Tensor:
    """Return how far the cells of areas with an ``index`` [...] are along unit vectors, [...], m, [..., C].

    By coordinates and in place: temporary tensors of all cells of all areas take most of the time.
    """
    total, y, z = (_rows(part, index).mul_(unit.unsqueeze(-1)) for part, unit in zip(cells, direction, strict=True))
    return total.add_(y).add_(z)


def _track(satellite: BoundAccessSatellite, ahead: Opportunities) -> tuple[Vec3, Vec3]:
    """Return unit vectors, Earth-fixed, [N, n]: to the left in the middle of each window, and ahead of the satellite.

    The plane of the track goes through the Earth's center and two places below the orbit that are a minute apart.
    """
    simulator = satellite.simulator
    arcs, rows, now = simulator.lookahead.arcs, simulator.state.all_rows.unsqueeze(-1), simulator.state.sim_time.unsqueeze(-1)
    start = arcs.start.unsqueeze(-1)
    node = torch.floor((ahead.mid - start) / NODE_SPACING).clamp(min=0.0)
    node = torch.minimum(node, torch.floor((arcs.end.unsqueeze(-1) - start) / NODE_SPACING) - 1.0)
    PN, later = Mat3.of(earth_orientation(arcs.et.unsqueeze(-1) + now)), start - now + NODE_SPACING * node
    before, after = (
        _turned(PN @ Vec3.of(arcs.flown[rows, node.long() + LEAD_NODES + k]), later + NODE_SPACING * k) for k in (0, 1)
    )
    left_axis = before.cross(after).unit()
    return left_axis, left_axis.cross(Vec3.of(satellite.dynamics.r_BN_P.unsqueeze(-2))).unit()


def _turned(r_P: Vec3, time: Tensor) -> Vec3:
    """Return positions in the axes of the Earth after a ``time``, s, for such in its present axes; the axis does not move."""
    angle = EARTH_ROTATION_RATE * time
    sin, cos = angle.sin(), angle.cos()
    return Vec3(r_P.x * cos + r_P.y * sin, r_P.y * cos - r_P.x * sin, r_P.z)


def _link_areas(satellite: BoundAccessSatellite, name: str, n: int) -> None:
    """Expect queries of ``n`` areas; ValueError for a satellite without areas."""
    if AREA_KIND not in getattr(satellite, "opportunity_types", ()):
        raise ValueError(f"{name!r} observes areas: {satellite.name} must be a sats.AccessSatellite, the scenario Areas")
    access = satellite.access_windows
    access.expect(n, access.kinds[AREA_KIND].count)


class AreaProperties(CandidateProperties):
    """Properties of the n areas whose windows close next: times in which the swath may show a part of an area.

    ======================  =========================================================================================
    ``opens``, ``closes``   time until the window opens, 0 where it has, and until it closes, s; up to 5700 s
    ``weight``              weight of the area
    ``remaining``           due share of its surface
    ``gain``                the part of ``remaining`` that a scan along the rest of the window would record
    ``offset``              distance of its center from the plane of the track, left of it, as a fraction of the reach
    ``pays``                ``weight`` times ``gain``
    ``opens_soon``          exp(-``opens`` / 240 s), which tells minutes apart, and the same of ``closes``: ``closes_soon``
    ======================  =========================================================================================

    A window lasts while the satellite is above a cap of the Earth around the *center* of the area, the mean of its cells moved to
    the equatorial radius. The cap ends at the central angle of a chord at the polar radius that is as long as the *reach*, the
    largest distance of a cell from the center plus half a swath.

    ``gain`` and ``offset`` are those of a great circle, through the places below the satellite at the whole minutes since reset
    before and after the middle of the window. The track deviates from it by a few kilometers within minutes.
    """

    properties: ClassVar[Sequence[str]] = (
        "opens",
        "closes",
        "weight",
        "remaining",
        "gain",
        "offset",
        "pays",
        "opens_soon",
        "closes_soon",
    )
    usual: ClassVar[Sequence[dict[str, Any]]] = (
        dict(prop="opens", norm=HORIZON),
        dict(prop="closes", norm=HORIZON),
        dict(prop="weight"),
        dict(prop="remaining"),
        dict(prop="gain"),
        dict(prop="offset"),
        dict(prop="pays"),
        dict(prop="opens_soon"),
        dict(prop="closes_soon"),
    )
    title: ClassVar[str] = "AreaProperties"
    satellite: BoundAccessSatellite

    def __init__(self, *properties: dict[str, Any], n_ahead_observe: int = 4, name: str = "areas", as_set: bool = False) -> None:
        """See :class:`~bsk_torch.obs.candidates.CandidateProperties`; all properties unless some are given."""
        super().__init__(*properties, n_ahead_observe=n_ahead_observe, name=name, as_set=as_set)

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        _link_areas(self.satellite, self.name, self.n_ahead_observe)

    @override
    def read_candidates(self, wanted: frozenset[str]) -> tuple[dict[str, Tensor], Tensor]:
        ahead = area_passes(self.satellite, self.n_ahead_observe)
        opens, closes = (torch.clamp(time, 0.0, HORIZON) for time in (ahead.opens, ahead.closes))
        values = {
            "opens": opens,
            "closes": closes,
            "weight": ahead.weight,
            "remaining": ahead.remaining,
            "gain": ahead.gain,
            "offset": ahead.offset,
            "pays": ahead.weight * ahead.gain,
            "opens_soon": torch.exp(-opens / SOON),
            "closes_soon": torch.exp(-closes / SOON),
        }
        return values, ahead.exists


class AreaOutlook(Observation):
    """What scans would bring in each of the next intervals of time, and the part of each in which a station is in view.

    ======================  =========================================================================================
    ``worth`` (K)           weight times gain of the areas, each spread evenly over the rest of its window
    ``in_view`` (K)         part of the interval in which a ground station is in view, 1 for all of it; only for satellites
                            that can downlink
    ======================  =========================================================================================

    Windows and gains are as for :class:`AreaProperties`, of the areas and of the six passes over stations that close next.
    """

    satellite: BoundAccessSatellite

    def __init__(self, widths: Sequence[float] = INTERVALS, n_areas: int = 24, name: str = "outlook") -> None:
        """Observe intervals of the ``widths`` [K] s, one after the other from now on, with the next ``n_areas``."""
        super().__init__(name)
        for width in widths:
            number("widths", width, 0.0, unit="s", above=True)
        self.ends = torch.tensor(widths, dtype=torch.float64).cumsum(0)
        self.n_areas = whole("n_areas", n_areas, 1)

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        _link_areas(self.satellite, self.name, self.n_areas)
        self.n_areas = min(self.n_areas, self.satellite.places(AREA_KIND))  # few areas: far more would be days away

    @override
    def get_obs(self) -> Values:
        areas = area_passes(self.satellite, self.n_areas)
        rest = (areas.closes - areas.opens.clamp(min=0.0)).clamp(min=1.0)
        per_second = torch.where(areas.exists, areas.weight * areas.gain / rest, 0.0)
        outlook = {"worth": self._spread(areas.opens, areas.closes, per_second)}
        if STATION_KIND not in self.satellite.opportunity_types:
            return outlook
        stations = self.satellite.find_next_opportunities(STATIONS, STATION_KIND)
        now = self.simulator.state.sim_time.unsqueeze(-1)
        in_view = self._spread(stations.open - now, stations.close - now, stations.mask.double())
        widths = self.ends.diff(prepend=self.ends.new_zeros(1)).to(in_view.device)
        return outlook | {"in_view": (in_view / widths).clamp(max=1.0)}

    def _spread(self, opens: Tensor, closes: Tensor, rate: Tensor) -> Tensor:
        """Return the integral over each interval, [N, K], of what n windows bring per second, [N, n]."""
        passed = torch.minimum(self.ends.to(opens.device), closes.unsqueeze(-1)) - opens.clamp(min=0.0).unsqueeze(-1)
        total = (passed.clamp(min=0.0) * rate.unsqueeze(-1)).sum(1)
        return total.diff(prepend=torch.zeros_like(total[:, :1]))
