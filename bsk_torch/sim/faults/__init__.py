"""Faults: changes of arguments of satellites during an episode; see ``docs/how_to/faults.md``."""

from bsk_torch.sim.faults.declared import Fault, Hazard, Sometimes
from bsk_torch.sim.faults.ready import (
    READY,
    battery,
    instrument,
    navigation,
    panel,
    stuck_panel,
    thruster,
    transmitter,
    wheel_friction,
    wheel_power,
    wheel_torque,
    wheel_unavailable,
)

__all__ = [
    "READY",
    "Fault",
    "Hazard",
    "Sometimes",
    "battery",
    "instrument",
    "navigation",
    "panel",
    "stuck_panel",
    "thruster",
    "transmitter",
    "wheel_friction",
    "wheel_power",
    "wheel_torque",
    "wheel_unavailable",
]
