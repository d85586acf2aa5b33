"""Sites of several images, which pay when they are complete, under weather with a forecast."""

from bsk_torch.tasks.sites.reward import CompletionReward
from bsk_torch.tasks.sites.scene import Sites

__all__ = ["CompletionReward", "Sites"]
