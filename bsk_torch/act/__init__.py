"""Actions: entries of a satellite's ``action_spec``, either discrete commands or one continuous action."""

from __future__ import annotations

from bsk_torch.act.base import Action, ActionTable, Decision
from bsk_torch.act.broadcast import Broadcast
from bsk_torch.act.continuous import ContinuousAction, HybridAction
from bsk_torch.act.discrete import Charge, Desat, DiscreteFSWAction, Downlink, Drift, NadirPoint, Scan
from bsk_torch.act.held_thrust import HeldThrust
from bsk_torch.act.image import Image, image_target
from bsk_torch.act.image_strip import HybridImageStrip, ImageStrip
from bsk_torch.act.masks import allow_only, forbid
from bsk_torch.act.point_at_task import PointAtTask
from bsk_torch.act.rso_imaging import ImageRSO
from bsk_torch.act.setpoint import AttitudeSetpoint
from bsk_torch.act.thrust import ImpulsiveThrust, ImpulsiveThrustHill
from bsk_torch.act.transmit_catalog import TransmitCatalog
from bsk_torch.act.waypoint import HillWaypoint

__all__ = [
    "Action",
    "ActionTable",
    "AttitudeSetpoint",
    "Broadcast",
    "Charge",
    "ContinuousAction",
    "Decision",
    "Desat",
    "DiscreteFSWAction",
    "Downlink",
    "Drift",
    "HeldThrust",
    "HillWaypoint",
    "HybridAction",
    "HybridImageStrip",
    "Image",
    "ImageRSO",
    "ImageStrip",
    "ImpulsiveThrust",
    "ImpulsiveThrustHill",
    "NadirPoint",
    "PointAtTask",
    "Scan",
    "TransmitCatalog",
    "allow_only",
    "forbid",
    "image_target",
]
