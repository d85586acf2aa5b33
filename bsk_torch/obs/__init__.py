"""Observations: entries of a satellite's ``observation_spec``."""

from bsk_torch.obs.base import Observation
from bsk_torch.obs.opportunities import OpportunityProperties
from bsk_torch.obs.satellite import Eclipse, SatProperties, Time

__all__ = ["Eclipse", "Observation", "OpportunityProperties", "SatProperties", "Time"]
