"""Observations: entries of a satellite's ``observation_spec``."""

from bsk_torch.obs.base import Observation
from bsk_torch.obs.noisy import Noisy
from bsk_torch.obs.opportunities import OpportunityProperties
from bsk_torch.obs.relative_observations import RelativeProperties
from bsk_torch.obs.satellite import Eclipse, ResourceRewardWeight, SatProperties, Time

__all__ = [
    "Eclipse",
    "Noisy",
    "Observation",
    "OpportunityProperties",
    "RelativeProperties",
    "ResourceRewardWeight",
    "SatProperties",
    "Time",
]
