"""Rewards for images of targets under clouds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.data.images import UniqueImageReward, identity

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.scene.base import Scenario
    from bsk_torch.scene.clouds import CloudyTargets


class CloudFreeImageReward(UniqueImageReward):
    """Reward for the first image of every target, given if the true cloud cover is at most ``threshold``.

    The true cover is not observable before the image. The target is hidden afterwards, whether or not the image was clear. The
    counter ``covered`` [N, S] is the number of cloudy images.
    """

    scenario: CloudyTargets

    def __init__(self, threshold: float = 0.7, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """Reward images of clear targets.

        Args:
            threshold: Maximum cloud cover of rewarded images, a fraction of the sky.
            reward_fn: Function from priorities [N, S] to rewards [N, S].

        Raises:
            ValueError: For a threshold outside [0, 1].
        """
        super().__init__(reward_fn)
        self.threshold = number("threshold", threshold, 0.0, 1.0, unit="of the sky")

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`UniqueImageReward.link`; ValueError without clouds."""
        if not hasattr(scenario, "cloud_cover"):
            raise ValueError(f"CloudFreeImageReward needs scene.CloudyTargets; the scenario is {type(scenario).__name__}")
        super().link(scenario, fleet)
        self.memory.declare("covered", 0, fleet.size, low=0)

    def counts(self) -> dict[str, Tensor]:
        """See :meth:`GlobalReward.counts`."""
        return super().counts() | {"covered": self.memory["covered"]}

    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """See :meth:`ImageReward.value`."""
        reward = super().value(target, taken)
        clouded = taken & (self.scenario.cloud_cover.gather(1, target) > self.threshold)
        self.memory["covered"] = self.memory["covered"] + clouded
        return torch.where(clouded, torch.zeros_like(reward), reward)
