"""Satellites: which observations, actions and models make an agent."""

from bsk_torch.sats.access import AccessSatellite
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.imaging import BoundImagingSatellite, ImagingSatellite
from bsk_torch.sats.opportunities import Opportunities
from bsk_torch.sats.requests import BoundRequestSatellite, RequestSatellite
from bsk_torch.sats.satellite import Satellite

__all__ = [
    "AccessSatellite",
    "BoundAccessSatellite",
    "BoundImagingSatellite",
    "BoundRequestSatellite",
    "BoundSatellite",
    "ImagingSatellite",
    "Opportunities",
    "RequestSatellite",
    "Satellite",
]
