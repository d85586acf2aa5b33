"""Inspection of a spacecraft: impulsive maneuvers around it, until its surface has been seen in sunlight."""

from bsk_torch.tasks.inspection.models import RSODynModel, RSOInspectorDynModel, RSOInspectorFSWModel
from bsk_torch.tasks.inspection.reward import RSOInspectionData, RSOInspectionReward
from bsk_torch.tasks.inspection.scene import RSOPoint, RSOPoints, SphericalRSO

__all__ = [
    "RSODynModel",
    "RSOInspectionData",
    "RSOInspectionReward",
    "RSOInspectorDynModel",
    "RSOInspectorFSWModel",
    "RSOPoint",
    "RSOPoints",
    "SphericalRSO",
]
