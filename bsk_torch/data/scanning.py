"""Reward for the time spent recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.data.base import GlobalReward, Log

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite
    from bsk_torch.scene.base import Scenario


class ScanningTimeReward(GlobalReward):
    """Pays for seconds of recorded data: the growth of the store in a step over the instrument's rate.

    A step in which the store shrinks pays nothing, as in bsk_rl.
    """

    def __init__(self, reward_fn: Callable[[Tensor], Tensor] | None = None) -> None:
        """``reward_fn`` maps seconds [N] to reward [N]; None multiplies by the scenario's ``value_per_second``."""
        self.reward_fn = reward_fn

    def link(self, scenario: Scenario, satellite: Satellite) -> None:
        """See :meth:`GlobalReward.link`; ValueError without a value per second, or without a store."""
        super().link(scenario, satellite)
        if self.reward_fn is None and not hasattr(scenario, "value_per_second"):
            raise ValueError(
                f"ScanningTimeReward needs a scenario with value_per_second, such as scene.UniformNadirScanning, or a "
                f"reward_fn; the scenario is {type(scenario).__name__}"
            )
        for name in ("storage_level", "instrument_baud"):
            if not hasattr(type(satellite.dynamics), name):
                raise ValueError(
                    f"ScanningTimeReward needs a satellite that stores data, such as one with dyn.ContinuousImagingDynModel; "
                    f"{type(satellite.dynamics).__name__} has no {name}"
                )

    def read_log(self) -> Log:
        """Data in the store, bit."""
        return {"storage_level": self.satellite.dynamics.storage_level.clone()}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        gained = torch.clamp(after["storage_level"] - before["storage_level"], min=0.0)
        seconds = gained / self.satellite.dynamics.instrument_baud
        if self.reward_fn is not None:
            return self.reward_fn(seconds)
        return seconds * self.scenario.value_per_second
