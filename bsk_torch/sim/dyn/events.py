"""The event that ends a step from within a tick: the first image of a task."""

from __future__ import annotations

import torch

from bsk_torch.sim.component import Bus, Component, Field

DISARMED = 1e300
"""Level that no store reaches, bit; finite, so that infinities in a state are errors."""


def notice_image(bus: Bus) -> None:
    """Count an image and stop where the first partition holds more than ``image_level``, which then is disarmed.

    Actions arm the event with the level of their time. Nothing else disarms it, so it may end the step of a later action.
    """
    fired = bus.partitions[0] > bus.image_level
    bus.images = bus.images + fired.to(torch.float64)
    bus.image_level = torch.where(fired, DISARMED, bus.image_level)
    bus.stop = bus.stop | fired if bus.has("stop") else fired


IMAGE_EVENT = Component(
    slot="image_event",
    update=notice_image,
    stops=True,
    state=(
        Field("image_level", 1, "bit", "level that an image must exceed", exact=True, limit=DISARMED),
        Field("images", 1, "-", "images taken since reset", exact=True),
    ),
    initial=lambda args: {
        "image_level": torch.full((1,), DISARMED, dtype=torch.float64),
        "images": torch.zeros(1, dtype=torch.float64),
    },
)

NO_IMAGE_EVENT = Component(slot="image_event")
"""Nothing in the slot: for models whose data are no images."""
