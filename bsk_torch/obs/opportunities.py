"""Observations of the next opportunities: passes over ground stations, access windows of targets."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import text
from bsk_torch.astro.ephemeris import earth_fixed_sun
from bsk_torch.astro.frames import sin_elevation
from bsk_torch.astro.geodetic import vertical_of
from bsk_torch.obs.base import joined
from bsk_torch.obs.candidates import CandidateObservation
from bsk_torch.obs.entries import is_own, parse_entries, scaled
from bsk_torch.obs.requests import REQUEST_PRESETS
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.access.links.relative_geometry import SATELLITE_PROPERTIES
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.sim.instruments import number_of
from bsk_torch.sim.places import STATION_KIND, FixedPlaces, instrument_kind, is_target
from bsk_torch.sim.readout.observables import Function, observable
from bsk_torch.vec3 import Vec3

Preset = Callable[..., Tensor]
"""A function of the satellite and its next opportunities that returns [N, n] or [N, n, width]."""


def _relative(name: str) -> Preset:
    def seconds(satellite: BoundSatellite, opportunities: Opportunities) -> Tensor:
        return getattr(opportunities, name) - satellite.simulator.state.sim_time.unsqueeze(-1)

    return seconds


def priority(satellite: BoundSatellite, targets: Opportunities) -> Tensor:
    """Return the current priority of each target, [N, n]."""
    place = targets.place
    return satellite.scenario.priority_of(place.view(satellite.fleet.num_envs, -1)).view(place.shape)


def sun_elevation(satellite: BoundAccessSatellite, opportunities: Opportunities) -> Tensor:
    """Return the elevation of the Sun over each place when its window opens, or now if it is open, [N, n] rad.

    ``asin(v . d / (|v| |d|))`` with the vertical v at a place and the line d from there to the Sun; negative at night.
    """
    simulator, places = satellite.simulator, satellite.access_windows.kinds[opportunities.type]
    time = torch.maximum(opportunities.open, simulator.sim_time.unsqueeze(-1))
    r_SP_P = earth_fixed_sun(simulator.arcs.et.unsqueeze(-1) + time, simulator.arcs.solver.earth.orientation)
    r_LP_P = places.position(simulator.state.all_rows, opportunities.place, time)
    place = Vec3.of(r_LP_P)
    vertical = vertical_of(place, places.vertical) if isinstance(places, FixedPlaces) else place
    return torch.asin(sin_elevation(Vec3.of(r_SP_P), place, vertical))


def antenna_wait(satellite: BoundAccessSatellite, stations: Opportunities) -> Tensor:
    """Return for how long the satellite waits for an antenna in its next pass over each station, [N, n] s; see ``Antennas``."""
    fleet = satellite.fleet
    if fleet.antennas is None:
        return torch.zeros_like(stations.open)
    return fleet.rows_of(satellite.type_index, fleet.antennas.wait()).gather(1, stations.place)


def _relative_geometry(part: slice | int) -> Preset:
    def geometry(satellite: BoundAccessSatellite, opportunities: Opportunities, instrument: int | None = None) -> Tensor:
        return satellite.aims(opportunities, instrument)[..., part]

    return geometry


ADVICE = (
    "let it return [N, n] or [N, n, width] for all satellites: opp['object'].priority and opp['window'][0] are tensors [N, n], "
    "opp['r_LP_P'] [N, n, 3], and properties of the satellite [N, ...], as in satellite.simulator.sim_time.unsqueeze(-1)"
)
"""How to write a function of opportunities for all satellites."""

PRESETS: dict[str, Preset] = {
    "priority": priority,
    "r_LP_P": lambda satellite, opportunities: opportunities.r_LP_P,
    "r_LB_H": _relative_geometry(slice(0, 3)),
    "opportunity_open": _relative("open"),
    "opportunity_mid": _relative("mid"),
    "opportunity_close": _relative("close"),
    "target_angle": _relative_geometry(3),
    "target_angle_rate": _relative_geometry(4),
    "sun_elevation": sun_elevation,
    "antenna_wait": antenna_wait,
    **REQUEST_PRESETS,
}
"""Properties of opportunities: the allowed values of ``prop``."""

NEEDS = {
    "r_LB_H": ("r_BN_P", "v_BN_P"),
    "target_angle": SATELLITE_PROPERTIES,
    "target_angle_rate": SATELLITE_PROPERTIES,
}
"""Properties of the satellite read by presets, by preset."""


class OpportunityProperties(CandidateObservation):
    """Properties of the n opportunities that close next; action i of ``act.Image`` images the i-th target.

    Each argument is a dictionary with ``prop`` (see :data:`PRESETS`) or ``fn`` (function of the satellite and its
    :class:`~bsk_torch.sats.access.Opportunities` that returns [N, n] or [N, n, width]), and optionally ``norm`` (divisor; None
    for 1) and ``name``. With ``fn``, ``prop`` is just the label. If there are fewer opportunities, the last one is repeated.

    Functions are called for all opportunities of all satellites at once.
    """

    satellite: BoundAccessSatellite

    def __init__(
        self,
        *entries: Mapping[str, object],
        n_ahead_observe: int,
        type: str = "target",
        name: str | None = None,
        as_set: bool = False,
        instrument: str | int | None = None,
    ) -> None:
        """Observe opportunities.

        Args:
            *entries: Properties of each opportunity; see the class.
            n_ahead_observe: Number of opportunities n.
            type: ``"target"``, ``"ground_station"``, or another kind of places declared by the scenario or models.
            name: Name of the observation (default: that of the type).
            as_set: See :class:`~bsk_torch.obs.candidates.CandidateObservation`; the mask is 0 for repetitions.
            instrument: Name or number of one of several ``instruments``: opportunities are its own, and angles those of its axis
                (default: of the instrument chosen last).
        """
        kind = text("type", type)
        default = kind if instrument is None else f"{kind}_{instrument}"
        super().__init__(n_ahead_observe, default if name is None else name, as_set)
        if instrument is not None and not is_target(type):
            raise ValueError(f"instrument={instrument!r} has opportunities of targets; those of type {type!r} have none")
        parsed = parse_entries(entries, {"prop", "fn", "norm", "name"}, "obs.OpportunityProperties")
        for entry in parsed:
            if "fn" in entry:
                continue
            if entry["prop"] not in PRESETS:
                raise ValueError(f"prop={entry['prop']!r} is not a property of opportunities; {nearest(entry['prop'], PRESETS)}")
            if entry["prop"] == "antenna_wait" and type != STATION_KIND:
                raise ValueError(
                    f"prop='antenna_wait' is a property of ground stations; opportunities of type {type!r} have none"
                )
            if entry["prop"] == "priority" and not is_target(type):
                raise ValueError(f"prop={entry['prop']!r} is a property of targets; opportunities of type {type!r} have none")
        self.entries, self.type, self.instrument = parsed, kind, instrument
        self._number: int | None = None
        titles = (f"{entry['name']!r} of {self.name!r}" for entry in parsed)
        self._functions = [
            UserFunction(title, ADVICE) if "fn" in entry and not is_own(entry["fn"]) else None
            for entry, title in zip(parsed, titles, strict=True)
        ]

    @property
    @override
    def functions(self) -> list[UserFunction]:
        return [function for function in self._functions if function is not None]

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Observation.link_satellite`; ValueError for a satellite without such opportunities."""
        super().link_satellite(satellite)
        listed, kinds = satellite.simulator.type.instruments, getattr(satellite, "opportunity_types", ())
        if self.instrument is not None:
            number = number_of(listed, self.instrument, f"obs.OpportunityProperties {self.name!r}")
            self._number, self.type = number, instrument_kind(listed[number])
        if self.type not in kinds:
            raise ValueError(
                f"type={self.type!r}: {satellite.name} has opportunities of type {list(kinds) or 'none'}; targets need a "
                "sats.ImagingSatellite and a scenario such as scene.UniformTargets, ground stations a sats.AccessSatellite with "
                "dyn.GroundStationDynModel"
            )
        access = self.satellite.access_windows
        places = access.kinds[self.type]
        if not isinstance(places, FixedPlaces) and any(entry.get("prop") == "target_angle_rate" for entry in self.entries):
            raise ValueError(
                f"{self.name!r} observes target_angle_rate, only defined for places fixed on the Earth; places of type "
                f"{self.type!r} move"
            )
        for name in self._needs():
            if not (hasattr(type_of(satellite.dynamics), name) or hasattr(type_of(satellite.fsw), name)):
                raise ValueError(f"{self.name!r} observes targets by {name!r}, which {satellite.name} does not have")
        if any(entry.get("prop") in REQUEST_PRESETS for entry in self.entries) and not hasattr(satellite, "request_values"):
            raise ValueError(
                f"{self.name!r} observes properties of requests, which need a sats.RequestSatellite and scene.Requests; "
                f"{satellite.name} is a {type(satellite).__name__}"
            )
        if self.type != STATION_KIND:
            access.expect(self.n_ahead_observe, places.count)

    def _needs(self) -> list[str]:
        props = (entry["prop"] for entry in self.entries if "fn" not in entry)
        return [name for prop in props for name in NEEDS.get(prop, ())]

    @override
    def observables(self) -> list[Function]:
        models = [type_of(self.satellite.dynamics), type_of(self.satellite.fsw)]
        members = [getattr(model, name) for name in self._needs() for model in models if hasattr(model, name)]
        return [prop.function for prop in members if isinstance(prop, observable)]

    @override
    def columns(self) -> tuple[dict[str, Tensor], Tensor]:
        columns, opportunities = self._read()
        if getattr(self.satellite, "may_see_nothing", False):
            nothing = (opportunities.found == 0).unsqueeze(-1)
            for name, column in columns.items():
                columns[name] = column.masked_fill(nothing if column.ndim == 2 else nothing.unsqueeze(-1), 0)
        return columns, opportunities.mask

    @override
    def side_by_side(self) -> tuple[Tensor, Tensor | None]:
        columns, opportunities = self._read()
        rows = joined(columns)
        if getattr(self.satellite, "may_see_nothing", False):
            rows = rows.masked_fill((opportunities.found == 0).view(-1, 1, 1), 0)
        return rows, opportunities.mask if self.as_set else None

    def _read(self) -> tuple[dict[str, Tensor], Opportunities]:
        """Return the properties of the opportunities, those of none included, by name, and the opportunities."""
        opportunities = self.satellite.find_next_opportunities(self.n_ahead_observe, self.type)
        columns = {}
        for entry, function in zip(self.entries, self._functions, strict=True):
            if function is None:
                preset = entry.get("fn") or PRESETS[entry["prop"]]
                of_instrument = () if "fn" in entry or entry["prop"] not in NEEDS or self._number is None else (self._number,)
                column = preset(self.satellite, opportunities, *of_instrument)
            else:
                call = functools.partial(entry["fn"], self.satellite, opportunities)
                column = function(tuple(opportunities.open.shape), self.simulator.device, call)
            columns[entry["name"]] = scaled(column, entry["norm"])
        return columns, opportunities


def type_of(model: object) -> type:
    """Return the class of a model; ``type`` is the name of an argument in this module."""
    return model.__class__
