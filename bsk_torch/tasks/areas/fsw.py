"""Flight software that leaves a trace of where the instrument records the ground."""

from __future__ import annotations

from typing import ClassVar

import torch

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.astro.frames import rotate_z
from bsk_torch.astro.geodetic import FLATTENING, SEMI_MAJOR_AXIS
from bsk_torch.sim.component import Bus, Component, vec
from bsk_torch.sim.dyn import ContinuousImagingDynModel, DynamicsModel
from bsk_torch.sim.dyn.storage.store import level_after
from bsk_torch.sim.fsw import ContinuousImagingFSWModel
from bsk_torch.vec3 import Vec3, only

FOOTPRINT = "footprint_P"
"""Field with the place on the ground recorded in a tick."""


def record_footprint(bus: Bus) -> None:
    """Write where the axis of the instrument meets the WGS84 ellipsoid at the end of the tick, Earth-fixed, m.

    Zero where nothing is recorded: where the instrument is off, its data do not fit into the store, or its axis misses the Earth.
    With the satellite at r and the axis d, both with z stretched to make the ellipsoid a sphere of radius a, the near point::

        r + d t,   t = (-r . d - sqrt((r . d)^2 - d^2 (r^2 - a^2))) / d^2
    """
    records = level_after(bus.storage, bus.instrument_rate, bus) > bus.storage
    none = Vec3.zeros_like(bus.storage)

    def seen() -> Vec3:
        flat = 1.0 - FLATTENING
        axis_N = (mrp_to_dcm(bus.sigma_BN).mT @ bus.instrument_axis_B).to(torch.float64)
        r, d = (rotate_z(bus.EN @ vector, bus.cos_earth, bus.sin_earth) for vector in (bus.r_BN_N, axis_N))
        r, d = Vec3(r.x, r.y, r.z * (1.0 / flat)), Vec3(d.x, d.y, d.z * (1.0 / flat))
        along, square = r.dot(d), d.dot(d)
        inside = along * along - square * (r.dot(r) - SEMI_MAJOR_AXIS * SEMI_MAJOR_AXIS)
        distance = (-along - torch.sqrt(torch.clamp(inside, min=0.0))) * (1.0 / square)
        hits = torch.where((inside > 0.0) & (distance > 0.0), torch.ones_like(along), torch.zeros_like(along))
        place = r + d * distance
        return Vec3(place.x, place.y, place.z * flat) * hits

    setattr(bus, FOOTPRINT, only(records, seen, none))


class AreaScanFSWModel(ContinuousImagingFSWModel):
    """Scans along the ground track, and records at which places.

    For :class:`bsk_torch.tasks.areas.Areas`; the dynamics model is a :class:`bsk_torch.sim.dyn.ContinuousImagingDynModel`.
    """

    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (ContinuousImagingDynModel,)
    components: ClassVar[tuple[Component, ...]] = (
        Component(
            slot="footprint",
            before="storage",
            update=record_footprint,
            state=(vec(FOOTPRINT, "m", "recorded place on the ground, Earth-fixed; zero where nothing is recorded", exact=True),),
            records=(FOOTPRINT,),
        ),
    )
