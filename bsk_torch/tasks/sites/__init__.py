"""Sites of several images, which pay when they are complete, under weather with a forecast."""

from bsk_torch.tasks.sites.reward import CompletionReward
from bsk_torch.tasks.sites.scene import Sites
from bsk_torch.tasks.sites.tips import ConfirmationReward, Tips

__all__ = ["CompletionReward", "ConfirmationReward", "Sites", "Tips"]
