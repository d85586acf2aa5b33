"""Log levels and messages."""

from bsk_torch.bsk_rl.basilisk.architecture import bskLogging, messaging

__all__ = ["bskLogging", "messaging"]
