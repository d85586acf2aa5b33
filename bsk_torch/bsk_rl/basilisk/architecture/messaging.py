"""Payloads of messages that programs write."""

from dataclasses import dataclass


@dataclass
class PowerStorageStatusMsgPayload:
    """State of a battery: charge, capacity, W s, and net power, W."""

    storageLevel: float = 0.0
    storageCapacity: float = 0.0
    currentNetPower: float = 0.0
