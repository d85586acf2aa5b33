"""Flight-software models of bsk_rl, which are those of the core."""

from bsk_torch.bsk_rl.sim.fsw.rso_imaging import SpaceToSpaceImagingFSWModel
from bsk_torch.sim.fsw import (
    BasicFSWModel,
    ContinuousImagingFSWModel,
    FSWModel,
    ImagingFSWModel,
    MagicOrbitalManeuverFSWModel,
    SteeringFSWModel,
    SteeringImagerFSWModel,
    Task,
    action,
)
from bsk_torch.tasks.inspection import RSOInspectorFSWModel

FSWModelABC = FSWModel

__all__ = [
    "BasicFSWModel",
    "ContinuousImagingFSWModel",
    "FSWModel",
    "FSWModelABC",
    "ImagingFSWModel",
    "MagicOrbitalManeuverFSWModel",
    "RSOInspectorFSWModel",
    "SpaceToSpaceImagingFSWModel",
    "SteeringFSWModel",
    "SteeringImagerFSWModel",
    "Task",
    "action",
]
