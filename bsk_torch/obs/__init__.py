"""Observations: what an agent sees of its satellite and of what is asked of it."""

from bsk_torch.obs.base import Observation
from bsk_torch.obs.opportunities import OpportunityProperties
from bsk_torch.obs.satellite import Eclipse, SatProperties, Time

__all__ = ["Eclipse", "Observation", "OpportunityProperties", "SatProperties", "Time"]
