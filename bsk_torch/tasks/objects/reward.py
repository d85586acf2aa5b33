"""Reward for images of resident space objects (RSO), when they are taken and when they have been downlinked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import function, number
from bsk_torch.constants import NANO
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.scene.recorded import RecordedProgress
from bsk_torch.sim.hooks import check_tensor
from bsk_torch.sim.state import FINITE, look_up
from bsk_torch.tasks.objects.aim import AIM
from bsk_torch.tasks.objects.scene import COOLDOWN, PENDING, RSOTargets

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
    from bsk_torch.scene.base import Scenario

CREDITS = ("shared", "per_imager")

LEAST_BITS = 1e-6
"""Data that count as none, bit."""

SAME_TIME = 1e-9
"""Difference of times that counts as none, s."""

FIRST_PRODUCTS = 4
"""Room for products of each imager at the beginning; it grows."""

NONE = -1
"""Target of a place without a product."""


class RSOImageRecord(NamedTuple):
    """Images, as functions of rewards get them: tensors [N, R] of the R images of a step, which may lack some.

    Attributes:
        capture_time: Time at which the image was taken, s.
        size_bits: Data, bit.
        quality: Mean visible fraction of the Sun at the target over the hold.
        hold_valid_time_s: Length of the hold, s.
        delivery_time: Time at which the last bit had been downlinked, s; NaN before.
        target_index: Number of the target.
        imager_column: Number of the imager among the satellites of an episode.
    """

    capture_time: Tensor
    size_bits: Tensor
    quality: Tensor
    hold_valid_time_s: Tensor
    delivery_time: Tensor
    target_index: Tensor
    imager_column: Tensor


class RSOImageTarget(NamedTuple):
    """Targets of images, as functions of rewards get them.

    Attributes:
        priority: Priority before the changes at the end of the step, [N, R].
    """

    priority: Tensor


RewardFunction = Callable[[RSOImageRecord, RSOImageTarget], Tensor]
"""Returns the reward of each image, [N, R]."""


@dataclass(frozen=True)
class Share:
    """Reward of images: a share of the priority of the target."""

    share: float

    def __call__(self, record: RSOImageRecord, target: RSOImageTarget) -> Tensor:
        """Return the rewards, [N, R]."""
        return self.share * target.priority


class _Images(NamedTuple):
    """Images of a step or on board, [N, R] each: whether there is one, its target, imager, time, quality, hold and record."""

    exists: Tensor
    target: Tensor
    imager: Tensor
    time: Tensor
    quality: Tensor
    held: Tensor
    record: Tensor


class RSOImageReward(GlobalReward):
    """Reward for images of :class:`~bsk_torch.tasks.objects.RSOTargets`: when taken, and when downlinked completely.

    An image on board is a *product*. The downlink of a partition empties its products in the order of their capture; one is
    *delivered* at the end of the step in which its last bit has gone. Rewards are:

    - The images of a target that are on board of any satellite at the same time belong to one *service* of the target. A new one
      begins with the first image while there is none.
    - A service pays once for its acquisition and once for its delivery: in the first step in which images of sufficient quality
      are taken, or delivered. With ``"per_imager"`` it does for each imager. Several such images of one step share the reward.
    - It pays only if the earliest of these images was taken at least ``cooldown_s`` after the earliest of those paid last.
    - A delivered image of sufficient quality lets its target cool down until ``cooldown_s`` after the image was taken; meanwhile
      the target cannot be chosen. With ``cooldown_orbits``, this is so many orbital periods of the imager, or the median of the
      imagers' periods, at the beginning of the episode.

    With ``delivery_share``, images pay the priority of the target: this share of it when delivered, and the rest when taken.
    With ``advance``, they pay this share when taken, and the rest of the priority at that time when delivered. At the time limit,
    advances for images on board are paid back: returns are those of ``delivery_share=1``, but what an image brings shows at
    once, which is learned faster. An episode that ends earlier keeps them.

    N is the number of episodes, S that of satellites. The counters ``captured`` and ``delivered`` [N, S] count images.
    """

    scenario: RSOTargets

    def __init__(
        self,
        acquisition_reward_fn: RewardFunction | None = None,
        delivery_reward_fn: RewardFunction | None = None,
        quality_threshold: float = 0.5,
        cooldown_s: float = 0.0,
        multi_imager_credit: str | None = None,
        cooldown_orbits: float | None = None,
        delivery_share: float | None = None,
        advance: float = 0.0,
    ) -> None:
        """Choose what is paid; ValueError for a wrong argument.

        Args:
            acquisition_reward_fn: Reward of images when they are taken, a function of :class:`RSOImageRecord` and
                :class:`RSOImageTarget` that returns [N, R] (default: zero).
            delivery_reward_fn: Reward of images when they have been downlinked, likewise (default: the priority).
            quality_threshold: Least quality of an image that pays.
            cooldown_s: Time after the capture of a delivered image in which its target cannot be chosen, s.
            multi_imager_credit: ``"shared"`` or ``"per_imager"``, see the class; needed with several imagers.
            cooldown_orbits: The same time as ``cooldown_s``, in orbital periods; give one of them.
            delivery_share: Share of the priority that images pay when delivered, from 0 to 1, in place of the functions.
            advance: Share of the priority that they pay in advance, likewise; for one imager.
        """
        self.advance = number("advance", advance, 0.0, 1.0)
        if self.advance > 0.0 and delivery_share not in (None, 1.0):
            raise ValueError(f"delivery_share={delivery_share!r} and advance={advance!r}: give one of them")
        fns = {"acquisition_reward_fn": acquisition_reward_fn, "delivery_reward_fn": delivery_reward_fn}
        if (self.advance > 0.0 or delivery_share is not None) and any(fn is not None for fn in fns.values()):
            raise ValueError("delivery_share and functions of rewards exclude one another; give one of them")
        share = 1.0 if delivery_share is None else number("delivery_share", delivery_share, 0.0, 1.0)
        shares = Share(self.advance or 1.0 - share), Share(share)
        self.acquisition_reward_fn, self.delivery_reward_fn = (
            default if fn is None else function(name, fn, "record and target")
            for (name, fn), default in zip(fns.items(), shares, strict=True)
        )
        self.quality_threshold = number("quality_threshold", quality_threshold, 0.0, 1.0)
        self.cooldown_s = number("cooldown_s", cooldown_s, 0.0, 1e12, unit="s")
        self.cooldown_orbits = cooldown_orbits
        if cooldown_orbits is not None:
            self.cooldown_orbits = number("cooldown_orbits", cooldown_orbits, 0.0, 1e9)
            if self.cooldown_s != 0.0:
                raise ValueError(f"cooldown_s={cooldown_s!r} and cooldown_orbits={cooldown_orbits!r}: give one of them")
        if multi_imager_credit not in (None, *CREDITS):
            raise ValueError(
                f"multi_imager_credit={multi_imager_credit!r} must be one of {list(CREDITS)}, or None for one imager"
            )
        self.multi_imager_credit = multi_imager_credit

    @property
    @override
    def observed_columns(self) -> list[int]:
        return self.scenario.imager_columns

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError for a scenario without a catalog, or several imagers without a mode."""
        super().link(scenario, fleet)
        if not isinstance(scenario, RSOTargets):
            raise ValueError(f"RSOImageReward needs RSOTargets; the scenario is {type(scenario).__name__}")
        if len(scenario.imager_names) > 1 and self.multi_imager_credit is None:
            raise ValueError(
                f"imager_names={list(scenario.imager_names)}: with several imagers, RSOImageReward needs "
                "multi_imager_credit='shared' or 'per_imager'"
            )
        if len(scenario.imager_names) > 1 and self.advance > 0.0:
            raise ValueError(
                f"advance={self.advance}: images pay in advance for one imager; there are {len(scenario.imager_names)}"
            )
        self._columns = torch.tensor(scenario.imager_columns, device=fleet.device)
        fleet.want(*LOGGED)
        imagers, targets = len(scenario.imager_columns), scenario.n_targets
        scopes = targets * imagers if self.multi_imager_credit == "per_imager" else targets
        declare = self.memory.declare
        declare("rso_service", 0, targets, low=0)
        for stage in ("acquisition", "delivery"):
            declare(f"rso_{stage}_service", 0, scopes, low=0)
            declare(f"rso_{stage}_time", -FINITE, scopes, low=-FINITE, high=FINITE)
            declare(f"rso_{stage}_reward", 0.0, fleet.size, low=-FINITE, high=FINITE)
        if self.advance > 0.0:
            declare("rso_advance", 0.0, targets, low=0.0, high=FINITE)
        room = FIRST_PRODUCTS, imagers
        declare("rso_product_target", NONE, *room, grows=True, low=NONE, high=targets - 1)
        for name in ("time", "quality", "held", "left"):
            declare(f"rso_product_{name}", 0.0, *room, grows=True, low=0.0, high=FINITE)
        declare("rso_product_record", NONE, *room, grows=True, low=NONE)
        for name in ("captured", "delivered"):
            declare(f"rso_{name}", 0, fleet.size, low=0)

    @property
    def cooldown(self) -> Tensor:
        """Time after the capture of a delivered image in which its target cannot be chosen, [N] s."""
        if self.cooldown_orbits is not None:
            return self.cooldown_orbits * self.scenario.median_period
        return torch.full((self.fleet.num_envs,), self.cooldown_s, dtype=torch.float64, device=self.fleet.device)

    @property
    def last_reward_components(self) -> dict[str, Tensor]:
        """Rewards of the last step for acquisitions and for deliveries, [N, S] each."""
        return {stage: self.memory[f"rso_{stage}_reward"] for stage in ("acquisition", "delivery")}

    @property
    def imaged(self) -> Tensor:
        """Targets imaged in the episode, [N, G]."""
        return self.memory["rso_service"] > 0

    @override
    def counts(self) -> dict[str, Tensor]:
        return {name: self.memory[f"rso_{name}"] for name in ("captured", "delivered")}

    @override
    def recorded(self, env: int) -> RecordedProgress:
        target, time = (self.memory[f"rso_product_{name}"][env].cpu() for name in ("target", "time"))
        held = target != NONE
        columns = self._columns.cpu().expand_as(target)
        images = list(zip(*(part[held].tolist() for part in (columns, target, time)), strict=True))
        return RecordedProgress(kind="rso_imaging", images=images)

    # -- images -------------------------------------------------------------------------------------------------------

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; the number of images, the last one, and the partitions of the stores."""
        log = {name: self.fleet.each(_reader(name)) for name in (*LOGGED, *FIELDS)}
        log["target"] = self.fleet.each(_target, missing=NONE)
        return log

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        old, new = ({name: value[:, self._columns] for name, value in log.items()} for log in (before, after))
        captured, unfinished, size = *self._captures(old, new), new["instrument_baud"]
        captured = self._recorded(captured)
        stored = new["rso_stored_tick"] != old["rso_stored_tick"]
        target = new["target"].clamp(min=0).unsqueeze(-1)
        gone = old["partition_levels"] - new["partition_levels"]
        gone = gone.scatter_add(2, target, torch.where(stored, size, 0.0).unsqueeze(-1))
        for images in (unfinished, captured):
            self._keep(images, size)
        delivered = self._deliver(gone)
        self._serve(_Images(*(torch.cat(pair, 1) for pair in zip(captured, unfinished, strict=True))), delivered)
        sizes = size, size.unsqueeze(1).expand(-1, delivered.exists.shape[1] // size.shape[1], -1).flatten(1)
        self._credit("acquisition", self.acquisition_reward_fn, captured, sizes[0], torch.full_like(captured.time, torch.nan))
        arrival = self.fleet.sim_time.unsqueeze(1).expand_as(delivered.time)
        self._credit("delivery", self.delivery_reward_fn, delivered, sizes[1], arrival)
        if self.advance > 0.0:
            self._settle(captured, delivered)
        return self.memory["rso_acquisition_reward"] + self.memory["rso_delivery_reward"]

    def _captures(self, old: Log, new: Log) -> tuple[_Images, _Images]:
        """Return the images whose attempts have ended in a step, and those that another command has left before their end.

        An attempt also ends with the episode: the image then counts like one at a deadline.
        """
        fleet, target = self.fleet, new["target"].clamp(min=0)
        final = (fleet.sim_time + 0.5 * fleet.h >= fleet.state.time_limit).unsqueeze(1) & (new["rso_open"] > 0.0)
        captures = (new["rso_images"] > old["rso_images"]) & (new["target"] >= 0)
        imager = torch.arange(len(self._columns), device=captures.device).expand_as(captures)
        unknown = torch.full_like(target, NONE)
        now = fleet.sim_time.unsqueeze(1).expand_as(new["rso_image_time"])
        captured = _Images(
            captures | final,
            target,
            imager,
            torch.where(final, now, new["rso_image_time"]),
            torch.where(final, new["rso_light"].double(), new["rso_image_quality"]),
            torch.where(final, new["rso_held"], new["rso_image_held"]),
            unknown,
        )
        began = (fleet.since * fleet.simulators[0].h_ns).double().unsqueeze(1).expand_as(now) * NANO
        unfinished, none = new["rso_left"] > old["rso_left"], torch.zeros_like(began)
        return captured, _Images(unfinished, new["rso_left_target"].long().clamp(min=0), imager, began, none, none, unknown)

    def _recorded(self, captured: _Images) -> _Images:
        """Return new images with the numbers of their records (default: none)."""
        return captured

    def _keep(self, captured: _Images, size: Tensor) -> None:
        """Add the products of new images, behind the older ones."""
        memory = self.memory
        occupied = memory["rso_product_target"] != NONE
        if bool((occupied.all(1) & captured.exists).any()):
            for name in PRODUCT:
                table = memory[f"rso_product_{name}"]
                padding = table.new_full(
                    (len(table), FIRST_PRODUCTS, *table.shape[2:]), NONE if name in ("target", "record") else 0
                )
                setattr(memory, f"rso_product_{name}", torch.cat([table, padding], 1))
            memory.touch()
            occupied = memory["rso_product_target"] != NONE
        slot = occupied.sum(1, keepdim=True).clamp(max=occupied.shape[1] - 1)  # products are in front
        values = captured.target, captured.time, captured.quality, captured.held, size, captured.record
        for name, value in zip(PRODUCT, values, strict=True):
            table = memory[f"rso_product_{name}"]
            new = torch.where(captured.exists.unsqueeze(1), value.unsqueeze(1).to(table.dtype), table.gather(1, slot))
            memory[f"rso_product_{name}"] = table.scatter(1, slot, new)

    def _deliver(self, gone: Tensor) -> _Images:
        """Take the data ``gone`` [N, A, G], bit, from the products, oldest first; return those that are complete, [N, M * A]."""
        memory = self.memory
        target, remaining = memory["rso_product_target"], memory["rso_product_left"]
        occupied = target != NONE
        # products are in the order of their capture, so a stable sort by target puts those of a target side by side
        order = torch.where(occupied, target, self.scenario.n_targets).argsort(dim=1, stable=True)
        by_target, bits = target.gather(1, order), torch.where(occupied, remaining, 0.0).gather(1, order)
        older = torch.cumsum(bits, 1) - bits
        first = torch.ones_like(by_target, dtype=torch.bool)
        first[:, 1:] = by_target[:, 1:] != by_target[:, :-1]
        older = older - torch.where(first, older, -torch.inf).cummax(1).values
        amount = gone.mT.gather(1, by_target.clamp(min=0))
        bits_left = bits - torch.minimum((amount - older).clamp(min=0.0), bits)
        remaining = torch.zeros_like(remaining).scatter(1, order, bits_left)
        complete = occupied & (remaining <= LEAST_BITS)
        imager = torch.arange(target.shape[2], device=target.device).expand_as(target)
        columns = (memory[f"rso_product_{name}"] for name in ("time", "quality", "held", "record"))
        delivered = _Images(*(part.flatten(1) for part in (complete, target.clamp(min=0), imager, *columns)))
        valid = occupied & ~complete
        forward = (~valid).byte().argsort(dim=1, stable=True)
        memory["rso_product_left"] = remaining
        memory["rso_product_target"] = torch.where(valid, target, NONE)
        for name in PRODUCT:
            memory[f"rso_product_{name}"] = memory[f"rso_product_{name}"].gather(1, forward)
        return delivered

    # -- rewards ------------------------------------------------------------------------------------------------------

    def _serve(self, captured: _Images, delivered: _Images) -> None:
        """Begin services, and update which targets wait for downlinks and cool down, and the counters."""
        memory, pending = self.memory, self.memory[PENDING]
        new, gone = (_number(images, pending) for images in (captured, delivered))
        memory["rso_service"] = memory["rso_service"] + ((new > 0) & (pending == 0))
        memory[PENDING] = pending + new - gone
        useful = delivered.exists & (delivered.quality >= self.quality_threshold)
        until = torch.where(useful, delivered.time + self.cooldown.unsqueeze(1), -FINITE)
        memory[COOLDOWN] = memory[COOLDOWN].scatter_reduce(1, delivered.target, until, "amax")
        for name, images in (("captured", captured), ("delivered", delivered)):
            memory[f"rso_{name}"] = memory[f"rso_{name}"] + self._by_satellite(images, images.exists.long())

    def _by_satellite(self, images: _Images, value: Tensor) -> Tensor:
        """Return the sums of values [N, R] of images over those of each satellite, [N, S]."""
        sums = value.new_zeros(len(value), len(self._columns)).scatter_add(1, images.imager, value)
        return value.new_zeros(len(value), self.fleet.size).index_add(1, self._columns, sums)

    def _credit(self, stage: str, reward_fn: RewardFunction, images: _Images, size: Tensor, arrival: Tensor) -> None:
        """Pay for images of a step at a stage; see the class."""
        memory, scenario = self.memory, self.scenario
        shared = self.multi_imager_credit != "per_imager"
        scope = images.target if shared else images.target + scenario.n_targets * images.imager
        services, last = memory[f"rso_{stage}_service"], memory[f"rso_{stage}_time"]
        service = memory["rso_service"].gather(1, images.target)
        counts = images.exists & (images.quality >= self.quality_threshold) & (services.gather(1, scope) != service)
        number = torch.zeros_like(last).scatter_add(1, scope, counts.double())
        earliest = torch.full_like(last, FINITE).scatter_reduce(1, scope, torch.where(counts, images.time, FINITE), "amin")
        pays = (number > 0.0) & (earliest > last + SAME_TIME) & (earliest >= last + self.cooldown.unsqueeze(1))
        earns = counts & pays.gather(1, scope)
        value = self._value(stage, reward_fn, images, size, arrival, earns) / number.gather(1, scope).clamp(min=1.0)
        memory[f"rso_{stage}_reward"] = self._by_satellite(images, torch.where(earns, value, 0.0))
        memory[f"rso_{stage}_time"] = torch.where(pays, earliest, last)
        of_scope = memory["rso_service"] if shared else memory["rso_service"].repeat(1, len(self._columns))
        memory[f"rso_{stage}_service"] = torch.where(pays, of_scope, services)

    def _settle(self, captured: _Images, delivered: _Images) -> None:
        """Take advances back for images that have been delivered, and at the time limit for all others.

        There is one imager, which cannot choose a target while its image is on board: a target has one advance at most.
        """
        memory = self.memory
        advance = memory["rso_acquisition_reward"][:, self._columns]
        advances = memory["rso_advance"].scatter_add(1, captured.target, torch.where(captured.exists, advance, 0.0))
        gone = torch.zeros_like(advances).scatter_add(1, delivered.target, delivered.exists.double()) > 0.0
        final = (self.fleet.sim_time + 0.5 * self.fleet.h >= self.fleet.state.time_limit).unsqueeze(1)
        back = torch.where(gone | final, advances, 0.0)
        memory["rso_advance"] = advances - back
        reward = memory["rso_delivery_reward"]
        memory["rso_delivery_reward"] = reward.index_add(1, self._columns, -back.sum(1, keepdim=True))

    def _priority(self, images: _Images) -> Tensor:
        """Return the priorities of the targets of images at the beginning of the step, [N, R]."""
        began = (self.fleet.since * self.fleet.simulators[0].h_ns).double() * NANO
        return look_up(self.scenario.priority_at(began), images.target)

    def _value(
        self, stage: str, reward_fn: RewardFunction, images: _Images, size: Tensor, arrival: Tensor, earns: Tensor
    ) -> Tensor:
        """Return the rewards of images by the user's function, [N, R]; what it gives for others does not matter."""
        target = RSOImageTarget(self._priority(images))
        record = RSOImageRecord(
            images.time, size, images.quality, images.held, arrival, images.target, self._columns[images.imager]
        )
        value, title = reward_fn(record, target), f"{stage}_reward_fn(record, target)"
        check_tensor(title, value, images.time.shape, torch.float64, torch.float32)
        wrong = earns & ~torch.isfinite(value)
        if bool(wrong.any()):
            env, k = torch.nonzero(wrong)[0].tolist()
            name = self.scenario.ids[int(images.target[env, k])]
            raise ValueError(
                f"{title} is {float(value[env, k])} for an image of {name!r} in environment {env}; it must be finite"
            )
        return value.double()


