"""When the instrument is told to record."""

from __future__ import annotations

import torch

from bsk_torch.sim.component import Arg, Bus, Component, Field


def command_scan(bus: Bus) -> None:
    """Record while the instrument's attitude and rate errors are small and the target is within range.

    The errors are those of location pointing itself, which is the law that is on. Outside of that task the last command stays,
    and a later scan finds it.
    """
    error = bus.error
    points = (error.sigma_BR.norm() <= bus.attitude_tolerance) & (error.omega_BR.norm() <= bus.rate_tolerance)
    records = torch.where(points, bus.controller_on * bus.target_access, torch.zeros_like(bus.instrument_command))
    bus.instrument_command = torch.where(bus.location_on > 0.0, records, bus.instrument_command)


SCANNING_CONTROLLER = Component(
    slot="instrument_controller",
    order=305,
    update=command_scan,
    args=(
        Arg("imageAttErrorRequirement", 0.01, "-", "largest attitude error, MRP norm, while recording", low=0.0),
        Arg("imageRateErrorRequirement", None, "rad/s", "largest rate error while recording", missing=float("inf")),
    ),
    state=(Field("instrument_command", 1, "-", "command to the instrument, 0 or 1"),),
    params=(Field("attitude_tolerance"), Field("rate_tolerance", 1, "rad/s")),
    initial=lambda args: {"instrument_command": torch.zeros(1).double()},
    prepare=lambda args: {
        "attitude_tolerance": args["imageAttErrorRequirement"],
        "rate_tolerance": args["imageRateErrorRequirement"],
    },
)
