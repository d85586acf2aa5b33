"""Events that end a step from within a tick: the first image of a task, and failures."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import torch
from torch import Tensor

from bsk_torch.constants import RPM
from bsk_torch.sim.component import Bus, Component, Field
from bsk_torch.vec3 import Vec3

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


FAILED = "failed"
"""Field that holds whether a satellite has failed in the episode, 1 or 0."""


def notice_empty_battery(bus: Bus) -> None:
    """Stop at the first tick of an episode at whose end the battery is empty."""
    _stop_once(bus, bus.charge <= 0.0)


def notice_failure(bus: Bus) -> None:
    """Stop at the first tick of an episode at whose end the battery is empty, or a wheel has reached its largest speed.

    These are ``battery_valid`` and ``rw_speeds_valid`` of :class:`bsk_torch.sim.dyn.BasicDynamicsModel`.
    """
    speeds, failed = bus.Omega_WB_B, bus.charge <= 0.0
    for speed in (speeds.x, speeds.y, speeds.z) if isinstance(speeds, Vec3) else speeds:
        failed = failed | (torch.abs(speed).to(torch.float64) >= bus.fatal_wheel_speed)
    _stop_once(bus, failed)


def _stop_once(bus: Bus, failed: Tensor) -> None:
    """Stop where a satellite fails that has not failed before: a dead one continues without ending steps of the others."""
    new = failed & (bus.failed < 0.5)
    bus.failed = torch.where(new, torch.ones_like(bus.failed), bus.failed)
    bus.stop = bus.stop | new if bus.has("stop") else new


def with_failure_event(parts: Iterable[Component]) -> tuple[Component, ...]:
    """Return the parts of a satellite and what ends its runs when it fails; unchanged for one without a battery."""
    parts = tuple(parts)
    fields = {field.name for part in parts for field in part.state}
    if "charge" not in fields:
        return parts
    turns = "Omega_WB_B" in fields
    return (
        *parts,
        FAILURE if turns else dataclasses.replace(FAILURE, update=notice_empty_battery, params=(), prepare=lambda args: {}),
    )


FAILURE = Component(
    slot="failure_event",
    after="battery",
    update=notice_failure,
    stops=True,
    state=(Field(FAILED, 1, "-", "1 after a failure, else 0", exact=True, limit=1.0),),
    params=(Field("fatal_wheel_speed", 1, "rad/s", exact=True),),
    initial=lambda args: {FAILED: torch.zeros(1, dtype=torch.float64)},
    prepare=lambda args: {"fatal_wheel_speed": args["maxWheelSpeed"] * RPM},
)
