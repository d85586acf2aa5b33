"""Environments: batched satellite tasking as TorchRL environments."""

from bsk_torch.env.tasking import SatelliteTasking

__all__ = ["SatelliteTasking"]
