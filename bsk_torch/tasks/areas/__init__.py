"""Areas on the ground: satellites record them cell by cell, with the swath of their instrument."""

from bsk_torch.tasks.areas.cells import Area, cap, random_caps, read_areas, region_cells
from bsk_torch.tasks.areas.fsw import AreaScanFSWModel
from bsk_torch.tasks.areas.obs import AreaOutlook, AreaProperties
from bsk_torch.tasks.areas.reward import AreaReward
from bsk_torch.tasks.areas.scene import Areas

__all__ = [
    "Area",
    "AreaOutlook",
    "AreaProperties",
    "AreaReward",
    "AreaScanFSWModel",
    "Areas",
    "cap",
    "random_caps",
    "read_areas",
    "region_cells",
]
