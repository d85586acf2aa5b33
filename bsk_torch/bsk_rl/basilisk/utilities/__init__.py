"""Units, orbital elements and attitudes."""

from bsk_torch.bsk_rl.basilisk.unsimulated import advising
from bsk_torch.bsk_rl.basilisk.utilities import RigidBodyKinematics, macros, orbitalMotion

__all__ = ["RigidBodyKinematics", "macros", "orbitalMotion"]

__getattr__ = advising("utilities")
