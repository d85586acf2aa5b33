"""Communication between satellites after a step; counterpart of ``bsk_rl.comm``."""

from bsk_torch.bsk_rl.comm.communication import (
    BroadcastCommunication,
    CommunicationMethod,
    FreeCommunication,
    LOSCommunication,
    LOSMultiCommunication,
    MultiDegreeCommunication,
    NoCommunication,
)
from bsk_torch.bsk_rl.older import renamed_in

__all__ = [
    "BroadcastCommunication",
    "CommunicationMethod",
    "FreeCommunication",
    "LOSCommunication",
    "LOSMultiCommunication",
    "MultiDegreeCommunication",
    "NoCommunication",
]

__getattr__ = renamed_in(__name__)
