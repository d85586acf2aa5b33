"""Observations of the next opportunities: stations that will see the satellite."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from torch import Tensor

from bsk_torch.obs.base import Observation, Values, check_entries, property_name, scaled
from bsk_torch.sim.params import nearest

if TYPE_CHECKING:
    from bsk_torch.sats.access import AccessSatellite, Opportunities
    from bsk_torch.sats.satellite import Satellite


def _relative(name: str) -> Any:
    def seconds(satellite: Satellite, opportunities: Opportunities) -> Tensor:
        return getattr(opportunities, name) - satellite.simulator.sim_time.unsqueeze(-1)

    return seconds


PRESETS = {
    "r_LP_P": lambda satellite, opportunities: opportunities.r_LP_P,
    "opportunity_open": _relative("open"),
    "opportunity_mid": _relative("mid"),
    "opportunity_close": _relative("close"),
}
"""What ``prop`` may name: functions of the satellite and the next opportunities, [N, n] or [N, n, width]."""


class OpportunityProperties(Observation):
    """Properties of the ``n_ahead_observe`` opportunities that close next.

    Each argument is a dictionary with ``prop`` (see :data:`PRESETS`) or ``fn`` (called with the satellite and its
    :class:`~bsk_torch.sats.access.Opportunities`), and optionally ``norm`` and ``name``.
    """

    def __init__(
        self, *entries: dict[str, Any], n_ahead_observe: int, type: str = "ground_station", name: str | None = None
    ) -> None:
        """See the class; ``type`` is the kind of opportunity. ValueError for unknown keys or presets."""
        super().__init__(name or type)
        check_entries(entries, {"prop", "fn", "norm", "name"}, "obs.OpportunityProperties")
        for entry in entries:
            if "prop" in entry and entry["prop"] not in PRESETS:
                raise ValueError(f"prop={entry['prop']!r} is not a property of opportunities; {nearest(entry['prop'], PRESETS)}")
        if n_ahead_observe < 1:
            raise ValueError(f"n_ahead_observe={n_ahead_observe} must be at least 1")
        self.entries, self.n_ahead_observe, self.type = entries, n_ahead_observe, type

    def link_satellite(self, satellite: Satellite) -> None:
        """See :meth:`Observation.link_satellite`; ValueError for a satellite without such opportunities."""
        super().link_satellite(satellite)
        kinds = getattr(satellite, "opportunity_types", ())
        if self.type not in kinds:
            raise ValueError(
                f"type={self.type!r}: {satellite.name} has opportunities of type {list(kinds) or 'none'}; ground stations need "
                f"a sats.AccessSatellite with dyn.GroundStationDynModel"
            )

    def get_obs(self) -> Values:
        """See :meth:`Observation.get_obs`."""
        opportunities = cast("AccessSatellite", self.satellite).find_next_opportunities(self.n_ahead_observe, self.type)
        columns = {}
        for entry in self.entries:
            function = entry.get("fn") or PRESETS[entry["prop"]]
            columns[property_name(entry)] = scaled(function(self.satellite, opportunities), entry.get("norm", 1.0))
        return {f"{self.name}_{k}": {name: column[:, k] for name, column in columns.items()} for k in range(self.n_ahead_observe)}
