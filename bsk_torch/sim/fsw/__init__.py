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

__all__ = [
    "BasicFSWModel",
    "Command",
    "ContinuousImagingFSWModel",
    "FSWModel",
    "ImagingFSWModel",
    "Mode",
    "SteeringFSWModel",
    "SteeringImagerFSWModel",
]
