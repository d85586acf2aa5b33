"""Dynamics: the parts of a spacecraft and the models that compose them."""

from bsk_torch.sim.dyn.forces import add_force
from bsk_torch.sim.dyn.models import (
    AtmosphericDragDynModel,
    BasicDynamicsModel,
    ContinuousImagingDynModel,
    DisturbanceTorqueDynModel,
    DynamicsModel,
    EclipseDynModel,
    FullFeaturedDynModel,
    GroundStationDynModel,
    ImagingDynModel,
    LOSCommDynModel,
)
from bsk_torch.sim.readout.model import aliveness_checker
from bsk_torch.sim.readout.observables import Now, observable, vital

__all__ = [
    "AtmosphericDragDynModel",
    "BasicDynamicsModel",
    "ContinuousImagingDynModel",
    "DisturbanceTorqueDynModel",
    "DynamicsModel",
    "EclipseDynModel",
    "FullFeaturedDynModel",
    "GroundStationDynModel",
    "ImagingDynModel",
    "LOSCommDynModel",
    "Now",
    "add_force",
    "aliveness_checker",
    "observable",
    "vital",
]
