"""Environments: batched satellite tasking as TorchRL environments."""

from bsk_torch.env.action_forms import NO_ACTION
from bsk_torch.env.base import Tasking
from bsk_torch.env.constellation import ConstellationTasking, GeneralSatelliteTasking
from bsk_torch.env.tasking import SatelliteTasking

__all__ = ["NO_ACTION", "ConstellationTasking", "GeneralSatelliteTasking", "SatelliteTasking", "Tasking"]
