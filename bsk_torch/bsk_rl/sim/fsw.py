"""Flight-software models of bsk_rl: those of the core, with bsk_rl's hooks; see :mod:`bsk_torch.bsk_rl.sim.models`."""

from bsk_torch.bsk_rl.sim.models import Task, action, counterparts
from bsk_torch.sim.fsw import (
    BasicFSWModel,
    ContinuousImagingFSWModel,
    FSWModel,
    ImagingFSWModel,
    MagicOrbitalManeuverFSWModel,
    SteeringFSWModel,
    SteeringImagerFSWModel,
)
from bsk_torch.tasks.inspection import RSOInspectorFSWModel
from bsk_torch.tasks.objects import SpaceToSpaceImagingFSWModel

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

counterparts(__name__, __all__, "base", "ground_imaging", "orbital", "rso_imaging", "rso_inspection")
