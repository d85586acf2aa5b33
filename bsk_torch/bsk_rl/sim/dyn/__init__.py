"""Dynamics models of bsk_rl, which are those of the core."""

from bsk_torch.bsk_rl.later import not_yet
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
    RSODynModel,
    RSOInspectorDynModel,
)

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
]

__getattr__ = not_yet(__name__)
