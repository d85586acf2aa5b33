"""Actions: what an agent can tell a satellite to do."""

from bsk_torch.act.base import Action, Decision
from bsk_torch.act.broadcast import Broadcast
from bsk_torch.act.discrete import Charge, Desat, DiscreteFSWAction, Downlink, Drift, NadirPoint, Scan
from bsk_torch.act.image import Image, of_target
from bsk_torch.act.masks import never, only

__all__ = [
    "Action",
    "Broadcast",
    "Charge",
    "Decision",
    "Desat",
    "DiscreteFSWAction",
    "Downlink",
    "Drift",
    "Image",
    "NadirPoint",
    "Scan",
    "never",
    "of_target",
    "only",
]
