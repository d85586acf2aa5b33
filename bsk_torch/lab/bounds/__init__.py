"""Upper bounds on what any policy can reach, each with its assumptions."""

from bsk_torch.lab.bounds.envelope import SUSTAINED, Envelope
from bsk_torch.lab.bounds.imaging import ImagingBound, imaging_bound
from bsk_torch.lab.bounds.scanning import ScanningBound, scanning_bound
from bsk_torch.lab.bounds.schedule import Schedule, ScheduledPolicy, milp_schedule, relaxed_schedule
from bsk_torch.lab.bounds.transitions import Transitions, carried_over, record_transitions

__all__ = [
    "SUSTAINED",
    "Envelope",
    "ImagingBound",
    "ScanningBound",
    "Schedule",
    "ScheduledPolicy",
    "Transitions",
    "carried_over",
    "imaging_bound",
    "milp_schedule",
    "record_transitions",
    "relaxed_schedule",
    "scanning_bound",
]
