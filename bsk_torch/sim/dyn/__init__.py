"""Dynamics: the parts of a spacecraft and the models that compose them."""

from bsk_torch.sim.dyn.models import (
    AtmosphericDragDynModel,
    BasicDynamicsModel,
    ContinuousImagingDynModel,
    DisturbanceTorqueDynModel,
    DynamicsModel,
    EclipseDynModel,
    GroundStationDynModel,
    ImagingDynModel,
)
from bsk_torch.sim.model import aliveness_checker

__all__ = [
    "AtmosphericDragDynModel",
    "BasicDynamicsModel",
    "ContinuousImagingDynModel",
    "DisturbanceTorqueDynModel",
    "DynamicsModel",
    "EclipseDynModel",
    "GroundStationDynModel",
    "ImagingDynModel",
    "aliveness_checker",
]
