"""Units and orbital elements."""

from bsk_torch.bsk_rl.basilisk.utilities import macros, orbitalMotion

__all__ = ["macros", "orbitalMotion"]
