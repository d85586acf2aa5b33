"""Rewards for images of targets."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.data.base import GlobalReward, Log

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite
    from bsk_torch.scene.base import Scenario


class ImageReward(GlobalReward):
    """Base of rewards for images: finds out which target a step has imaged, and hides targets that need no image any more.

    An image is noticed by the growth of the store over a step and belongs to the target that was chosen last, so a step counts
    for one image at most, as in bsk_rl.
    """

    def link(self, scenario: Scenario, satellite: Satellite) -> None:
        """See :meth:`GlobalReward.link`; ValueError without targets, or without a satellite that images them."""
        super().link(scenario, satellite)
        if not hasattr(scenario, "most_targets"):
            raise ValueError(
                f"{type(self).__name__} needs a scenario with targets, such as scene.UniformTargets; the scenario is "
                f"{type(scenario).__name__}"
            )
        if not hasattr(satellite, "latest_target"):
            raise ValueError(
                f"{type(self).__name__} needs a satellite that images targets, such as a sats.ImagingSatellite; {satellite.name} "
                f"is a {type(satellite).__name__}"
            )
        self.memory = satellite.simulator.memory
        self.satellite.add_access_filter(self.selectable, self.satellite.target_types)

    def selectable(self) -> Tensor:
        """Targets that the satellite may still choose, [N, T]."""
        raise NotImplementedError(f"{type(self).__name__} must implement selectable()")

    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """Reward [N] for images of ``target`` [N] where one was ``taken`` [N], and remember them."""
        raise NotImplementedError(f"{type(self).__name__} must implement value(target, taken)")

    def read_log(self) -> Log:
        """Data in the images' partition, bit."""
        return {"partition": self.satellite.dynamics.partition_levels[:, 0]}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        target = self.satellite.latest_target
        taken = (after["partition"] > before["partition"]) & (target >= 0)
        return self.value(target.clamp(min=0), taken)

    def of(self, table: Tensor, target: Tensor) -> Tensor:
        """Entries [N] of a table [N, T] for one target each, [N]."""
        return table.gather(1, target.unsqueeze(-1)).squeeze(-1)

    def marked(self, table: Tensor, target: Tensor, taken: Tensor) -> Tensor:
        """The table [N, T] of booleans, true for ``target`` [N] where ``taken`` [N]."""
        column = target.unsqueeze(-1)
        return table.scatter(1, column, table.gather(1, column) | taken.unsqueeze(-1))


def identity(priority: Tensor) -> Tensor:
    """The priority itself."""
    return priority


class UniqueImageReward(ImageReward):
    """Pays for the first image of every target, and hides what has been imaged.

    ``imaged`` [N, T] tells which targets have been imaged, ``duplicates`` [N] counts images that paid nothing.
    """

    def __init__(self, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """``reward_fn`` maps priorities [N] to rewards [N]."""
        if not callable(reward_fn):
            raise TypeError(f"reward_fn={reward_fn!r} must be a function of priorities [N]")
        self.reward_fn = reward_fn

    def link(self, scenario: Scenario, satellite: Satellite) -> None:
        """See :meth:`ImageReward.link`."""
        super().link(scenario, satellite)
        self.memory.add("imaged_targets", 0, self.scenario.most_targets, dtype=torch.bool)
        self.memory.add("duplicates", 0)

    @property
    def imaged(self) -> Tensor:
        """Which targets have been imaged, [N, T]."""
        return self.memory["imaged_targets"]

    def counts(self) -> dict[str, Tensor]:
        """See :meth:`GlobalReward.counts`."""
        return {"duplicates": self.memory["duplicates"]}

    def selectable(self) -> Tensor:
        """See :meth:`ImageReward.selectable`."""
        return self.scenario.available & ~self.imaged

    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """See :meth:`ImageReward.value`."""
        again = taken & self.of(self.imaged, target)
        pays = taken & ~again
        reward = self.reward_fn(self.of(self.scenario.priority, target))
        self.memory["imaged_targets"] = self.marked(self.imaged, target, pays)
        self.memory["duplicates"] = self.memory["duplicates"] + again
        return torch.where(pays, reward, torch.zeros_like(reward))
