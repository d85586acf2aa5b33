"""Observations: entries of a satellite's ``observation_spec``."""

from typing import TYPE_CHECKING

from bsk_torch.obs.base import Observation
from bsk_torch.obs.noisy import Noisy
from bsk_torch.obs.opportunities import OpportunityProperties
from bsk_torch.obs.relative_observations import RelativeProperties
from bsk_torch.obs.resources import ResourceRewardWeight
from bsk_torch.obs.satellite import Eclipse, SatProperties, Time

__all__ = [
    "Eclipse",
    "Noisy",
    "Observation",
    "OpportunityProperties",
    "RelativeProperties",
    "ResourceRewardWeight",
    "SatProperties",
    "Time",
]

_LACKING = {
    "RSOTargetProperties": "satellites as targets, which are not simulated yet; obs.OpportunityProperties observes places on the "
    "ground",
}
"""Observations of bsk_rl not supported yet."""

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Raise an error for an observation of bsk_rl not supported yet."""
        if name in _LACKING:
            raise AttributeError(f"obs.{name} of bsk_rl is not part of bsk_torch yet: {_LACKING[name]}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
