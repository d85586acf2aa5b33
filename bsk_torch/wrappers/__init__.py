"""Views of the environments for other libraries: the same simulation behind their interfaces."""

from bsk_torch.wrappers.gymnasium import GymEnv, GymVectorEnv

__all__ = ["GymEnv", "GymVectorEnv"]
