"""Rewards for images of targets, under clouds, of uncertain places, or of strips."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, switch
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.overlaid import CloudyTargets, StripTargets, UncertainTargets
from bsk_torch.scene.targets import TargetScenario
from bsk_torch.sim.hooks import check_class, check_tensor


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
    needs: ClassVar[tuple[str, str]] = ("most_targets", "a scenario with targets, such as scene.UniformTargets")
    """Attribute that the scenario must have, and a scenario that has it."""

    @override
    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, ImageReward, ("selectable", "value"), {})

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError without targets, or without a satellite that can image them."""
        super().link(scenario, fleet)
        if not hasattr(scenario, self.needs[0]):
            raise ValueError(f"{type(self).__name__} needs {self.needs[1]}; the scenario is {type(scenario).__name__}")
        imagers: list[Any] = [part for part in fleet.satellites if hasattr(part, "latest_target")]  # of users' classes, too
        if not imagers:
            are = ", ".join(f"{part.name} is a {type(part).__name__}" for part in fleet.satellites)
            raise ValueError(
                f"{type(self).__name__} needs a satellite that images targets, such as a sats.ImagingSatellite; {are}"
            )
        fleet.want("partition_levels")
        for part in imagers:
            part.add_access_filter(functools.partial(self._selectable_by, part.type_index), part.target_types)

    def _selectable_by(self, part: int) -> Tensor:
        free, shape = self.selectable(), (self.fleet.num_envs, self.fleet.size, self.scenario.most_targets)
        check_tensor(f"{type(self).__name__}.selectable()", free, shape, torch.bool)
        return self.fleet.rows_of(part, free)

    def selectable(self) -> Tensor:
        """Return the targets that each satellite may still choose, [N, S, T] bool."""
        raise NotImplementedError(f"{type(self).__name__} must implement selectable()")

    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        """Return the reward of each satellite, [N, S], zero without an image, and record images; called once for every step.

        ``target`` [N, S] int64 is the one chosen last, 0 without one; ``taken`` [N, S] tells of an image of it in the step.
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
        return self.scenario.available.unsqueeze(1) > self.known  # and not known, by one operation

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        memory, imaged = self.memory, self.imaged
        again = taken & imaged.gather(1, target)
        pays = taken & ~again
        reward = self.reward_fn(self.scenario.priority_of(target))
        if self.fleet.size > 1:
            reward = reward / self.sharers(target, pays)
            slot = target.unsqueeze(-1)
            images = self.known
            memory["known_images"] = images.scatter(2, slot, images.gather(2, slot) | taken.unsqueeze(-1))
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


FEW = 1 << 16
"""Numbers of the knowledge of all satellites up to which all of them are spread, not only those of disputed targets."""


def spread(knowledge: Tensor, links: Tensor) -> Tensor:
    """Return what satellites know, [N, S, T] bool, after it has spread along ``links`` [N, S, S] by sender and receiver."""
    if knowledge.numel() <= FEW or knowledge.device.type != "cpu":  # whose number of disputed targets takes longer to read
        return knowledge | (torch.bmm(links.mT.float(), knowledge.float()) > 0.5)
    numbers = knowledge.view(torch.uint8)  # forty times as fast as any() and all() of masks
    disputed = numbers.amax(1) != numbers.amin(1)
    most = int(disputed.sum(1).max())
    if not most:
        return knowledge
    # few targets are known to some satellites but not to all; the product covers only these
    slot = torch.where(disputed, torch.cumsum(disputed, 1) - 1, most)
    number = torch.arange(knowledge.shape[2], device=knowledge.device).expand_as(slot)
    column = torch.zeros_like(number[:, : most + 1]).scatter(1, slot, number)[:, :most].unsqueeze(1)
    column = column.expand(-1, knowledge.shape[1], -1)
    some = knowledge.gather(2, column)
    told = torch.bmm(links.mT.float(), some.float()) > 0.5
    return knowledge.scatter(2, column, some | told)


class CloudFreeImageReward(UniqueImageReward):
    """Reward for the first image of every target, given if the true cloud cover is at most ``threshold``.

    The true cover is not observable before the image. The target is hidden afterwards, whether or not the image was clear. The
    counter ``covered`` [N, S] is the number of cloudy images.

    Clouds do not matter to satellites whose class sets ``sees_through_clouds``, such as radars. If there are any, cloudy images
    of the other satellites do not count as images: they hide the target only from satellites to which clouds matter and that
    know of them, and a radar can still earn its priority.
    """

    scenario: CloudyTargets
    needs = ("cloud_cover", "scene.CloudyTargets")

    def __init__(self, threshold: float = 0.7, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """Reward images with a cover of at most ``threshold`` of the sky; ``reward_fn`` as in :class:`UniqueImageReward`."""
        super().__init__(reward_fn)
        self.threshold = number("threshold", threshold, 0.0, 1.0, unit="of the sky")

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self.memory.declare("covered", 0, fleet.size, low=0)
        self._through = torch.zeros(fleet.size, dtype=torch.bool, device=fleet.device)
        for part, columns in zip(fleet.satellites, fleet.columns, strict=True):
            self._through[columns] = switch(
                f"{type(part).__name__}.sees_through_clouds", getattr(part, "sees_through_clouds", False)
            )
        self._mixed = bool(self._through.any())
        if self._mixed:
            self.memory.declare("known_clouds", 0, fleet.size, self.scenario.most_targets, dtype=torch.bool)

    @override
    def counts(self) -> dict[str, Tensor]:
        return super().counts() | {"covered": self.memory["covered"]}

    @override
    def selectable(self) -> Tensor:
        free = super().selectable()
        return free & (self._through.view(1, -1, 1) | ~self.memory["known_clouds"]) if self._mixed else free

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        clouded = taken & (self.scenario.cloud_cover.gather(1, target) > self.threshold) & ~self._through
        self.memory["covered"] = self.memory["covered"] + clouded
        if self._mixed:
            clouds, slot = self.memory["known_clouds"], target.unsqueeze(-1)
            self.memory["known_clouds"] = clouds.scatter(2, slot, clouds.gather(2, slot) | clouded.unsqueeze(-1))
            return super().value(target, taken & ~clouded)
        reward = super().value(target, taken)
        return torch.where(clouded, torch.zeros_like(reward), reward)

    def share(self, links: Tensor) -> None:
        """See :meth:`GlobalReward.share`; which targets are under clouds spreads like images."""
        super().share(links)
        if self._mixed and self.fleet.size > 1:
            self.memory["known_clouds"] = spread(self.memory["known_clouds"], links)


class FootprintImageReward(UniqueImageReward):
    """Reward for the first image of every target, given if the image shows the true place of the target.

    An image shows what lies within ``half_angle`` of the instrument's axis when it is taken, on the side of the Earth that faces
    the satellite. Images from farther away therefore show more ground. The counter ``off_target`` [N, S] is the number of images
    that do not show their target.
    """

    scenario: UncertainTargets
    needs = ("true_r_LP_P", "scene.UncertainTargets")

    def __init__(self, half_angle: float, hide_missed: bool = True, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """Reward images that show their targets.

        Args:
            half_angle: Half of the angle of view, rad, at most pi / 2. Images are taken with pointing errors of up to four times
                the inverse tangent of ``imageAttErrorRequirement``, 0.04 rad by default.
            hide_missed: Whether a target is hidden after an image that does not show it, as after one that does.
            reward_fn: Function from priorities [N, S] to rewards [N, S].
        """
        super().__init__(reward_fn)
        self.half_angle = number("half_angle", half_angle, 0.0, 0.5 * math.pi, unit="rad", above=True)
        self.hide_missed = switch("hide_missed", hide_missed)

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        self.memory.declare("off_target", 0, fleet.size, low=0)

    @override
    def counts(self) -> dict[str, Tensor]:
        return super().counts() | {"off_target": self.memory["off_target"]}

    def shows(self, target: Tensor) -> Tensor:
        """Return whether an image that each satellite takes now shows the true place of ``target`` [N, S], [N, S] bool."""
        place = self.scenario.look_up(self.scenario.true_r_LP_P, target)
        satellite = self.fleet.each(lambda part: part.dynamics.r_BN_P)
        axis = self.fleet.each(lambda part: part.fsw.c_hat_P)
        ray = place - satellite
        along = (ray * axis).sum(-1)
        across = torch.linalg.cross(ray, axis.to(ray)).norm(dim=-1)  # exact for small angles, where acos is not
        faces = (ray * place).sum(-1) < 0.0
        return (torch.atan2(across, along) <= self.half_angle) & faces

    @override
    def value(self, target: Tensor, taken: Tensor) -> Tensor:
        off = taken & ~self.shows(target)
        self.memory["off_target"] = self.memory["off_target"] + off
        reward = super().value(target, taken if self.hide_missed else taken & ~off)
        return torch.where(off, torch.zeros_like(reward), reward)


class StripImageReward(UniqueImageReward):
    """Reward for the first recording of every strip of :class:`bsk_torch.scene.StripTargets`.

    A strip counts if the data that a satellite records in a step, divided by the data rate of its instrument, take at least the
    share ``fraction`` of the time that the strip takes, rounded down to whole ticks.
    """

    scenario: StripTargets
    needs = ("strip_seconds", "scene.StripTargets")

    def __init__(self, fraction: float = 0.9, reward_fn: Callable[[Tensor], Tensor] = identity) -> None:
        """Reward recordings of at least a ``fraction`` in (0, 1]; ``reward_fn`` as in :class:`UniqueImageReward`."""
        super().__init__(reward_fn)
        self.fraction = number("fraction", fraction, 0.0, 1.0, above=True)

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
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
