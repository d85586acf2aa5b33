"""Flight-software models of bsk_rl, which are those of the core."""

from bsk_torch.bsk_rl.later import not_yet
from bsk_torch.sim.fsw import (
    BasicFSWModel,
    ContinuousImagingFSWModel,
    FSWModel,
    ImagingFSWModel,
    MagicOrbitalManeuverFSWModel,
    RSOInspectorFSWModel,
    SteeringFSWModel,
    SteeringImagerFSWModel,
    Task,
    action,
)

FSWModelABC = FSWModel

__all__ = [
    "BasicFSWModel",
    "ContinuousImagingFSWModel",
    "FSWModel",
    "FSWModelABC",
    "ImagingFSWModel",
    "MagicOrbitalManeuverFSWModel",
    "RSOInspectorFSWModel",
    "SteeringFSWModel",
    "SteeringImagerFSWModel",
    "Task",
    "action",
]

__getattr__ = not_yet(__name__)
