"""Flight software: guidance, control, and the modes that actions switch between."""

from bsk_torch.sim.fsw.gains import propose_gains
from bsk_torch.sim.fsw.look import LookFSWModel
from bsk_torch.sim.fsw.models import (
    BasicFSWModel,
    ContinuousImagingFSWModel,
    EndedDownlinkFSWModel,
    FSWModel,
    ImagingFSWModel,
    MagicOrbitalManeuverFSWModel,
    MagneticUnloadingFSWModel,
    SteeringFSWModel,
    SteeringImagerFSWModel,
    Task,
    TumblingFSWModel,
    action,
)
from bsk_torch.sim.fsw.modes import Command, Mode
from bsk_torch.sim.fsw.reference_slew import ReferenceSlewFSWModel
from bsk_torch.sim.fsw.setpoint import AttitudeSetpointFSWModel, InertialHoldFSWModel
from bsk_torch.sim.fsw.strip import StripImagingFSWModel

__all__ = [
    "AttitudeSetpointFSWModel",
    "BasicFSWModel",
    "Command",
    "ContinuousImagingFSWModel",
    "EndedDownlinkFSWModel",
    "FSWModel",
    "ImagingFSWModel",
    "InertialHoldFSWModel",
    "LookFSWModel",
    "MagicOrbitalManeuverFSWModel",
    "MagneticUnloadingFSWModel",
    "Mode",
    "ReferenceSlewFSWModel",
    "SteeringFSWModel",
    "SteeringImagerFSWModel",
    "StripImagingFSWModel",
    "Task",
    "TumblingFSWModel",
    "action",
    "propose_gains",
]
