"""Observations of bsk_rl."""

from bsk_torch.bsk_rl.obs.observations import (
    Eclipse,
    Observation,
    OpportunityProperties,
    ResourceRewardWeight,
    SatProperties,
    Time,
)
from bsk_torch.bsk_rl.obs.relative_observations import RelativeProperties
from bsk_torch.bsk_rl.obs.rso_imaging import RSOTargetProperties
from bsk_torch.bsk_rl.older import renamed_in

__all__ = [
    "Eclipse",
    "Observation",
    "OpportunityProperties",
    "RSOTargetProperties",
    "RelativeProperties",
    "ResourceRewardWeight",
    "SatProperties",
    "Time",
]

__getattr__ = renamed_in(__name__)
