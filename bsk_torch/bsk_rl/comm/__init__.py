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

__all__ = [
    "BroadcastCommunication",
    "CommunicationMethod",
    "FreeCommunication",
    "LOSCommunication",
    "LOSMultiCommunication",
    "MultiDegreeCommunication",
    "NoCommunication",
]
