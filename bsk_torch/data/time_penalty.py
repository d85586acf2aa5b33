"""A price of time."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.data.base import GlobalReward, Log

MOST_WEIGHT = 1e30
"""Bound of the weight, so that a sum of several rewards stays finite in float32."""


class TimePenalty(GlobalReward):
    """Pays every satellite ``-weight`` times the duration of the step, s, as a branch of BSK-RL's authors does.

    Add it to other rewarders for tasks that shall be done early: ``rewarder=(data.UniqueImageReward(), data.TimePenalty(1e-4))``.
    """

    def __init__(self, weight: float = 1.0) -> None:
        """Charge ``weight`` for each second, from 0 to 1e30; ValueError for anything else."""
        self.weight = number("weight", weight, 0.0, MOST_WEIGHT)

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        price = -self.weight * self.step_duration
        return self.of_channel(price.unsqueeze(1).expand(self.fleet.shape).to(torch.float64))
