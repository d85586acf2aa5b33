"""Dynamics models of bsk_rl, which are those of the core."""

from bsk_torch.bsk_rl.sim.dyn.rso_imaging import RSOTargetDynModel, SpaceToSpaceImagingDynModel
from bsk_torch.sim.dyn import (
    AtmosphericDragDynModel,
    BasicDynamicsModel,
    ConjunctionDynModel,
    ContinuousImagingDynModel,
    DisturbanceTorqueDynModel,
    DynamicsModel,
    EclipseDynModel,
    FullFeaturedDynModel,
    GroundStationDynModel,
    ImagingDynModel,
    LOSCommDynModel,
    MaxRangeDynModel,
)
from bsk_torch.tasks.inspection import RSODynModel, RSOInspectorDynModel

DynamicsModelABC = DynamicsModel

__all__ = [
    "AtmosphericDragDynModel",
    "BasicDynamicsModel",
    "ConjunctionDynModel",
    "ContinuousImagingDynModel",
    "DisturbanceTorqueDynModel",
    "DynamicsModel",
    "DynamicsModelABC",
    "EclipseDynModel",
    "FullFeaturedDynModel",
    "GroundStationDynModel",
    "ImagingDynModel",
    "LOSCommDynModel",
    "MaxRangeDynModel",
    "RSODynModel",
    "RSOInspectorDynModel",
    "RSOTargetDynModel",
    "SpaceToSpaceImagingDynModel",
]
