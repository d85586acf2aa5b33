"""Rewards for images of targets."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.sim.hooks import check_class, check_tensor

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario
    from bsk_torch.scene.targets import TargetScenario


class UniqueImages(NamedTuple):
    """Image knowledge, shared by all satellites [N, ...] or per satellite of one type [N * count, ...].

    Attributes:
        imaged: Targets known to be imaged, [N, T] bool.
        known: Existing targets, [N, T] bool.
        duplicates: Number of images without a reward, [N] int64.
    """

    imaged: Tensor
    known: Tensor
    duplicates: Tensor


class Known(NamedTuple):
    """The ``data_store`` of satellites; ``data`` is its content."""

    data: UniqueImages


class ImageReward(GlobalReward):
    """Base class of rewards for images, which determines the imaged targets and hides targets that need no further image.

    Subclasses define :meth:`selectable` and :meth:`value`. A satellite has taken an image if the data in its buffer has grown
    over a step; the image shows the target chosen last. A step therefore counts at most one image per satellite.
    """

    scenario: TargetScenario

    @override
    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, ImageReward, ("selectable", "value"), {})

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError without targets, or without a satellite that can image them."""
        super().link(scenario, fleet)
        if not hasattr(scenario, "most_targets"):
            raise ValueError(
                f"{type(self).__name__} needs a scenario with targets, such as scene.UniformTargets; the scenario is "
                f"{type(scenario).__name__}"
            )
        imagers: list[Any] = [part for part in fleet.satellites if hasattr(part, "latest_target")]  # of users' classes, too
        if not imagers:
            are = ", ".join(f"{part.name} is a {type(part).__name__}" for part in fleet.satellites)
            raise ValueError(
                f"{type(self).__name__} needs a satellite that images targets, such as a sats.ImagingSatellite; {are}"
            )
        for part in imagers:
            part.add_access_filter(functools.partial(self._selectable_by, part.type_index), part.target_types)

    def _selectable_by(self, part: int) -> Tensor:
        found, shape = self.selectable(), (self.fleet.num_envs, self.fleet.size, self.scenario.most_targets)
        check_tensor(f"{type(self).__name__}.selectable()", found, shape, torch.bool)
        return self.fleet.rows_of(part, found)

    def selectable(self) -> Tensor:
        """Return the targets that each satellite may still choose, [N, S, T] bool."""
        raise NotImplementedError(f"{type(self).__name__} must implement selectable()")

    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """Return the reward of each satellite and record its image; called once for every step.

        Args:
            target: Index of the target last chosen by the satellite, [N, S] int64; 0 without one.
            taken: Whether the satellite has taken an image of it in the step, [N, S] bool.

        Returns:
            Reward [N, S], zero if no image was taken.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement value(target, taken)")

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; data in the partition of images, bit."""
        return {"partition": self.fleet.each(lambda satellite: satellite.dynamics.partition_levels[:, 0])}

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        target = self.fleet.each(lambda satellite: satellite.latest_target, missing=-1)
        taken = (after["partition"] > before["partition"]) & (target >= 0)
        return self.value(target.clamp(min=0), taken)

    def taken_by_any(self, target: Tensor, taken: Tensor, targets: int) -> Tensor:
        """Return the targets imaged by at least one satellite in the step, [N, T] bool with T = ``targets``."""
        none = torch.zeros(len(target), targets + 1, dtype=torch.bool, device=target.device)
        return none.scatter(1, torch.where(taken, target, targets), True)[:, :targets]


def identity(priority: Tensor) -> Tensor:
    """Return the priority."""
    return priority


