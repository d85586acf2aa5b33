"""Satellites: which observations, actions and models make an agent."""

from bsk_torch.sats.access import AccessSatellite
from bsk_torch.sats.imaging import ImagingSatellite
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.sats.satellite import Satellite

__all__ = ["AccessSatellite", "ImagingSatellite", "Opportunities", "Satellite"]
