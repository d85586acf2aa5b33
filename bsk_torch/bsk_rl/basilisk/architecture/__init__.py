"""Log levels and messages."""

from bsk_torch.bsk_rl.basilisk.architecture import bskLogging, messaging
from bsk_torch.bsk_rl.basilisk.unsimulated import advising

__all__ = ["bskLogging", "messaging"]

__getattr__ = advising("architecture")
