"""Rewarders, which score the data that satellites collect."""

from bsk_torch.data.base import GlobalReward, NoReward
from bsk_torch.data.clouds import CloudFreeImageReward
from bsk_torch.data.composed import ComposedReward
from bsk_torch.data.images import ImageReward, UniqueImageReward
from bsk_torch.data.resources import ResourceReward
from bsk_torch.data.scanning import ScanningTimeReward

__all__ = [
    "CloudFreeImageReward",
    "ComposedReward",
    "GlobalReward",
    "ImageReward",
    "NoReward",
    "ResourceReward",
    "ScanningTimeReward",
    "UniqueImageReward",
]
