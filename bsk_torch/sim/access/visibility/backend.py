"""Choice between the two implementations of the geometry of visibility, tensor operations and kernels."""

from __future__ import annotations

import torch

from bsk_torch.sim.access.visibility.interface import Visibility
from bsk_torch.sim.access.visibility.kernels import KernelVisibility
from bsk_torch.sim.access.visibility.tensors import TensorVisibility


def make_visibility(backend: str, device: torch.device) -> Visibility:
    """Return the implementation for a back end: kernels for ``"compiled"`` on the CPU, else tensor operations."""
    return KernelVisibility() if backend == "compiled" and device.type == "cpu" else TensorVisibility()
