"""Gymnasium's interfaces to environments of one satellite: one episode, and a vector of them."""

from bsk_torch.wrappers.gymnasium.single import GymEnv
from bsk_torch.wrappers.gymnasium.vector import GymVectorEnv

__all__ = ["GymEnv", "GymVectorEnv"]
