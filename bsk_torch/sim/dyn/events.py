"""Events that end a step from within a tick: the first image of a task, an empty store, and failures."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import torch
from torch import Tensor

from bsk_torch.constants import RPM
from bsk_torch.sim.component import Bus, Component, Field
from bsk_torch.vec3 import Vec3

DISARMED = 1e300  # level that no store reaches, bit; finite, so that infinities in a state are errors


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
    initial=lambda args: {"image_level": torch.full((1,), DISARMED, dtype=torch.float64)},
)

NO_IMAGE_EVENT = Component(slot="image_event")  # nothing in the slot: for models whose data are no images
LEFT_OVER = 1.0  # data up to which a store counts as empty, bit

EMPTIED, DOWNLINK_TICK = "emptied", "downlink_tick"
"""Fields with the number of downlinks that an empty store has ended, and with the tick from which on one may end."""

EMPTY_DOWNLINKS = "empty_downlinks"  # memory of satellites with the number of downlinks that began with an empty store
ENDINGS = "images", EMPTIED  # fields that count events which end actions, where a satellite has them


def notice_empty_store(bus: Bus) -> None:
    """Count a downlink and stop at the first tick from ``downlink_tick`` on in which no more than a bit is stored.

    Actions arm the event. It disarms itself, and so does every command.
    """
    fired = (bus.ticks >= bus.downlink_tick) & (bus.storage <= LEFT_OVER)
    bus.emptied = bus.emptied + fired.to(torch.float64)
    bus.downlink_tick = torch.where(fired, DISARMED, bus.downlink_tick)
    bus.stop = bus.stop | fired if bus.has("stop") else fired


EMPTY_STORE_EVENT = Component(
    slot="empty_store_event",
    after="storage",
    update=notice_empty_store,
    stops=True,
    state=(
        Field(DOWNLINK_TICK, 1, "-", "tick from which on an empty store ends the downlink", exact=True, limit=DISARMED),
        Field(EMPTIED, 1, "-", "downlinks since reset that an empty store has ended", exact=True),
    ),
    initial=lambda args: {DOWNLINK_TICK: torch.full((1,), DISARMED, dtype=torch.float64)},
    resets=((DOWNLINK_TICK, DISARMED),),
)


FAILED = "failed"  # field that holds whether a satellite has failed in the episode, 1 or 0


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
    return (*parts, FAILURE if turns else dataclasses.replace(FAILURE, update=notice_empty_battery, params=(), prepare=None))


FAILURE = Component(
    slot="failure_event",
    after="battery",
    update=notice_failure,
    stops=True,
    state=(Field(FAILED, 1, "-", "1 after a failure, else 0", exact=True, limit=1.0),),
    params=(Field("fatal_wheel_speed", 1, "rad/s", exact=True),),
    reads=("maxWheelSpeed",),
    prepare=lambda args: {"fatal_wheel_speed": args["maxWheelSpeed"] * RPM},
)
