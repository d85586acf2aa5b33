"""Environments: batched satellite tasking as TorchRL environments."""

from bsk_torch.env.base import Tasking
from bsk_torch.env.constellation import NO_ACTION, ConstellationTasking
from bsk_torch.env.tasking import SatelliteTasking

__all__ = ["NO_ACTION", "ConstellationTasking", "SatelliteTasking", "Tasking"]
