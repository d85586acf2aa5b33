"""Networks for continuous actions."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from bsk_torch.rl.rules.continuous import Bounds

INITIAL_SCALE = 0.5
"""Initial standard deviation of actions, before they are squashed into their bounds."""

SCALES = (0.01, 2.0)
"""Minimum and maximum standard deviation."""


class NormalParameters(nn.Module):
    """Computes means and standard deviations of normal distributions; the deviations do not depend on the observation."""

    def __init__(self, network: nn.Module, width: int) -> None:
        """Use ``network`` for the ``width`` means."""
        super().__init__()
        self.network = network
        self.log_scale = nn.Parameter(torch.full((width,), math.log(INITIAL_SCALE), dtype=torch.float32))

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return means and standard deviations, [..., A] each; float32, whatever the precision of the network."""
        loc = self.network(*inputs).float()
        low, high = map(math.log, SCALES)
        return loc, self.log_scale.clamp(low, high).exp().expand_as(loc)


def squashed(bounds: Bounds) -> dict[str, Any]:
    """Return the arguments of TorchRL's ``TanhNormal`` other than mean and deviation."""
    low, high = torch.tensor(bounds, dtype=torch.float32).unbind(-1)
    return {"low": low, "high": high}
