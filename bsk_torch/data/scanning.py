"""Reward for the time spent recording."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import function
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario, UniformNadirScanning


class ScanningTimeReward(GlobalReward):
    """Reward for the time spent recording: the growth of the data buffer over a step, divided by the instrument's data rate.

    The reward is reward_fn(max(0, level_after - level_before) / instrumentBaudRate), with levels in bit and the rate in bit/s. A
    step in which the level falls earns nothing. An instrument of rate 0 also earns nothing.
    """

    scenario: UniformNadirScanning

    def __init__(self, reward_fn: Callable[[Tensor], Tensor] | None = None) -> None:
        """Reward seconds [N, S] by ``reward_fn``; None multiplies them by the scenario's ``value_per_second``."""
        self.reward_fn = None if reward_fn is None else function("reward_fn", reward_fn, "seconds")

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError without a value per second, or without a data buffer."""
        super().link(scenario, fleet)
        if self.reward_fn is None and not hasattr(scenario, "value_per_second"):
            raise ValueError(
                f"ScanningTimeReward needs a scenario with value_per_second, such as scene.UniformNadirScanning, or a "
                f"reward_fn; the scenario is {type(scenario).__name__}"
            )
        for name in ("storage_level", "instrument_baud"):
            if not any(hasattr(type(part.dynamics), name) for part in fleet.satellites):
                models = " and ".join(type(part.dynamics).__name__ for part in fleet.satellites)
                raise ValueError(
                    f"ScanningTimeReward needs a satellite that stores data, such as one with dyn.ContinuousImagingDynModel; "
                    f"{models} has no {name}"
                )
        fleet.want("storage_level")

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; data in the buffer, bit."""
        return {"storage_level": self.fleet.each(lambda satellite: satellite.dynamics.storage_level)}

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        gained = torch.clamp(after["storage_level"] - before["storage_level"], min=0.0)
        rate = self.fleet.each(lambda satellite: satellite.dynamics.instrument_baud, missing=1.0)
        seconds = gained / torch.where(rate > 0.0, rate, torch.ones_like(rate))
        if self.reward_fn is not None:
            return self.of_channel(self.reward_fn(seconds))
        return seconds * self.scenario.value_per_second
