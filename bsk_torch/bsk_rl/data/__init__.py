"""Data that satellites collect, and rewards for it; counterpart of ``bsk_rl.data``."""

from bsk_torch.bsk_rl.data.base import GlobalReward
from bsk_torch.bsk_rl.data.composition import MixedData, MixedDataStore, MixedReward
from bsk_torch.bsk_rl.data.nadir_data import ScanningTimeReward
from bsk_torch.bsk_rl.data.no_data import NoReward
from bsk_torch.bsk_rl.data.resource_data import ResourceReward
from bsk_torch.bsk_rl.data.rso_imaging import RSOImageData, RSOImageReward, RSOImageStore
from bsk_torch.bsk_rl.data.rso_inspection import RSOInspectionReward
from bsk_torch.bsk_rl.data.unique_image_data import UniqueImageReward
from bsk_torch.bsk_rl.older import renamed_in
from bsk_torch.bsk_rl.utils.rso_imaging import RSOImageRecord

__all__ = [
    "GlobalReward",
    "MixedData",
    "MixedDataStore",
    "MixedReward",
    "NoReward",
    "RSOImageData",
    "RSOImageRecord",
    "RSOImageReward",
    "RSOImageStore",
    "RSOInspectionReward",
    "ResourceReward",
    "ScanningTimeReward",
    "UniqueImageReward",
]

__getattr__ = renamed_in(__name__)
