"""Satellites of bsk_rl."""

from bsk_torch.bsk_rl.older import renamed_in
from bsk_torch.bsk_rl.sats.access_satellite import AccessSatellite, ImagingSatellite
from bsk_torch.bsk_rl.sats.satellite import Satellite

__all__ = ["AccessSatellite", "ImagingSatellite", "Satellite"]

__getattr__ = renamed_in(__name__)
