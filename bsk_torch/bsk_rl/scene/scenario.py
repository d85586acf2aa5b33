"""Base of scenarios, and nadir scanning; counterpart of ``bsk_rl.scene.scenario``."""

from __future__ import annotations

from abc import ABC
from typing import TYPE_CHECKING

from bsk_torch.bsk_rl.utils.functional import Resetable

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


class Scenario(ABC, Resetable):
    """Base of scenarios; see :class:`~bsk_torch.bsk_rl.utils.functional.Resetable` for the hooks of resets.

    Attributes:
        satellites: Satellites of the environment.
        utc_init: Epoch of the episode, set before :meth:`reset_pre_sim_init`.
    """

    satellites: list[Satellite]
    utc_init: str

    def link_satellites(self, satellites: list[Satellite]) -> None:
        """Keep the satellites of the environment."""
        self.satellites = satellites

    def validate_satellite_names(self, satellites: list[Satellite]) -> None:
        """Raise ValueError for satellites whose names, as the user gave them, do not fit; called before they are renamed."""

    def after_step(self, sim_time: float) -> None:
        """Change the scenario after the reward of a step, before satellites communicate and observe; time since reset is in s."""


class UniformNadirScanning(Scenario):
    """Data has the same value everywhere on the ground; see :class:`~bsk_torch.bsk_rl.data.ScanningTimeReward`."""

    def __init__(self, value_per_second: float = 1.0) -> None:
        """Value each second of scanning at ``value_per_second``."""
        self.value_per_second = value_per_second
