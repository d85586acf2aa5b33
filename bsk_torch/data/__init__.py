"""Rewarders, which compute rewards for the data collected by satellites."""

from bsk_torch.data.base import GlobalReward, NoReward
from bsk_torch.data.composed import ComposedReward
from bsk_torch.data.images import CloudFreeImageReward, FootprintImageReward, ImageReward, StripImageReward, UniqueImageReward
from bsk_torch.data.mixed import MixedReward
from bsk_torch.data.operations import OperationsPenalty, TimePenalty
from bsk_torch.data.requests import RequestReward
from bsk_torch.data.resources import ResourceReward
from bsk_torch.data.scanning import ScanningTimeReward

__all__ = [
    "CloudFreeImageReward",
    "ComposedReward",
    "FootprintImageReward",
    "GlobalReward",
    "ImageReward",
    "MixedReward",
    "NoReward",
    "OperationsPenalty",
    "RequestReward",
    "ResourceReward",
    "ScanningTimeReward",
    "StripImageReward",
    "TimePenalty",
    "UniqueImageReward",
]
