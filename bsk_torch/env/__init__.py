"""Environments: batched satellite tasking as TorchRL environments.

They are imported when they are first read (PEP 562): ``bsk_torch.bsk_rl`` builds simulations without TorchRL.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from bsk_torch.env.no_action import NO_ACTION

if TYPE_CHECKING:
    from bsk_torch.env.base import Tasking
    from bsk_torch.env.constellation import ConstellationTasking, GeneralSatelliteTasking
    from bsk_torch.env.tasking import SatelliteTasking

__all__ = ["NO_ACTION", "ConstellationTasking", "GeneralSatelliteTasking", "SatelliteTasking", "Tasking"]

_HOMES = {
    "ConstellationTasking": "constellation",
    "GeneralSatelliteTasking": "constellation",
    "SatelliteTasking": "tasking",
    "Tasking": "base",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    return value
