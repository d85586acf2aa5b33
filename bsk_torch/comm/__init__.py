"""Communication methods: which satellites share their knowledge with which others after a step."""

from bsk_torch.comm.base import (
    BroadcastCommunication,
    CommunicationMethod,
    FreeCommunication,
    MultiDegreeCommunication,
    NoCommunication,
)
from bsk_torch.comm.los import LOSCommunication, LOSMultiCommunication

__all__ = [
    "BroadcastCommunication",
    "CommunicationMethod",
    "FreeCommunication",
    "LOSCommunication",
    "LOSMultiCommunication",
    "MultiDegreeCommunication",
    "NoCommunication",
]
