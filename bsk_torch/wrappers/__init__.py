"""Environments under the interfaces of other libraries: Gymnasium, PettingZoo and Stable-Baselines3."""

from bsk_torch.wrappers.general import GymJointEnv
from bsk_torch.wrappers.gymnasium import GymEnv, GymVectorEnv
from bsk_torch.wrappers.pettingzoo import PettingZooEnv

__all__ = ["GymEnv", "GymJointEnv", "GymVectorEnv", "PettingZooEnv"]
