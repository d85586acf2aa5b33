"""Nadir scanning."""

from __future__ import annotations

from bsk_torch._checks import number
from bsk_torch.scene.base import Scenario


class UniformNadirScanning(Scenario):
    """Recorded data have the same value everywhere: ``value_per_second`` for every second of recording."""

    def __init__(self, value_per_second: float = 1.0) -> None:
        """Set the value of one second of recorded data; ValueError unless it is a finite number."""
        self.value_per_second = number("value_per_second", value_per_second)
