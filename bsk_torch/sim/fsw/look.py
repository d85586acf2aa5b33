"""Flight software for requests: looks of a required length, between release and due time, within the limits of each request."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.sim.component import Bus, Component, Field, Values
from bsk_torch.sim.dyn.events import DISARMED
from bsk_torch.sim.fsw.instrument import IMAGE_CONTROLLER, IMAGE_RESET, permission
from bsk_torch.sim.fsw.models import ImagingFSWModel
from bsk_torch.sim.fsw.modes import Mode
from bsk_torch.sim.fsw.target import Update, first_place, targets_that

LOOK_MODE = "look"
"""Flight mode in which requests are looked at."""

LIMITS = (
    Field("request_first_tick", 1, "-", "first tick at which the request may be looked at", exact=True, limit=DISARMED),
    Field("request_last_tick", 1, "-", "last tick at which the request may be looked at", exact=True, limit=DISARMED),
    Field("request_sin2_elevation", 1, "-", "squared sine of the least elevation of the request", exact=True, limit=1.0),
    Field(
        "request_cos2_off_nadir", 1, "-", "squared cosine of the largest off-nadir angle of the request", exact=True, limit=1.0
    ),
)
"""Limits of the request that the action has chosen."""


def aim_at_request(aim_at_current_place: Update) -> Update:
    """Return the update of requests, from that of other places in their light."""

    def aim(bus: Bus) -> None:
        """Write the place L in N, m, and its access, both of one tick ago; access is that of other places within the limits.

        The elevation is at least that of the request, too, and the angle between the directions of place and Earth's center,
        ``-r_BN . d <= |r_BN| |d| cos(most)`` with ``d = r_LN - r_BN``, at most that of the request. The tick lies between the
        first and the last one of the request.
        """
        bus.target_sin2_elevation = torch.maximum(bus.target_sin2_elevation, bus.request_sin2_elevation)
        aim_at_current_place(bus)
        line = bus.r_LN_N - bus.r_BN_N
        down = -bus.r_BN_N.dot(line)
        below = (down > 0.0) & (down * down >= bus.request_cos2_off_nadir * bus.r_BN_N.dot(bus.r_BN_N) * line.dot(line))
        timely = (bus.ticks >= bus.request_first_tick) & (bus.ticks <= bus.request_last_tick)
        bus.target_access = torch.where(below & timely, bus.target_access, torch.zeros_like(bus.target_access))

    return aim


def _first_request(args: Values) -> dict[str, Tensor]:
    """Return a request of the first place that may never be looked at."""
    none, never = torch.zeros(1, dtype=torch.float64), torch.full((1,), DISARMED, dtype=torch.float64)
    return first_place(args) | dict(zip((field.name for field in LIMITS), (never, none, none, none), strict=True))


REQUEST_TARGET = targets_that(aim_at_request, LIMITS, _first_request)


def command_look(bus: Bus) -> None:
    """Record in the tick in which a look is complete: permission in ``look_needed`` ticks without a gap.

    The first permitted tick is the beginning of the look. The instrument records in the tick after the command. ``image_taken``
    prevents others until a new task, and outside of location pointing nothing is recorded.
    """
    on = bus.location_on > 0.0
    looks = permission(bus) * (1.0 - bus.image_taken)
    ticks = torch.where(looks > 0.0, bus.look_ticks + 1.0, torch.zeros_like(bus.look_ticks))
    takes = torch.where(ticks > bus.look_needed, looks, torch.zeros_like(looks))
    bus.look_ticks = torch.where(on, ticks, bus.look_ticks)
    bus.instrument_command = torch.where(on, takes, torch.zeros_like(takes))
    bus.image_taken = torch.where(on & (takes > 0.0), torch.ones_like(takes), bus.image_taken)


LOOK_CONTROLLER = dataclasses.replace(
    IMAGE_CONTROLLER,
    update=command_look,
    resets=(("instrument_command", 0.0),),  # of an image of the last task that has not been recorded: it would count as another
    state=(
        *IMAGE_CONTROLLER.state,
        Field("look_ticks", 1, "-", "ticks of the current look, its first one included", exact=True),
        Field("look_needed", 1, "-", "ticks for which a look lasts after its first one", exact=True),
    ),
)


class LookFSWModel(ImagingFSWModel):
    """Points the instrument at places of requests, and takes the image of each when a look of the required length is complete.

    The mode ``"look"`` points at the place in the state ``r_LP_P`` [m, Earth-fixed], as ``"image"`` of other models does. A look
    is complete when pointing errors, access and time have been within their limits in every tick for as long as the request
    wants; a single tick outside starts it again. For :class:`bsk_torch.act.ImageRequest`.
    """

    components: ClassVar[tuple[Component, ...]] = (REQUEST_TARGET, LOOK_CONTROLLER)
    modes: ClassVar[dict[str, Mode | None]] = {
        "image": None,
        LOOK_MODE: Mode(("control_on", "location_on", "controller_on", "instrument_power"), IMAGE_RESET | {"look_ticks": 0.0}),
    }
