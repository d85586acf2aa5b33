"""Reward for requests that have been served."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.data.images import UniqueImageReward
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.requests import Requests
from bsk_torch.sim.places.requested import RELEASE

COMPLETED = "request_completed"  # memory of the time at which each request was served, s; -1 before


class RequestReward(UniqueImageReward):
    """Reward for the first image of every request, taken at the end of its look; its weight at that time.

    Images are taken within the times and limits of requests only, see :class:`bsk_torch.sim.fsw.LookFSWModel`. Those of canceled
    requests earn nothing.
    """

    scenario: Requests
    needs = ("fitting", "scene.Requests")

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        if not isinstance(scenario, Requests):
            raise ValueError(f"RequestReward needs scene.Requests; the scenario is {type(scenario).__name__}")
        super().link(scenario, fleet)
        self.memory.declare(COMPLETED, -1.0, scenario.most_targets, low=-1.0)

    @property
    def completed(self) -> Tensor:
        """Time at which each request was served, [N, T] s since reset; -1 for those that have not been."""
        return self.memory[COMPLETED]

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        wanted = taken & (self.scenario.drawn("target_exists").gather(1, target) > 0.5)
        before = self.imaged
        reward = super().value(target, wanted)
        new = self.imaged & ~before
        self.memory[COMPLETED] = torch.where(new, self.fleet.sim_time.unsqueeze(1), self.completed)
        return reward

    @override
    def measures(self) -> dict[str, Tensor]:
        """Return the measures of the current episodes, [N] float64 each, of requests that exist or have been served.

        ``CR`` is the part of requests served, ``WCR`` that of their weights, and ``TAT`` the mean time from release to service, s
        (NaN if none has been served).
        """
        done = self.completed >= 0.0
        counted = (self.scenario.drawn("target_exists") > 0.5) | done
        weight = self.scenario.drawn("target_priority")
        number, total = counted.sum(1).double(), (weight * counted).sum(1)
        return {
            "CR": done.sum(1) / number,
            "WCR": (weight * done).sum(1) / total,
            "TAT": ((self.completed - self.scenario.drawn(RELEASE)) * done).sum(1) / done.sum(1),
        }
