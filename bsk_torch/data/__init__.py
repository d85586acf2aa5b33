"""Data and reward: what satellites have collected, and what it is worth."""

from bsk_torch.data.base import GlobalReward, NoReward
from bsk_torch.data.scanning import ScanningTimeReward

__all__ = ["GlobalReward", "NoReward", "ScanningTimeReward"]
