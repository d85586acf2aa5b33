"""Data that satellites collect, and rewards for it, at the place of ``bsk_rl.data``."""

from typing import NoReturn

from bsk_torch.bsk_rl.data.base import GlobalReward
from bsk_torch.bsk_rl.data.nadir_data import ScanningTimeReward
from bsk_torch.bsk_rl.data.no_data import NoReward
from bsk_torch.bsk_rl.data.resource_data import ResourceReward
from bsk_torch.bsk_rl.data.rso_inspection import RSOInspectionReward
from bsk_torch.bsk_rl.data.unique_image_data import UniqueImageReward
from bsk_torch.bsk_rl.scene.later import raise_for

__all__ = ["GlobalReward", "NoReward", "RSOInspectionReward", "ResourceReward", "ScanningTimeReward", "UniqueImageReward"]


def __getattr__(name: str) -> NoReturn:
    """Raise ImportError for names of bsk_rl that are not here yet, AttributeError for others."""
    raise_for(name, __name__)
