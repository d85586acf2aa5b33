"""Communication methods: which satellites share their knowledge with which others after a step."""

from bsk_torch.comm.base import CommunicationMethod, FreeCommunication, NoCommunication
from bsk_torch.comm.broadcast import BroadcastCommunication
from bsk_torch.comm.los import LOSCommunication, LOSMultiCommunication
from bsk_torch.comm.multi import MultiDegreeCommunication

__all__ = [
    "BroadcastCommunication",
    "CommunicationMethod",
    "FreeCommunication",
    "LOSCommunication",
    "LOSMultiCommunication",
    "MultiDegreeCommunication",
    "NoCommunication",
]
