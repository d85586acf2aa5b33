"""Actions: entries of a satellite's ``action_spec``, either discrete commands or one continuous action."""

from __future__ import annotations

from bsk_torch.act.base import Action, ActionTable, Decision
from bsk_torch.act.continuous import AttitudeSetpoint, ContinuousAction, HybridAction
from bsk_torch.act.discrete import Broadcast, Charge, Desat, DiscreteFSWAction, Downlink, Drift, NadirPoint, Scan
from bsk_torch.act.image import Image, image_target
from bsk_torch.act.image_request import ImageRequest
from bsk_torch.act.image_strip import HybridImageStrip, ImageStrip
from bsk_torch.act.masks import allow_only, forbid
from bsk_torch.act.thrust import ImpulsiveThrust, ImpulsiveThrustHill
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
    "HillWaypoint",
    "HybridAction",
    "HybridImageStrip",
    "Image",
    "ImageRequest",
    "ImageStrip",
    "ImpulsiveThrust",
    "ImpulsiveThrustHill",
    "NadirPoint",
    "Scan",
    "allow_only",
    "forbid",
    "image_target",
]
