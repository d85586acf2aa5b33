"""Views of the environments for other libraries: the same simulation behind their interfaces."""

from bsk_torch.wrappers.general import GymJointEnv
from bsk_torch.wrappers.gymnasium import GymEnv, GymVectorEnv
from bsk_torch.wrappers.pettingzoo import PettingZooEnv

__all__ = ["GymEnv", "GymJointEnv", "GymVectorEnv", "PettingZooEnv"]
