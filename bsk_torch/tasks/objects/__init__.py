"""Imaging of objects in orbit: satellites and debris, imaged again and again, by one imager or by teams."""

from bsk_torch.tasks.objects.act import ImageRSO
from bsk_torch.tasks.objects.catalog import RandomRSOCatalog, RSOPriorityEvent, RSOTarget, RSOTargetCatalog
from bsk_torch.tasks.objects.comm import CatalogCommunication
from bsk_torch.tasks.objects.dyn import SpaceToSpaceImagingDynModel
from bsk_torch.tasks.objects.fsw import CatalogRadioFSWModel, SpaceToSpaceImagingFSWModel
from bsk_torch.tasks.objects.mixture import RSOMixture
from bsk_torch.tasks.objects.obs import RSOTargetProperties
from bsk_torch.tasks.objects.outlook import by_priority_per_second, by_priority_per_second_ahead
from bsk_torch.tasks.objects.radio import CatalogRadioDynModel
from bsk_torch.tasks.objects.reward import RSOImageRecord, RSOImageReward
from bsk_torch.tasks.objects.scene import Order, RSOTargets
from bsk_torch.tasks.objects.team_act import TransmitCatalog
from bsk_torch.tasks.objects.team_obs import RSOPeers, RSOTaskStatus, RSOTeamState
from bsk_torch.tasks.objects.team_reward import RSOTeamReward

__all__ = [
    "CatalogCommunication",
    "CatalogRadioDynModel",
    "CatalogRadioFSWModel",
    "ImageRSO",
    "Order",
    "RSOImageRecord",
    "RSOImageReward",
    "RSOMixture",
    "RSOPeers",
    "RSOPriorityEvent",
    "RSOTarget",
    "RSOTargetCatalog",
    "RSOTargetProperties",
    "RSOTargets",
    "RSOTaskStatus",
    "RSOTeamReward",
    "RSOTeamState",
    "RandomRSOCatalog",
    "SpaceToSpaceImagingDynModel",
    "SpaceToSpaceImagingFSWModel",
    "TransmitCatalog",
    "by_priority_per_second",
    "by_priority_per_second_ahead",
]
