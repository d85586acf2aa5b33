"""Rewards for strips on the ground."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.data.base import Log
from bsk_torch.data.images import UniqueImageReward, identity

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario
    from bsk_torch.scene.overlaid import StripTargets


class StripImageReward(UniqueImageReward):
    """Reward for the first recording of every strip of :class:`bsk_torch.scene.StripTargets`.

    A strip counts if the data that a satellite records in a step, divided by the data rate of its instrument, take at least the
    share ``fraction`` of the time that the strip takes, rounded down to whole ticks.
    """

    scenario: StripTargets

    def __init__(self, fraction: float = 0.9, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """Reward recordings of strips.

        Args:
            fraction: Share of a strip that must be recorded, in (0, 1].
            reward_fn: Function from priorities [N, S] to rewards [N, S].
        """
        super().__init__(reward_fn)
        self.fraction = number("fraction", fraction, 0.0, 1.0, above=True)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`UniqueImageReward.link`; ValueError without strips, or without a satellite that records them."""
        if not hasattr(scenario, "strip_seconds"):
            raise ValueError(f"StripImageReward needs scene.StripTargets; the scenario is {type(scenario).__name__}")
        super().link(scenario, fleet)
        if not any("strip_angle" in part.simulator.state.layout.fields for part in fleet.satellites):
            raise ValueError("StripImageReward needs a satellite with fsw.StripImagingFSWModel and act.ImageStrip")

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        target = self.fleet.each(lambda satellite: satellite.latest_target, missing=-1)
        rate = self.fleet.each(lambda satellite: satellite.dynamics.instrument_baud, missing=1.0)
        seconds = (after["partition"] - before["partition"]) / rate.clamp(min=1e-300)
        h = self.fleet.h
        needed = torch.floor(self.fraction * self.scenario.look_up(self.scenario.strip_seconds, target.clamp(min=0)) / h) * h
        taken = (seconds > 0.0) & (seconds >= needed - 1e-6 * h) & (target >= 0)
        return self.value(target.clamp(min=0), taken)
