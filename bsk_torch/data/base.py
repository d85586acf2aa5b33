"""Base of all rewarders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite
    from bsk_torch.scene.base import Scenario

Log = dict[str, Tensor]
"""What a rewarder reads off a satellite at a decision boundary, [N, ...] each."""


class GlobalReward:
    """Compares what a satellite's logs say before and after a step, and says what the difference is worth."""

    scenario: Any
    satellite: Any

    def link(self, scenario: Scenario, satellite: Satellite) -> None:
        """Called once when the environment is built; raises where scenario or satellite do not fit."""
        self.scenario, self.satellite = scenario, satellite

    def read_log(self) -> Log:
        """State of the logs at a decision boundary."""
        return {}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """Reward of the step between two logs, [N] float64."""
        raise NotImplementedError(f"{type(self).__name__} must implement calculate_reward(before, after)")

    def counts(self) -> dict[str, Tensor]:
        """What the rewarder counts in each episode, [N] each, by name."""
        return {}

    def is_terminated(self) -> Tensor:
        """Whether the rewarder ends the episode, [N]."""
        return torch.zeros_like(self.satellite.simulator.ticks, dtype=torch.bool)

    def is_truncated(self) -> Tensor:
        """Whether the rewarder cuts the episode, [N]."""
        return torch.zeros_like(self.satellite.simulator.ticks, dtype=torch.bool)


class NoReward(GlobalReward):
    """Zero for everything."""

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        return torch.zeros_like(self.satellite.simulator.sim_time)
