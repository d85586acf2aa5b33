"""Dynamics: the parts of a spacecraft and the models that compose them."""

from bsk_torch.sim.dyn.effectors.thrusters import THRUSTER_TYPES, Thruster
from bsk_torch.sim.dyn.effectors.torque_bars import TorqueBar
from bsk_torch.sim.dyn.effectors.wheel_types import WHEEL_TYPES, Wheel, WheelType, pyramid
from bsk_torch.sim.dyn.forces.drag import add_force
from bsk_torch.sim.dyn.forces.facets import Facet, box_facets
from bsk_torch.sim.dyn.models import (
    AtmosphericDragDynModel,
    BasicDynamicsModel,
    ContinuousImagingDynModel,
    DisturbanceTorqueDynModel,
    DynamicsModel,
    EclipseDynModel,
    FullFeaturedDynModel,
    GravityGradientDynModel,
    GroundStationDynModel,
    ImagingDynModel,
    LOSCommDynModel,
    NavigationErrorsDynModel,
    SolarPressureDynModel,
    StripImagingDynModel,
    TorqueBarsDynModel,
)
from bsk_torch.sim.dyn.navigation import navigation_numbers
from bsk_torch.sim.dyn.power.panels import Panel, best_direction
from bsk_torch.sim.dyn.relative_motion import ConjunctionDynModel, MaxRangeDynModel
from bsk_torch.sim.instruments import Instrument
from bsk_torch.sim.readout.model import aliveness_checker
from bsk_torch.sim.readout.observables import Now, observable, vital

__all__ = [
    "THRUSTER_TYPES",
    "WHEEL_TYPES",
    "AtmosphericDragDynModel",
    "BasicDynamicsModel",
    "ConjunctionDynModel",
    "ContinuousImagingDynModel",
    "DisturbanceTorqueDynModel",
    "DynamicsModel",
    "EclipseDynModel",
    "Facet",
    "FullFeaturedDynModel",
    "GravityGradientDynModel",
    "GroundStationDynModel",
    "ImagingDynModel",
    "Instrument",
    "LOSCommDynModel",
    "MaxRangeDynModel",
    "NavigationErrorsDynModel",
    "Now",
    "Panel",
    "SolarPressureDynModel",
    "StripImagingDynModel",
    "Thruster",
    "TorqueBar",
    "TorqueBarsDynModel",
    "Wheel",
    "WheelType",
    "add_force",
    "aliveness_checker",
    "best_direction",
    "box_facets",
    "navigation_numbers",
    "observable",
    "pyramid",
    "vital",
]
