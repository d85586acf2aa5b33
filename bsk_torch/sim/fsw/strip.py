"""Flight software for strips: the place at which the instrument points moves along a great circle. Basilisk's stripLocation."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.sim.component import Bus, Component, Field, Values, vec
from bsk_torch.sim.dyn.models import DynamicsModel, StripImagingDynModel
from bsk_torch.sim.fsw.guidance import guided_angle
from bsk_torch.sim.fsw.instrument import SCANNING_CONTROLLER
from bsk_torch.sim.fsw.models import ImagingFSWModel
from bsk_torch.sim.fsw.modes import Mode
from bsk_torch.sim.fsw.target import Update, first_place, targets_that
from bsk_torch.sim.readout.observables import Now, observable
from bsk_torch.vec3 import select

STRIP_MODE = "image_strip"  # flight mode in which strips are recorded
ROUNDING = 1e-12  # angle by which rounding may put a place before the start of its strip, rad; 6 micrometers on the ground


def aim_at_strip(aim_at_current_place: Update) -> Update:
    """Return the update of strips, from that of other places in their light."""

    def aim(bus: Bus) -> None:
        """Move the place L along its strip, and write it in N, m, and its access, both of one tick ago.

        With the middle ``m`` of the strip, its direction ``a`` there, of the same length, and the angle ``phi`` from the
        middle::

            r_LP = m cos(phi) + a sin(phi)        phi' = acquisition speed / |m|

        Access is that of other places, and none before the start of the strip, ``phi < -half``.
        """
        on, angle = bus.location_on > 0.0, bus.strip_angle
        place = bus.strip_middle * torch.cos(angle) + bus.strip_along * torch.sin(angle)
        bus.r_LP_P = select(on, place, bus.r_LP_P)
        aim_at_current_place(bus)
        begun = angle >= -bus.strip_half - ROUNDING
        bus.target_access = torch.where(begun, bus.target_access, torch.zeros_like(bus.target_access))
        bus.strip_angle = torch.where(on, angle + bus.strip_rate * bus.h, angle)

    return aim


def _first_strip(args: Values) -> dict[str, Tensor]:
    """Return a strip without a length or a speed at the first place."""
    first = first_place(args)
    middle, none = first["r_LP_P"], torch.zeros(1, dtype=torch.float64)
    along = middle.roll(1, -1)
    return first | dict(strip_middle=middle, strip_along=along, strip_angle=none, strip_half=none, strip_rate=none)


STRIP = (
    vec("strip_middle", "m", "middle of the strip, Earth-fixed", exact=True),
    vec("strip_along", "m", "direction of the strip in its middle, as long as the middle, Earth-fixed", exact=True),
    Field("strip_angle", 1, "rad", "angle from the middle to the current place of the strip", exact=True),
    Field("strip_half", 1, "rad", "angle from the start of the strip to its middle", exact=True),
    Field("strip_rate", 1, "rad/s", "angle by which the place moves in a second", exact=True),
)

STRIP_TARGET = targets_that(aim_at_strip, STRIP, _first_strip)


class StripImagingFSWModel(ImagingFSWModel):
    """Points the instrument at places that move along strips, and records while it does.

    The mode ``"image_strip"`` follows the strip of :class:`bsk_torch.act.ImageStrip` as Basilisk's stripLocation does, at a
    constant speed, also before its start, where nothing is recorded.
    """

    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (StripImagingDynModel,)
    components: ClassVar[tuple[Component, ...]] = (STRIP_TARGET, SCANNING_CONTROLLER)
    modes: ClassVar[dict[str, Mode | None]] = {
        "image": None,
        STRIP_MODE: Mode(("control_on", "location_on", "controller_on", "instrument_linked", "instrument_power")),
    }

    @observable
    def target_pointing_error(now: Now) -> Tensor:
        """Angle between the instrument axis and the direction of the strip's place, [N] rad, when last pointed there."""
        return guided_angle(now)
