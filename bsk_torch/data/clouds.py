"""Rewards for images of targets under clouds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, switch
from bsk_torch.data.images import UniqueImageReward, identity, spread

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario
    from bsk_torch.scene.overlaid import CloudyTargets


class CloudFreeImageReward(UniqueImageReward):
    """Reward for the first image of every target, given if the true cloud cover is at most ``threshold``.

    The true cover is not observable before the image. The target is hidden afterwards, whether or not the image was clear. The
    counter ``covered`` [N, S] is the number of cloudy images.

    Clouds do not matter to satellites whose class sets ``sees_through_clouds``, such as radars. If there are any, cloudy images
    of the other satellites do not count as images: they hide the target only from satellites to which clouds matter and that
    know of them, and a radar can still earn its priority.
    """

    scenario: CloudyTargets

    def __init__(self, threshold: float = 0.7, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """Reward images of clear targets.

        Args:
            threshold: Maximum cloud cover of rewarded images, a fraction of the sky.
            reward_fn: Function from priorities [N, S] to rewards [N, S].
        """
        super().__init__(reward_fn)
        self.threshold = number("threshold", threshold, 0.0, 1.0, unit="of the sky")

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`UniqueImageReward.link`; ValueError without clouds."""
        if not hasattr(scenario, "cloud_cover"):
            raise ValueError(f"CloudFreeImageReward needs scene.CloudyTargets; the scenario is {type(scenario).__name__}")
        super().link(scenario, fleet)
        self.memory.declare("covered", 0, fleet.size, low=0)
        self._through = torch.zeros(fleet.size, dtype=torch.bool, device=fleet.device)
        for part, columns in zip(fleet.satellites, fleet.columns, strict=True):
            self._through[columns] = switch(
                f"{type(part).__name__}.sees_through_clouds", getattr(part, "sees_through_clouds", False)
            )
        self._mixed = bool(self._through.any())
        if self._mixed:
            self.memory.declare("known_clouds", 0, fleet.size, self.scenario.most_targets, dtype=torch.bool)

    @override
    def counts(self) -> dict[str, Tensor]:
        return super().counts() | {"covered": self.memory["covered"]}

    @override
    def selectable(self) -> Tensor:
        free = super().selectable()
        return free & (self._through.view(1, -1, 1) | ~self.memory["known_clouds"]) if self._mixed else free

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        clouded = taken & (self.scenario.cloud_cover.gather(1, target) > self.threshold) & ~self._through
        self.memory["covered"] = self.memory["covered"] + clouded
        if self._mixed:
            known, slot = self.memory["known_clouds"], target.unsqueeze(-1)
            self.memory["known_clouds"] = known.scatter(2, slot, known.gather(2, slot) | clouded.unsqueeze(-1))
            return super().value(target, taken & ~clouded)
        reward = super().value(target, taken)
        return torch.where(clouded, torch.zeros_like(reward), reward)

    def share(self, links: Tensor) -> None:
        """See :meth:`GlobalReward.share`; which targets are under clouds spreads like images."""
        super().share(links)
        if self._mixed and self.fleet.size > 1:
            self.memory["known_clouds"] = spread(self.memory["known_clouds"], links)
