"""Flight-software models of bsk_rl, which are those of the core."""

from bsk_torch.bsk_rl.sim.fsw.rso_imaging import SpaceToSpaceImagingFSWModel
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
    "SpaceToSpaceImagingFSWModel",
    "SteeringFSWModel",
    "SteeringImagerFSWModel",
    "Task",
    "action",
]
