"""Scenarios: what is asked of the satellites."""

from bsk_torch.scene.base import Scenario
from bsk_torch.scene.scanning import UniformNadirScanning

__all__ = ["Scenario", "UniformNadirScanning"]
