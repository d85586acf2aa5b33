"""Reward of a team of imagers for services of resident space objects (RSO), of which each imager knows only a part."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number
from bsk_torch.data.base import Log
from bsk_torch.sim.state import FINITE, look_up
from bsk_torch.tasks.objects.aim import AIM
from bsk_torch.tasks.objects.records import NONE
from bsk_torch.tasks.objects.reward import SAME_TIME, RSOImageReward, _Images, _number
from bsk_torch.tasks.objects.scene import OWN_PENDING, PENDING, RSOTargets

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
    from bsk_torch.scene.base import Scenario

COUNTED = ("acquisitions", "services", "duplicate_attempts", "duplicate_deliveries")
"""Counters of satellites in addition to images taken and delivered."""

STAGES = ("acquisition", "delivery")

NO_ATTEMPT = 0
"""Deadline of an imager that does not try to take an image."""


class RSOTeamReward(RSOImageReward):
    """Reward for images of which each imager knows its own and those it has been told of; needs ``knowledge="own"``.

    Images of sufficient quality become records (:class:`~bsk_torch.tasks.objects.records.RecordBook`). Along the links of the
    communicator, living imagers tell each other all that they know; with
    :class:`~bsk_torch.tasks.objects.CatalogCommunication`, what the packets hold.

    A ledger that no imager knows pays for services:

    - An image pays ``(1 - delivery_share)`` times the priority when it is taken, and ``delivery_share`` times when it has been
      delivered. It must have sufficient quality, and must have been taken at least ``cooldown_s`` after the image of the target
      paid last at that stage.
    - Images of a target that are taken within ``same_time_s``, and become known to the ledger at the end of the same step, share
      the reward equally.

    N is the number of episodes, S that of satellites. Counters [N, S] are those of :class:`RSOImageReward` and:

    ========================  ============================================================
    ``acquisitions``          images that paid when they were taken
    ``services``              images that paid when they had been delivered
    ``duplicate_attempts``    images taken before the target had cooled down in the ledger
    ``duplicate_deliveries``  deliveries of sufficient quality that did not pay
    ========================  ============================================================
    """

    def __init__(
        self,
        delivery_share: float = 0.1,
        quality_threshold: float = 0.5,
        cooldown_s: float | None = None,
        same_time_s: float = SAME_TIME,
    ) -> None:
        """Choose what is paid; ValueError for a wrong argument.

        Args:
            delivery_share: Share of the priority that is paid at the delivery.
            quality_threshold: Least quality of an image that pays and that imagers tell each other of.
            cooldown_s: Time after a capture in which no other is wanted, s; None for twice the median period of the imagers'
                orbits at the beginning of the episode.
            same_time_s: Difference of the capture times of images that share a reward, s.
        """
        self.delivery_share = number("delivery_share", delivery_share, 0.0, 1.0)
        super().__init__(quality_threshold=quality_threshold, multi_imager_credit="shared")
        self.service_s = None if cooldown_s is None else number("cooldown_s", cooldown_s, 0.0, 1e12, unit="s")
        self.same_time_s = number("same_time_s", same_time_s, 0.0, 1e12, unit="s")

    @override
    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        super().link(scenario, fleet)
        assert isinstance(scenario, RSOTargets)
        scenario.keep_records(self.service_s)
        if not scenario.block_pending_targets:
            raise ValueError("RSOTeamReward needs RSOTargets with block_pending_targets=True; it is False")
        imagers, declare = len(scenario.imager_columns), self.memory.declare
        for name in COUNTED:
            declare(f"rso_{name}", 0, fleet.size, low=0)
        for stage in STAGES:
            declare(f"rso_{stage}_covers", False, scenario.n_targets)
        declare("rso_attempt_deadline", NO_ATTEMPT, imagers, low=NO_ATTEMPT, high=2**53)
        declare("rso_attempt_useful", 0.0, imagers, low=0.0, high=FINITE)
        declare("rso_wasted", 0.0, fleet.size, low=0.0, high=FINITE)

    # -- what is read -------------------------------------------------------------------------------------------------

    @override
    def counts(self) -> dict[str, Tensor]:
        return super().counts() | {name: self.memory[f"rso_{name}"] for name in COUNTED}

    @property
    def coverage(self) -> dict[str, Tensor]:
        """Share of the targets with an image of sufficient quality that was taken, and that was delivered, [N] each."""
        return {stage: self.memory[f"rso_{stage}_covers"].double().mean(1) for stage in STAGES}

    @property
    def wasted_time(self) -> Tensor:
        """Time of each satellite in attempts at images that could not pay, or that it gave up, [N, S] s.

        An attempt cannot pay from the end of the step in which another imager has completed an image until that capture is older
        than the cooldown; time after the imager has learned of it does not count. Of an attempt that is given up for another
        task, the rest counts, too.
        """
        return self.memory["rso_wasted"]

    # -- steps --------------------------------------------------------------------------------------------------------

    @override
    def read_log(self) -> Log:
        return super().read_log() | {"deadline": self.fleet.each(_deadline, missing=NO_ATTEMPT)}

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        attempts = self._attempts(after)  # before images of the step are recorded
        reward = super().calculate_reward(before, after)
        captures = (after["rso_images"] > before["rso_images"])[:, self._columns]
        self._count_waste(*attempts, captures)
        return reward

    @override
    def _recorded(self, captured: _Images) -> _Images:
        good = captured.exists & (captured.quality >= self.quality_threshold)
        now = self.fleet.sim_time
        completion = now.unsqueeze(1).expand_as(captured.time)
        record = self.scenario.records.enter(good, captured.imager, captured.target, captured.time, completion, now)
        return captured._replace(record=record)

    def _serve(self, captured: _Images, delivered: _Images) -> None:
        """Update records, which targets wait for downlinks, coverage, and the counters of images."""
        memory, pending = self.memory, self.memory[OWN_PENDING]
        change = torch.zeros_like(pending).flatten(1)
        for images, sign in ((captured, 1), (delivered, -1)):
            place = images.imager * self.scenario.n_targets + images.target
            change = change.scatter_add(1, place, sign * images.exists.long())
        memory[OWN_PENDING] = pending + change.view_as(pending)
        memory[PENDING] = memory[OWN_PENDING].sum(1)
        records = torch.where(delivered.exists, delivered.record, NONE)
        self.scenario.records.deliver(records, self.fleet.sim_time)
        for stage, name, images in zip(STAGES, ("captured", "delivered"), (captured, delivered), strict=True):
            good = images._replace(exists=images.exists & (images.quality >= self.quality_threshold))
            memory[f"rso_{stage}_covers"] = memory[f"rso_{stage}_covers"] | (_number(good, memory[PENDING]) > 0)
            memory[f"rso_{name}"] = memory[f"rso_{name}"] + self._by_satellite(images, images.exists.long())

    # -- ledger -------------------------------------------------------------------------------------------------------

    def _credit(self, stage: str, reward_fn: object, images: _Images, size: Tensor, arrival: Tensor) -> None:
        """Pay for images of a step at a stage, one group of simultaneous images of each target after the other.

        An imager has at most one image of a target on board, so there are no more groups than imagers.
        """
        memory, cooldown, target = self.memory, self.scenario.service_time.unsqueeze(1), images.target
        good = images.exists & (images.quality >= self.quality_threshold)
        value = self._priority(images) * (self.delivery_share if stage == "delivery" else 1.0 - self.delivery_share)
        payments, remaining = torch.zeros_like(images.time), images.exists
        late = torch.zeros_like(remaining)
        last = memory[f"rso_{stage}_time"]
        for _ in range(len(self._columns)):
            first = torch.full_like(last, FINITE).scatter_reduce(1, target, torch.where(remaining, images.time, FINITE), "amin")
            group = remaining & (images.time <= first.gather(1, target) + self.same_time_s)
            fresh = first >= last + cooldown
            earns = group & good & fresh.gather(1, target)
            among = torch.zeros_like(last).scatter_add(1, target, earns.double())
            late = late | (group & ~fresh.gather(1, target))
            payments = torch.where(earns, value / among.gather(1, target).clamp(min=1.0), payments)
            last = torch.where(among > 0.0, first, last)
            remaining = remaining & ~group
        memory[f"rso_{stage}_time"] = last
        memory[f"rso_{stage}_reward"] = self._by_satellite(images, payments)
        self._count(stage, images, good, late)

    def _count(self, stage: str, images: _Images, good: Tensor, late: Tensor) -> None:
        """Count images that pay at a stage, and duplicates; ``late`` ones [N, R] come before the target has cooled down."""
        pays, duplicate = ("services", "duplicate_deliveries") if stage == "delivery" else ("acquisitions", "duplicate_attempts")
        flags = {pays: good & ~late, duplicate: good & late if stage == "delivery" else late}
        for name, which in flags.items():
            self.memory[f"rso_{name}"] = self.memory[f"rso_{name}"] + self._by_satellite(images, which.long())

    # -- waste --------------------------------------------------------------------------------------------------------

    def _attempts(self, after: Log) -> tuple[Tensor, Tensor, Tensor]:
        """Return the attempts of imagers in the step that has ended, [N, A] each; records are those of its beginning.

        Returns:
            Tick of the deadline, :data:`NO_ATTEMPT` without an attempt; time in the step for which a service of the target by
            others had made the attempt useless, s; the rest of the time of the attempt in the step, s.
        """
        scenario, fleet = self.scenario, self.fleet
        target = after["target"][:, self._columns].clamp(min=0)
        deadline = after["deadline"][:, self._columns]
        begin = fleet.since.unsqueeze(1)
        ends = torch.minimum(deadline, fleet.ticks.unsqueeze(1)).maximum(begin)
        tries = deadline > begin
        cooldown = scenario.service_time.unsqueeze(1)
        latest = scenario.records.latest()
        sensor_end = latest.gather(2, target.unsqueeze(2)).squeeze(2) + cooldown
        true_end = look_up(latest.amax(1), target) + cooldown
        start, end = begin.double() * fleet.h, ends.double() * fleet.h
        idle = torch.where(tries & (sensor_end <= start), (torch.minimum(true_end, end) - start).clamp(min=0.0), 0.0)
        return torch.where(tries, deadline, NO_ATTEMPT), idle, torch.where(tries, end - start - idle, 0.0)

    def _count_waste(self, deadline: Tensor, idle: Tensor, useful: Tensor, captures: Tensor) -> None:
        """Add the time wasted in a step; ``captures`` [N, A] imagers took an image in it."""
        memory = self.memory
        before, earlier = memory["rso_attempt_deadline"], memory["rso_attempt_useful"]
        continues = deadline == before
        wasted = idle + torch.where(~continues & (before != NO_ATTEMPT), earlier, 0.0)
        ends = captures | (deadline <= self.fleet.ticks.unsqueeze(1))
        memory["rso_attempt_deadline"] = torch.where(ends, NO_ATTEMPT, deadline)
        memory["rso_attempt_useful"] = torch.where(ends, 0.0, torch.where(continues, earlier, 0.0) + useful)
        memory["rso_wasted"] = memory["rso_wasted"].index_add(1, self._columns, wasted)

    # -- knowledge ----------------------------------------------------------------------------------------------------

    def share(self, links: Tensor) -> None:
        """See :meth:`GlobalReward.share`: living imagers tell each other of images, and may require other tasks."""
        fleet, records = self.fleet, self.scenario.records
        if not records.slots:  # else the communicator has delivered packets
            alive = ~fleet.each(lambda satellite: satellite.task.dead)[:, self._columns]
            between = links[:, self._columns][:, :, self._columns] & alive.unsqueeze(1) & alive.unsqueeze(2)
            records.pass_on(records.all_known(between), between, fleet.sim_time)
        for k in self.scenario.imager_types:
            retask_satisfied(fleet.satellites[k], self.scenario)


def retask_satisfied(satellite: BoundSatellite, scenario: RSOTargets) -> None:
    """Let satellites of a type require another task that are imaging a target of which they know a recent capture."""
    task, simulator = satellite.task, satellite.simulator
    satisfied = scenario.of_imagers(satellite, scenario.satisfied)
    mask = satisfied.gather(1, simulator.memory[AIM].clamp(min=0, max=scenario.n_targets - 1).unsqueeze(1)).squeeze(1)
    images = simulator.mode == simulator.mode_names.index("image_rso")
    task.requires_retasking = task.requires_retasking | (images & mask & ~task.dead)


def _deadline(satellite: BoundSatellite) -> Tensor:
    """Return the tick of the deadline of imagers that try to take an image, else zero; AttributeError for other satellites."""
    simulator = satellite.simulator
    tries = (satellite.dynamics.rso_images >= 0.0) & (simulator.mode == simulator.mode_names.index("image_rso"))
    return torch.where(tries, simulator.read("rso_deadline").long(), NO_ATTEMPT)
