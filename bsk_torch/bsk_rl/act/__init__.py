"""Actions of bsk_rl."""

from bsk_torch.bsk_rl.act.actions import Action
from bsk_torch.bsk_rl.act.continuous_actions import AttitudeSetpoint, ContinuousAction, ImpulsiveThrust, ImpulsiveThrustHill
from bsk_torch.bsk_rl.act.discrete_actions import (
    Broadcast,
    Charge,
    Desat,
    DiscreteAction,
    DiscreteFSWAction,
    Downlink,
    Drift,
    Image,
    NadirPoint,
    Scan,
)
from bsk_torch.bsk_rl.act.rso_imaging import ImageRSO
from bsk_torch.bsk_rl.older import renamed_in

__all__ = [
    "Action",
    "AttitudeSetpoint",
    "Broadcast",
    "Charge",
    "ContinuousAction",
    "Desat",
    "DiscreteAction",
    "DiscreteFSWAction",
    "Downlink",
    "Drift",
    "Image",
    "ImageRSO",
    "ImpulsiveThrust",
    "ImpulsiveThrustHill",
    "NadirPoint",
    "Scan",
]

__getattr__ = renamed_in(__name__)
