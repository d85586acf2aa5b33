"""Flight software: guidance, control, and the modes that actions switch between."""

from bsk_torch.sim.fsw.models import (
    BasicFSWModel,
    ContinuousImagingFSWModel,
    FSWModel,
    ImagingFSWModel,
    SteeringFSWModel,
    SteeringImagerFSWModel,
)
from bsk_torch.sim.fsw.modes import Command, Mode
from bsk_torch.sim.fsw.passive import TumblingFSWModel
from bsk_torch.sim.fsw.tasks import Task, action

__all__ = [
    "BasicFSWModel",
    "Command",
    "ContinuousImagingFSWModel",
    "FSWModel",
    "ImagingFSWModel",
    "Mode",
    "SteeringFSWModel",
    "SteeringImagerFSWModel",
    "Task",
    "TumblingFSWModel",
    "action",
]
