"""Observations of bsk_rl."""

from bsk_torch.bsk_rl.later import not_yet
from bsk_torch.bsk_rl.obs.observations import (
    Eclipse,
    Observation,
    OpportunityProperties,
    ResourceRewardWeight,
    SatProperties,
    Time,
)
from bsk_torch.bsk_rl.obs.relative_observations import RelativeProperties

__all__ = [
    "Eclipse",
    "Observation",
    "OpportunityProperties",
    "RelativeProperties",
    "ResourceRewardWeight",
    "SatProperties",
    "Time",
]

__getattr__ = not_yet(__name__)
