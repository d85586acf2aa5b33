"""Radio between imagers: power, and the time for which a link has been held."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.astro.sight import line_clearance
from bsk_torch.sim.component import Bus, Component, Field
from bsk_torch.sim.dyn.power.balance import power_arg
from bsk_torch.tasks.objects.dyn import HELD, SpaceToSpaceImagingDynModel, end_step

LINK_FIELDS = (
    Field("radio_armed", 1, "-", "1 from the command to transmit until the packet has been sent, else 0"),
    Field("radio_valid", 1, "-", "1 where the link was valid in the last tick"),
    Field("radio_held", 1, "s", "time for which the link has been valid without a break", exact=True),
)
"""Fields of the link that every command sets to zero."""

TASK_FIELDS = (
    Field("radio_hold", 1, "s", "time for which the link must be valid", exact=True),
    Field("radio_sees_all", 1, "-", "1 where the Earth does not block links"),
)
"""Requirements of the task."""


def transmit_packet(bus: Bus) -> None:
    """Hold the link in a tick, and stop when the packet has been sent.

    The link is valid where pointing of this tick is within the requirements of images, and the segment between the two satellites
    does not touch a sphere of the Earth's equatorial radius::

        held += h    valid now, and in the tick before
        held  = 0    else
        sent: held >= hold
    """
    armed, zero = bus.radio_armed > 0.0, torch.zeros_like(bus.radio_held)
    clear = (line_clearance(bus.r_TN_N, bus.r_BN_N) > 0.0) | (bus.radio_sees_all > 0.0)
    valid = armed & (bus.rso_pointed > 0.0) & clear
    held = torch.where(valid & (bus.radio_valid > 0.0), bus.radio_held + bus.h, zero)
    sent = valid & (held + HELD >= bus.radio_hold)
    bus.radio_held = torch.where(sent, zero, held)
    off = torch.zeros_like(bus.radio_valid)
    bus.radio_valid = torch.where(valid & ~sent, torch.ones_like(off), off)
    bus.radio_armed = torch.where(sent, torch.zeros_like(bus.radio_armed), bus.radio_armed)
    end_step(bus, sent)


def draw_power(bus: Bus) -> None:
    """Draw the power of the radio, W, in the tick after one with a valid link."""
    bus.power = bus.power + bus.radio_power * bus.radio_valid


LINK = Component(
    slot="radio_link",
    after="control",
    update=transmit_packet,
    stops=True,
    state=(*LINK_FIELDS, *TASK_FIELDS),
    resets=tuple((field.name, 0.0) for field in LINK_FIELDS),
)

POWER = Component(
    slot="radio_draw",
    before="battery",
    update=draw_power,
    args=(power_arg("radioPowerDraw", -25.0, "power of the radio between satellites while its link is valid, negative"),),
    params=(Field("radio_power", 1, "W"),),
    prepare=lambda args: {"radio_power": args["radioPowerDraw"]},
)


class CatalogRadioDynModel(SpaceToSpaceImagingDynModel):
    """A radio, with which an imager tells another what it knows; see :class:`~bsk_torch.tasks.objects.TransmitCatalog`."""

    components: ClassVar[tuple[Component, ...]] = (LINK, POWER)

    @property
    def radio_held(self) -> Tensor:
        """Time for which the link has been valid without a break, [N] s."""
        return self.simulator.state.read("radio_held")