PRODUCT = ("target", "time", "quality", "held", "left", "record")
"""What is kept of a product."""

LOGGED = (
    "rso_images",
    "rso_left",
    "rso_image_time",
    "rso_image_quality",
    "rso_image_held",
    "instrument_baud",
    "partition_levels",
)
"""Properties of imagers that rewards follow from."""

FIELDS = ("rso_stored_tick", "rso_open", "rso_left_target", "rso_light", "rso_held")
"""Fields of their state, likewise."""


def _reader(name: str) -> Callable[[BoundSatellite], Tensor]:
    """Return a function that reads a property or a field of imagers; AttributeError for other satellites."""

    def read(satellite: BoundSatellite) -> Tensor:
        images = satellite.dynamics.rso_images
        return satellite.simulator.read(name).to(images.dtype) if name in FIELDS else getattr(satellite.dynamics, name)

    return read


def _target(satellite: BoundSatellite) -> Tensor:
    """Return the target of imagers; AttributeError for other satellites."""
    return torch.where(satellite.dynamics.rso_images >= 0.0, satellite.memory[AIM], NONE)


def _number(images: _Images, like: Tensor) -> Tensor:
    """Return the number of images of each target, [N, G]."""
    return torch.zeros_like(like).scatter_add(1, images.target, images.exists.long())
