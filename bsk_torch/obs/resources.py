"""Observation of the weights of resource rewards."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.obs.base import Observation
from bsk_torch.obs.entries import parse_norm, scaled


class ResourceRewardWeight(Observation):
    """Weights of all :class:`bsk_torch.data.ResourceReward` of the environment in their order, divided by ``norm``; [N, K]."""

    def __init__(self, name: str = "resource_reward_weight", norm: object = 1.0) -> None:
        """Observe weights; ``norm`` is a number, or one for each weight."""
        super().__init__(name)
        self.norm = parse_norm(norm, "obs.ResourceRewardWeight: norm")

    def get_obs(self) -> Tensor:
        """See :meth:`Observation.get_obs`; ValueError without a resource reward, or for a wrong number of norms."""
        weights = getattr(self.satellite.rewarder, "resource_weights", ())
        if not weights:
            raise ValueError(
                f"{self.name!r} observes weights of data.ResourceReward, which the rewarder, a "
                f"{type(self.satellite.rewarder).__name__}, does not have"
            )
        if isinstance(self.norm, Tensor) and len(self.norm) != len(weights):
            raise ValueError(f"{self.name!r} has {len(self.norm)} norms for {len(weights)} weights; there must be equally many")
        return scaled(self.simulator.of_env(torch.stack(weights, -1)), self.norm)
