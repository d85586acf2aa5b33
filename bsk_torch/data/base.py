"""Base of all rewarders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.scene.base import Scenario
    from bsk_torch.sim.fleet import Fleet

Log = dict[str, Tensor]
"""What a rewarder reads off the satellites at a decision boundary, [N, S, ...] each."""


class GlobalReward:
    """Compares what the satellites' logs say before and after a step, and says what the difference is worth.

    N is the number of episodes, S that of satellites in each; :meth:`bsk_torch.sim.fleet.Fleet.each` reads a property of all.
    """

    scenario: Any
    fleet: Fleet

    def link(self, scenario: Scenario, fleet: Fleet) -> None:
        """Called once when the environment is built; raises where scenario or satellites do not fit."""
        self.scenario, self.fleet = scenario, fleet

    def read_log(self) -> Log:
        """State of the logs at a decision boundary."""
        return {}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """Reward of the step between two logs, [N, S] float64."""
        raise NotImplementedError(f"{type(self).__name__} must implement calculate_reward(before, after)")

    def share(self, links: Tensor) -> None:
        """Spread what satellites know of the data: ``links`` [N, S, S] is true where one (second) tells another (third)."""

    def counts(self) -> dict[str, Tensor]:
        """What the rewarder counts in each episode, [N, S] each, by name."""
        return {}

    def is_terminated(self) -> Tensor:
        """Satellites whose episode the rewarder ends, [N, S]."""
        return torch.zeros_like(self.fleet.inert)

    def is_truncated(self) -> Tensor:
        """Satellites whose episode the rewarder cuts, [N, S]."""
        return torch.zeros_like(self.fleet.inert)


class NoReward(GlobalReward):
    """Zero for everything."""

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        return torch.zeros_like(self.fleet.inert, dtype=torch.float64)
