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
