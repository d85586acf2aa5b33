"""Rewards for images of targets."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.data.base import GlobalReward, Log

if TYPE_CHECKING:
    from bsk_torch.scene.base import Scenario
    from bsk_torch.sim.fleet import Fleet


class ImageReward(GlobalReward):
    """Base of rewards for images: finds out which target each satellite has imaged, and hides targets that need none any more.

    An image is noticed by the growth of the store over a step and belongs to the target that was chosen last, so a step counts
    for one image of a satellite at most, as in bsk_rl.
    """

    def link(self, scenario: Scenario, fleet: Fleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError without targets, or without a satellite that images them."""
        super().link(scenario, fleet)
        if not hasattr(scenario, "most_targets"):
            raise ValueError(
                f"{type(self).__name__} needs a scenario with targets, such as scene.UniformTargets; the scenario is "
                f"{type(scenario).__name__}"
            )
        imagers = {k: part for k, part in enumerate(fleet.parts) if hasattr(part, "latest_target")}
        if not imagers:
            are = ", ".join(f"{part.name} is a {type(part).__name__}" for part in fleet.parts)
            raise ValueError(
                f"{type(self).__name__} needs a satellite that images targets, such as a sats.ImagingSatellite; {are}"
            )
        self.memory = fleet.memory
        for k, part in imagers.items():
            part.add_access_filter(functools.partial(self._selectable_by, k), part.target_types)  # type: ignore[attr-defined]

    def _selectable_by(self, part: int) -> Tensor:
        """Targets that the satellites of one type may still choose, [N * count, T]."""
        return self.fleet.rows_of(part, self.selectable())

    def selectable(self) -> Tensor:
        """Targets that each satellite may still choose, [N, S, T]."""
        raise NotImplementedError(f"{type(self).__name__} must implement selectable()")

    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """Reward [N, S] for images of ``target`` [N, S] where one was ``taken`` [N, S], and remember them."""
        raise NotImplementedError(f"{type(self).__name__} must implement value(target, taken)")

    def read_log(self) -> Log:
        """Data in the images' partition, bit."""
        return {"partition": self.fleet.each(lambda satellite: satellite.dynamics.partition_levels[:, 0])}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        target = self.fleet.each(lambda satellite: satellite.latest_target, missing=-1)  # type: ignore[attr-defined]
        taken = (after["partition"] > before["partition"]) & (target >= 0)
        return self.value(target.clamp(min=0), taken)

    def of(self, table: Tensor, target: Tensor) -> Tensor:
        """Entries [N, S] of a table [N, T] for one target of each satellite, [N, S]."""
        return table.gather(1, target)

    def taken_by_any(self, target: Tensor, taken: Tensor, targets: int) -> Tensor:
        """Which of the ``targets`` T any satellite has taken an image of, [N, T]."""
        none = torch.zeros(len(target), targets + 1, dtype=torch.bool, device=target.device)
        return none.scatter(1, torch.where(taken, target, targets), True)[:, :targets]


def identity(priority: Tensor) -> Tensor:
    """The priority itself."""
    return priority


class UniqueImageReward(ImageReward):
    """Pays for the first image of every target, and hides from a satellite what has been imaged as far as it knows.

    Satellites that image a target in the same step share its reward; whoever images it later gets nothing, whether or not he
    knew. Knowledge spreads by communication (:mod:`bsk_torch.comm`).

    Attributes ``imaged`` [N, T] tells which targets have been imaged, ``known`` [N, S, T] of which each satellite knows it,
    ``duplicates`` [N, S] counts images that paid nothing.
    """

    def __init__(self, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """``reward_fn`` maps priorities [N, S] to rewards [N, S]."""
        if not callable(reward_fn):
            raise TypeError(f"reward_fn={reward_fn!r} must be a function of priorities")
        self.reward_fn = reward_fn

    def link(self, scenario: Scenario, fleet: Fleet) -> None:
        """See :meth:`ImageReward.link`."""
        super().link(scenario, fleet)
        self.memory.add("imaged_targets", 0, self.scenario.most_targets, dtype=torch.bool)
        if fleet.size > 1:  # a single satellite knows what it has done
            self.memory.add("known_images", 0, fleet.size, self.scenario.most_targets, dtype=torch.bool)
        self.memory.add("duplicates", 0, fleet.size)

    @property
    def imaged(self) -> Tensor:
        """Which targets have been imaged, [N, T]."""
        return self.memory["imaged_targets"]

    @property
    def known(self) -> Tensor:
        """Of which targets each satellite knows that they have been imaged, [N, S, T]."""
        return self.memory["known_images"] if self.fleet.size > 1 else self.imaged.unsqueeze(1)

    def counts(self) -> dict[str, Tensor]:
        """See :meth:`GlobalReward.counts`."""
        return {"duplicates": self.memory["duplicates"]}

    def selectable(self) -> Tensor:
        """See :meth:`ImageReward.selectable`."""
        return self.scenario.available.unsqueeze(1) & ~self.known

    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """See :meth:`ImageReward.value`."""
        again = taken & self.of(self.imaged, target)
        pays = taken & ~again
        reward = self.reward_fn(self.of(self.scenario.priority, target))
        if self.fleet.size > 1:
            reward = reward / self.sharers(target, pays)
            slot = target.unsqueeze(-1)
            known = self.known
            self.memory["known_images"] = known.scatter(2, slot, known.gather(2, slot) | taken.unsqueeze(-1))
        self.memory["imaged_targets"] = self.imaged | self.taken_by_any(target, pays, self.scenario.most_targets)
        self.memory["duplicates"] = self.memory["duplicates"] + again
        return torch.where(pays, reward, torch.zeros_like(reward))

    @staticmethod
    def sharers(target: Tensor, pays: Tensor) -> Tensor:
        """How many satellites have taken the image of each one's target in this step, at least 1, [N, S]."""
        same = (target.unsqueeze(2) == target.unsqueeze(1)) & pays.unsqueeze(1)
        return same.sum(2).clamp(min=1)

    def share(self, links: Tensor) -> None:
        """See :meth:`GlobalReward.share`; knowledge goes one hop for each link."""
        if self.fleet.size == 1:
            return
        known = self.known
        disputed = known.any(1) & ~known.all(1)
        most = int(disputed.sum(1).max())
        if not most:
            return
        # few targets are known to some and not to all: the product is taken over these only
        slot = torch.where(disputed, torch.cumsum(disputed, 1) - 1, most)
        number = torch.arange(known.shape[2], device=known.device).expand_as(slot)
        column = torch.zeros_like(number[:, : most + 1]).scatter(1, slot, number)[:, :most].unsqueeze(1)
        column = column.expand(-1, known.shape[1], -1)
        some = known.gather(2, column)
        told = torch.bmm(links.mT.float(), some.float()) > 0.5
        self.memory["known_images"] = known.scatter(2, column, some | told)
