"""Observation of the next areas below the orbit, and of what recording them would bring."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.astro.ephemeris import earth_orientation
from bsk_torch.obs.candidates import CandidateProperties
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING
from bsk_torch.tasks.areas.scene import AREA_KIND, RECORDED, Areas
from bsk_torch.vec3 import Mat3, Vec3

HORIZON = 5700.0
"""Longest time observed, s: about one revolution."""

SOON = 240.0
"""Time that divides ``opens_soon`` and ``closes_soon`` by e, s: about that of a turn."""


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
        if AREA_KIND not in getattr(satellite, "opportunity_types", ()):
            raise ValueError(f"{self.name!r} observes areas: {satellite.name} must be a sats.AccessSatellite, the scenario Areas")
        access = self.satellite.access_windows
        access.expect(self.n_ahead_observe, access.kinds[AREA_KIND].count)

    @override
    def read_candidates(self, wanted: frozenset[str]) -> tuple[dict[str, Tensor], Tensor]:
        ahead = self.satellite.find_next_opportunities(self.n_ahead_observe, AREA_KIND)
        scenario: Areas = self.satellite.scenario
        simulator = self.simulator
        now, env = simulator.state.sim_time.unsqueeze(-1), simulator.of_env(self.satellite.fleet.all_envs).unsqueeze(-1)
        index = scenario.index[env, ahead.place]
        opens, closes = (torch.clamp(time - now, 0.0, HORIZON) for time in (ahead.open, ahead.close))
        share = scenario.share[index] * scenario.due(
            scenario.memory[RECORDED][env, ahead.place], simulator.state.ticks.view(-1, 1, 1)
        )
        left, along = self._track(ahead)
        cells = Vec3.of(scenario.r_CP_P[index])
        half = 0.5 * scenario.swath
        seen = (cells.dot(left).abs() <= half) & ((cells.dot(along) >= -half) | (opens > 0.0).unsqueeze(-1))
        weight, gain = scenario.weight[env, ahead.place], torch.where(seen, share, 0.0).sum(-1)
        values = {
            "pays": weight * gain,
            "opens_soon": torch.exp(-opens / SOON),
            "closes_soon": torch.exp(-closes / SOON),
            "opens": opens,
            "closes": closes,
            "weight": weight,
            "remaining": share.sum(-1),
            "gain": gain,
            "offset": Vec3.of(scenario.center[index].unsqueeze(-2)).dot(left).squeeze(-1) / scenario.reach[index],
        }
        return values, ahead.mask

    def _track(self, ahead: Opportunities) -> tuple[Vec3, Vec3]:
        """Return unit vectors, Earth-fixed, [N, n, 1]: to the left in the middle of each window, and ahead of the satellite.

        The plane of the track goes through the Earth's center and two places below the orbit that are a minute apart.
        """
        arcs, rows = self.simulator.lookahead.arcs, self.simulator.state.all_rows.unsqueeze(-1)
        start = arcs.start.unsqueeze(-1)
        node = torch.floor((ahead.mid - start) / NODE_SPACING).clamp(min=0.0)
        node = torch.minimum(node, torch.floor((arcs.end.unsqueeze(-1) - start) / NODE_SPACING) - 1.0)
        r_N = [arcs.flown[rows, node.long() + LEAD_NODES + k] for k in (0, 1)]
        time = arcs.et.unsqueeze(-1) + start + NODE_SPACING * node
        before, after = (Mat3.of(earth_orientation(time + NODE_SPACING * k)) @ Vec3.of(r) for k, r in enumerate(r_N))
        left = before.cross(after).unit()
        along = left.cross(Vec3.of(self.satellite.dynamics.r_BN_P.unsqueeze(-2))).unit()
        return Vec3(*(part.unsqueeze(-1) for part in left)), Vec3(*(part.unsqueeze(-1) for part in along))
