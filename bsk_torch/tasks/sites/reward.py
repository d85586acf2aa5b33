"""Reward for the completion of sites."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.data.images import ImageReward
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.tasks.sites.scene import BEGUN, NOT_BEGUN, SHOT, Sites


class CompletionReward(ImageReward):
    """Reward for clear images of :class:`~bsk_torch.tasks.sites.Sites`, by what they add to the completion of their site.

    A site of value v with n images pays ``v n (gain(after / n) - gain(before / n))`` in a step in which the number of its clear
    images rises, in equal parts to all satellites, whoever took them: a site is finished by one satellite with images of another.
    Images of all satellites count together, all know of them, and an image counts once, for the first satellite if several take
    it in the same step. The counter ``cloudy`` [N, S] is the number of images that were not clear.
    """

    scenario: Sites

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        if not isinstance(scenario, Sites):
            raise ValueError(f"CompletionReward needs a scenario of sites, Sites; the scenario is {type(scenario).__name__}")
        super().link(scenario, fleet)
        self.memory.declare("cloudy", 0, fleet.size, low=0)

    @override
    def selectable(self) -> Tensor:
        return self.scenario.open.unsqueeze(1).expand(-1, self.fleet.size, -1)

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        scenario, memory, shot = self.scenario, self.memory, self.scenario.shot
        site = target // scenario.most
        fresh = taken & ~shot.gather(1, target) & ~_taken_before(target, taken)
        clear = fresh & (scenario.drawn("image_clear").gather(1, target) > 0.5)
        number = torch.zeros_like(memory[BEGUN]).scatter_add(1, site, clear.double())
        size, before = scenario.drawn("site_size"), scenario.done
        paid = size * (scenario.gain((before + number) / size) - scenario.gain(before / size)) / number.clamp(min=1.0)
        now = self.fleet.sim_time.unsqueeze(1)
        visited = torch.zeros_like(number).scatter_add(1, site, fresh.double()) > 0.0
        memory[SHOT] = shot | self.taken_by_any(target, fresh, scenario.most_targets)
        memory[BEGUN] = torch.where(visited & (memory[BEGUN] == NOT_BEGUN), now, memory[BEGUN])
        memory["cloudy"] = memory["cloudy"] + (fresh & ~clear)
        earned = torch.where(clear, scenario.priority_of(target) * paid.gather(1, site), 0.0)
        return earned.mean(1, keepdim=True).expand_as(earned)

    @override
    def counts(self) -> dict[str, Tensor]:
        return {"cloudy": self.memory["cloudy"]}

    @override
    def measures(self) -> dict[str, Tensor]:
        done, begun = self.scenario.done, self.memory[BEGUN] != NOT_BEGUN
        complete = (done == self.scenario.drawn("site_size")).double().sum(1)
        return {"sites_begun": begun.double().sum(1), "sites_complete": complete}


def _taken_before(target: Tensor, taken: Tensor) -> Tensor:
    """Return which satellites take, in the same step, an image that one before them in the order of satellites takes, [N, S]."""
    same = (target.unsqueeze(2) == target.unsqueeze(1)) & taken.unsqueeze(1)
    return same.tril(-1).any(2)