class UniqueImageReward(ImageReward):
    """Reward for the first image of every target; satellites no longer see targets that they know to be imaged.

    The reward is reward_fn(priority) / k for an image of a target not imaged before the step, where k is the number of satellites
    imaging it in the same step. Later images earn nothing, whether or not the satellite knew of the first. A satellite knows its
    own images and those received by communication (:mod:`bsk_torch.comm`). The counter ``duplicates`` [N, S] is the number of
    images without a reward.
    """

    def __init__(self, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """Reward images by ``reward_fn``, a function from priorities [N, S] to rewards [N, S]."""
        if not callable(reward_fn):
            raise TypeError(f"reward_fn={reward_fn!r} must be a function of priorities")
        self.reward_fn = reward_fn

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self.memory.declare("imaged_targets", 0, self.scenario.most_targets, dtype=torch.bool)
        if fleet.size > 1:  # a single satellite knows of all images
            self.memory.declare("known_images", 0, fleet.size, self.scenario.most_targets, dtype=torch.bool)
        self.memory.declare("duplicates", 0, fleet.size, low=0)

    @property
    def imaged(self) -> Tensor:
        """Targets that have been imaged, [N, T] bool."""
        return self.memory["imaged_targets"]

    @property
    def known(self) -> Tensor:
        """Targets known by each satellite to be imaged, [N, S, T] bool."""
        return self.memory["known_images"] if self.fleet.size > 1 else self.imaged.unsqueeze(1)

    @property
    def data(self) -> UniqueImages:
        """Data collected by all satellites together, in readable form."""
        return UniqueImages(self.imaged, self.scenario.drawn("target_exists").bool(), self.memory["duplicates"].sum(1))

    def store_of(self, part: int) -> Known:
        """Return the knowledge of the satellites of type number ``part``, [N * count, ...], their ``data_store``."""
        exists = self.scenario.drawn("target_exists").bool().unsqueeze(1).expand_as(self.known)
        tables = self.known, exists, self.memory["duplicates"]
        return Known(UniqueImages(*(self.fleet.rows_of(part, table) for table in tables)))

    @override
    def counts(self) -> dict[str, Tensor]:
        return {"duplicates": self.memory["duplicates"]}

    @override
    def selectable(self) -> Tensor:
        return self.scenario.available.unsqueeze(1) & ~self.known

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        memory, imaged = self.memory, self.imaged
        again = taken & imaged.gather(1, target)
        pays = taken & ~again
        reward = self.reward_fn(self.scenario.priority_of(target))
        if self.fleet.size > 1:
            reward = reward / self.sharers(target, pays)
            slot = target.unsqueeze(-1)
            known = self.known
            memory["known_images"] = known.scatter(2, slot, known.gather(2, slot) | taken.unsqueeze(-1))
            memory["imaged_targets"] = imaged | self.taken_by_any(target, pays, self.scenario.most_targets)
        else:
            memory["imaged_targets"] = imaged.scatter(1, target, taken | imaged.gather(1, target))
        memory["duplicates"] = memory["duplicates"] + again
        return torch.where(pays, reward, torch.zeros_like(reward))

    @staticmethod
    def sharers(target: Tensor, pays: Tensor) -> Tensor:
        """Return how many satellites have imaged each satellite's target in this step, at least 1, [N, S]."""
        same = (target.unsqueeze(2) == target.unsqueeze(1)) & pays.unsqueeze(1)
        return same.sum(2).clamp(min=1)

    def share(self, links: Tensor) -> None:
        """See :meth:`GlobalReward.share`; knowledge spreads along one link in a step."""
        if self.fleet.size > 1:
            self.memory["known_images"] = spread(self.known, links)


def spread(known: Tensor, links: Tensor) -> Tensor:
    """Return what satellites know, [N, S, T] bool, after it has spread along ``links`` [N, S, S] by sender and receiver."""
    numbers = known.view(torch.uint8)  # forty times as fast as any() and all() of masks
    disputed = numbers.amax(1) != numbers.amin(1)
    most = int(disputed.sum(1).max())
    if not most:
        return known
    # few targets are known to some satellites but not to all; the product covers only these
    slot = torch.where(disputed, torch.cumsum(disputed, 1) - 1, most)
    number = torch.arange(known.shape[2], device=known.device).expand_as(slot)
    column = torch.zeros_like(number[:, : most + 1]).scatter(1, slot, number)[:, :most].unsqueeze(1)
    column = column.expand(-1, known.shape[1], -1)
    some = known.gather(2, column)
    told = torch.bmm(links.mT.float(), some.float()) > 0.5
    return known.scatter(2, column, some | told)
