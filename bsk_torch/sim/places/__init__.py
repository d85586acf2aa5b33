"""Kinds of places that satellites may see: fixed on the Earth, moving on the Earth, in orbit."""

from bsk_torch.sim.places.base import (
    STATION_KIND,
    TARGET_KIND,
    TARGETS,
    DrawnPlaces,
    DrawnTargets,
    FixedPlaces,
    Places,
    Sites,
    instrument_kind,
    is_target,
)
from bsk_torch.sim.places.clearance import (
    AboveElevation,
    Clearance,
    ClearOfEarth,
    Lit,
    PlaceTables,
    Sight,
    SunElevation,
    WithinRange,
)
from bsk_torch.sim.places.moving import GreatCirclePlaces
from bsk_torch.sim.places.orbiting import OrbitingPlaces

__all__ = [
    "STATION_KIND",
    "TARGETS",
    "TARGET_KIND",
    "AboveElevation",
    "ClearOfEarth",
    "Clearance",
    "DrawnPlaces",
    "DrawnTargets",
    "FixedPlaces",
    "GreatCirclePlaces",
    "Lit",
    "OrbitingPlaces",
    "PlaceTables",
    "Places",
    "Sight",
    "Sites",
    "SunElevation",
    "WithinRange",
    "instrument_kind",
    "is_target",
]
