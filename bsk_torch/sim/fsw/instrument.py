"""Commands to the instrument: Basilisk's scanningInstrumentController and simpleInstrumentController."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field


def permission(bus: Bus) -> Tensor:
    """Return 1 where the instrument may record, else 0.

    It may where ``|sigma_BR| <= attitude tolerance`` and ``|omega_BR| <= rate tolerance``, with the errors of location pointing,
    which is the law that is on, the target is accessible and the controller is on. In a slew along a reference, the errors are
    those of pointing at the target.
    """
    error = bus.look_error if bus.has("look_error") else bus.error
    points = (error.sigma_BR.norm() <= bus.attitude_tolerance) & (error.omega_BR_B.norm() <= bus.rate_tolerance)
    return torch.where(points, bus.controller_on * bus.target_access, torch.zeros_like(bus.instrument_command))


def command_scan(bus: Bus) -> None:
    """Record while it is permitted. Outside of location pointing the last command stays, and a later scan finds it."""
    records = permission(bus)
    bus.instrument_command = torch.where(bus.location_on > 0.0, records, bus.instrument_command)


def command_image(bus: Bus) -> None:
    """Record for one tick, the first permitted one; ``image_taken`` prevents others until a new task.

    Outside of location pointing the last command stays: if it is that of an image, the instrument takes one in every tick.
    """
    on = bus.location_on > 0.0
    takes = permission(bus) * (1.0 - bus.image_taken)
    bus.instrument_command = torch.where(on, takes, bus.instrument_command)
    bus.image_taken = torch.where(on & (takes > 0.0), torch.ones_like(takes), bus.image_taken)


SCANNING_CONTROLLER = Component(
    slot="instrument_controller",
    update=command_scan,
    args=(
        Arg("imageAttErrorRequirement", 0.01, "-", "largest attitude error, MRP norm, while recording", low=0.0, endless=True),
        Arg("imageRateErrorRequirement", None, "rad/s", "largest rate error while recording", low=0.0, missing=float("inf")),
    ),
    state=(Field("instrument_command", 1, "-", "command to the instrument, 0 or 1"),),
    params=(Field("attitude_tolerance"), Field("rate_tolerance", 1, "rad/s")),
    prepare=lambda args: {
        "attitude_tolerance": args["imageAttErrorRequirement"],
        "rate_tolerance": args["imageRateErrorRequirement"],
    },
    flags=("controller_on",),
)

IMAGE_RESET = {"image_taken": 0.0}  # what a mode resets in which an image is to be taken

IMAGE_CONTROLLER = dataclasses.replace(
    SCANNING_CONTROLLER,
    update=command_image,
    state=(*SCANNING_CONTROLLER.state, Field("image_taken", 1, "-", "1 after the image of a task, else 0")),
)
