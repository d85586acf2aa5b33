"""Environments: batched satellite tasking as TorchRL environments.

They are imported when they are first read (PEP 562): ``bsk_torch.bsk_rl`` builds simulations without TorchRL.
"""

from typing import TYPE_CHECKING

from bsk_torch.env.no_action import NO_ACTION
from bsk_torch.sim.names import lazy as _lazy

if TYPE_CHECKING:
    from bsk_torch.env.base import Tasking
    from bsk_torch.env.constellation import ConstellationTasking, GeneralSatelliteTasking
    from bsk_torch.env.tasking import SatelliteTasking

__all__ = ["NO_ACTION", "ConstellationTasking", "GeneralSatelliteTasking", "SatelliteTasking", "Tasking"]

__getattr__ = _lazy(
    __name__,
    {"base": ["Tasking"], "constellation": ["ConstellationTasking", "GeneralSatelliteTasking"], "tasking": ["SatelliteTasking"]},
)
