"""Reward for recording areas on the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import switch
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.scene.recorded import RecordedProgress
from bsk_torch.sim.state import FINITE
from bsk_torch.tasks.areas.scene import Areas

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario

EARNED = "area_earned"
"""Field of the state with what each satellite has earned and not been paid, [N, S]."""


class AreaReward(GlobalReward):
    """Reward for cells of :class:`~bsk_torch.tasks.areas.Areas`: weight of the area times share of the cell, as far as it is due.

    Without ``revisit`` of the scenario, a cell pays once, so that an area pays its weight in all. With it, a cell pays again in
    proportion to the time since it was last recorded, up to that time. A cell that two satellites record in the same step
    pays both of them.
    """

    scenario: Areas

    def __init__(self, at_end: bool = False) -> None:
        """Pay at once, or all of it in the step that reaches the time limit, and nothing if a satellite dies before."""
        self.at_end = switch("at_end", at_end)

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        if not isinstance(scenario, Areas):
            raise ValueError(f"AreaReward needs a scenario of areas, Areas; the scenario is {type(scenario).__name__}")
        if self.at_end:
            self.memory.declare(EARNED, 0.0, fleet.size, low=0.0, high=FINITE)

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        hits = self.scenario.hits()
        earned = torch.zeros(self.fleet.shape, dtype=torch.float64, device=self.fleet.device)
        earned.index_put_((hits.env, hits.satellite), self.scenario.worth(hits), accumulate=True)
        if not self.at_end:
            return self.of_channel(earned)
        total = self.memory[EARNED] = self.memory[EARNED] + earned
        ended = self.fleet.sim_time > self.fleet.state.time_limit - 0.5 * self.fleet.h
        return self.of_channel(torch.where(ended.unsqueeze(1), total, 0.0))

    @override
    def measures(self) -> dict[str, Tensor]:
        weight = self.scenario.weight
        return {"area_covered": (weight * self.scenario.covered()).sum(1) / weight.sum(1).clamp(min=1e-300)}

    @override
    def recorded(self, env: int) -> RecordedProgress:
        return RecordedProgress(track_kind="areas", marks={"done": self.scenario.recorded_cells(env)})
