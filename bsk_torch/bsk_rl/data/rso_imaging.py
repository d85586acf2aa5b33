"""Rewards for images of spacecraft and for their downlink; counterpart of ``bsk_rl.data.rso_imaging``."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from bsk_torch._checks import function, number
from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward
from bsk_torch.bsk_rl.utils.rso_imaging import RSOImageRecord
from bsk_torch.tasks.objects.reward import LEAST_BITS, SAME_TIME
from bsk_torch.tasks.objects.team_reward import STAGES

Records = dict[str, RSOImageRecord]
"""Images by ``record_id``."""

Log = tuple[dict[str, float], tuple[RSOImageRecord, ...]]
"""Level of each partition, bit, and all images taken in the episode."""

Service = tuple[tuple[str, str], tuple[str, int]]
"""Id of a target with the name of the imager that is paid, if not all are, and the target's service by its number."""

RewardFunction = Callable[[RSOImageRecord, Any], float]
"""Value of an image, given also its target with its present ``priority``."""

CREDITS = (None, "shared", "per_imager")


class RSOImageData(Data):
    """Images that have been taken, and those whose downlink is complete."""

    def __init__(
        self, captures: Mapping[str, RSOImageRecord] | None = None, deliveries: Mapping[str, RSOImageRecord] | None = None
    ) -> None:
        """Initialize with images taken, and downlinked, by ``record_id``; empty by default."""
        self.captures: Records = dict(captures or {})
        self.deliveries: Records = dict(deliveries or {})

    def __add__(self, other: RSOImageData) -> RSOImageData:
        """Return the images of both; ValueError if they differ about one."""
        return RSOImageData(_both(self.captures, other.captures), _both(self.deliveries, other.deliveries))


def _both(one: Records, other: Records) -> Records:
    if wrong := [key for key in one.keys() & other.keys() if one[key] != other[key]]:
        raise ValueError(f"two different images are called {sorted(wrong)}")
    return one | other


class RSOImageStore(DataStore):
    """Images in the store of an imager. What leaves a partition belongs to its oldest image.

    Attributes:
        products: Images whose downlink is not complete, by ``record_id``.
        remaining_bits: What of them is left in the store, bit, by ``record_id``.
        is_imager: Whether the satellite is among the imagers of the scenario.
    """

    data_type = RSOImageData

    def __init__(self, satellite: Any, initial_data: Any = None, scenario: Any = None) -> None:
        """See :class:`DataStore`; ``scenario`` is the one with the targets."""
        super().__init__(satellite, initial_data)
        self.scenario = scenario
        self.products: Records = {}
        self.remaining_bits: dict[str, float] = {}
        self.is_imager = scenario is not None and satellite.name in scenario.imager_names

    def get_log_state(self) -> Log:
        """See :meth:`DataStore.get_log_state`."""
        if not self.is_imager:
            return {}, ()
        capture = self.satellite.fsw.rso_capture
        capture.check_capture()
        message = self.satellite.dynamics.storageUnit.storageUnitDataOutMsg.read()
        return dict(zip(message.storedDataName, message.storedData, strict=False)), tuple(capture.records)

    def compare_log_states(self, old_state: Log, new_state: Log) -> RSOImageData:
        """Return the images taken in the step, and those whose downlink it completes.

        Raises:
            ValueError: For an image of another satellite, a repeated one, or data that left the store but belong to none.
        """
        (old_levels, old_records), (levels, records) = old_state, new_state
        taken, gone = records[len(old_records) :], defaultdict[str, float](float)
        for record in taken:
            if record.source_imager != self.satellite.name or record.record_id in self.products:
                raise ValueError(f"{self.satellite.name} has no new image {record.record_id} of {record.source_imager}")
            self.products[record.record_id], self.remaining_bits[record.record_id] = record, record.size_bits
            gone[self.scenario.partition_name(record.target_id)] += record.size_bits
        delivered: Records = {}
        for target_id in self.scenario.targets_by_id if self.is_imager else ():
            name = self.scenario.partition_name(target_id)
            delivered |= self._downlinked(target_id, old_levels.get(name, 0.0) + gone[name] - levels.get(name, 0.0))
        return RSOImageData({record.record_id: record for record in taken}, delivered)

    def _downlinked(self, target_id: str, bits: float) -> Records:
        """Take data, bit, from the images of a target, oldest first; return those that are complete."""
        stored = [record for record in self.products.values() if record.target_id == target_id]
        delivered: Records = {}
        for record in sorted(stored, key=lambda record: (record.capture_time, record.record_id)):
            if bits <= LEAST_BITS:
                break
            key = record.record_id
            sent = min(self.remaining_bits[key], bits)
            bits -= sent
            self.remaining_bits[key] -= sent
            if self.remaining_bits[key] <= LEAST_BITS:
                del self.products[key], self.remaining_bits[key]
                delivered[key] = replace(record, delivery_time=float(self.satellite.simulator.sim_time))
        if bits > LEAST_BITS:
            raise ValueError(f"{bits} bit have left the store of {self.satellite.name} that belong to no image of {target_id!r}")
        return delivered


def nothing(record: RSOImageRecord, target: object) -> float:
    """Return zero, the default value of taking an image."""
    return 0.0


def priority(record: RSOImageRecord, target: Any) -> float:
    """Return the priority of the target, the default value of a complete downlink."""
    return float(target.priority)


class RSOImageReward(GlobalReward):
    """Rewards images when they are taken, and when their downlink is complete, if their quality suffices.

    A *service* of a target begins with an image of it while no other image of it waits for its downlink. At each of the two
    stages, images of a service are paid once, in the first step with some: with credit ``"shared"`` those of all imagers
    together, with ``"per_imager"`` those of each. Images paid in one step share the value. Images taken less than ``cooldown_s``
    after the last ones paid at the stage are not paid. The scenario keeps which targets wait for downlinks and cool down.

    Attributes:
        last_reward_components: Rewards of the last step by stage, ``"acquisition"`` and ``"delivery"``, and satellite.
    """

    data_store_type = RSOImageStore

    def __init__(
        self,
        acquisition_reward_fn: RewardFunction | None = None,
        delivery_reward_fn: RewardFunction | None = None,
        quality_threshold: float = 0.5,
        cooldown_s: float = 0.0,
        multi_imager_credit: str | None = None,
    ) -> None:
        """Initialize the rewarder; ValueError for a wrong argument.

        Args:
            acquisition_reward_fn: Value of taking an image, by :data:`RewardFunction`; zero by default.
            delivery_reward_fn: Value of a complete downlink; the priority of the target by default.
            quality_threshold: Least mean visible fraction of the Sun over the hold.
            cooldown_s: Time after a downlinked image for which its target cannot be chosen, s.
            multi_imager_credit: ``"shared"`` or ``"per_imager"``, required for several imagers.
        """
        super().__init__()
        for title, value in (("acquisition_reward_fn", acquisition_reward_fn), ("delivery_reward_fn", delivery_reward_fn)):
            if value is not None:
                function(title, value, "a function of an image and its target")
        if multi_imager_credit not in CREDITS:
            raise ValueError(f"multi_imager_credit={multi_imager_credit!r} must be one of {list(CREDITS)}")
        self.acquisition_reward_fn, self.delivery_reward_fn = acquisition_reward_fn or nothing, delivery_reward_fn or priority
        self.quality_threshold = number("quality_threshold", quality_threshold, 0.0, 1.0)
        self.cooldown_s = number("cooldown_s", cooldown_s, 0.0, unit="s")
        self.multi_imager_credit = multi_imager_credit

    def link_scenario(self, scenario: Any) -> None:
        """See :meth:`GlobalReward.link_scenario`; ValueError for several imagers without a kind of credit."""
        if len(scenario.imager_names) > 1 and self.multi_imager_credit is None:
            raise ValueError(
                f"imager_names={list(scenario.imager_names)}: with several imagers, RSOImageReward needs "
                "multi_imager_credit='shared' or 'per_imager'"
            )
        super().link_scenario(scenario)
        self.data_store_kwargs = {"scenario": scenario}

    def reset_overwrite_previous(self) -> None:
        """Forget the last episode."""
        super().reset_overwrite_previous()
        self._service_of: dict[str, tuple[str, int]] = {}
        self._services: dict[str, int] = {}
        self._paid: dict[str, set[Service]] = {stage: set() for stage in STAGES}
        self._last: dict[str, dict[tuple[str, str], float]] = {stage: {} for stage in STAGES}
        self.last_reward_components: dict[str, dict[str, float]] = {stage: {} for stage in STAGES}

    def calculate_reward(self, new_data_dict: dict[str, RSOImageData]) -> dict[str, float]:
        """See :meth:`GlobalReward.calculate_reward`.

        Raises:
            ValueError: For images of other satellites, downlinks of unknown images, or values that are not finite.
        """
        captures = [record for data in new_data_dict.values() for record in data.captures.values()]
        deliveries = [record for data in new_data_dict.values() for record in data.deliveries.values()]
        for name, data in new_data_dict.items():
            for record in (*data.captures.values(), *data.deliveries.values()):
                if record.source_imager != name or name not in self.scenario.imager_names:
                    raise ValueError(f"{name} has the image {record.record_id}, which {record.source_imager} has taken")
        self._begin_services([record for record in captures if record.record_id not in self._service_of])
        self._end_services(deliveries)
        parts = {
            "acquisition": self._credit("acquisition", self.acquisition_reward_fn, captures, new_data_dict),
            "delivery": self._credit("delivery", self.delivery_reward_fn, deliveries, new_data_dict),
        }
        self.last_reward_components = parts
        if captures or deliveries:
            self.scenario.revision += 1
        return {name: sum(part[name] for part in parts.values()) for name in new_data_dict}

    def _begin_services(self, new: list[RSOImageRecord]) -> None:
        pending = self.scenario.pending
        for target_id in {record.target_id for record in new}:
            if not pending.get(target_id):
                self._services[target_id] = self._services.get(target_id, 0) + 1
        for record in new:
            self._service_of[record.record_id] = record.target_id, self._services[record.target_id]
            pending.setdefault(record.target_id, set()).add(record.record_id)

    def _end_services(self, deliveries: list[RSOImageRecord]) -> None:
        scenario = self.scenario
        for record in deliveries:
            if record.record_id not in self._service_of:
                raise ValueError(f"{record.record_id} has been downlinked, but not been taken")
            scenario.pending.setdefault(record.target_id, set()).discard(record.record_id)
            if record.quality >= self.quality_threshold:
                until = scenario.cooldown_until.get(record.target_id, -math.inf)
                scenario.cooldown_until[record.target_id] = max(until, record.capture_time + self.cooldown_s)

    def _credit(
        self, stage: str, reward_fn: RewardFunction, records: list[RSOImageRecord], names: Iterable[str]
    ) -> dict[str, float]:
        reward, last, groups = dict.fromkeys(names, 0.0), self._last[stage], defaultdict[Service, list[RSOImageRecord]](list)
        for record in records:
            if record.quality >= self.quality_threshold:
                imager = record.source_imager if self.multi_imager_credit == "per_imager" else ""
                groups[(record.target_id, imager), self._service_of[record.record_id]].append(record)
        for (scope, service), group in sorted(groups.items(), key=lambda item: item[0]):
            earliest = min(record.capture_time for record in group)
            before = last.get(scope, -math.inf)
            repeated = (scope, service) in self._paid[stage]
            if repeated or earliest <= before + SAME_TIME or earliest < before + self.cooldown_s:
                continue
            target = self.scenario.targets_by_id[scope[0]]
            for record in sorted(group, key=lambda record: (record.capture_time, record.source_imager, record.record_id)):
                value = float(reward_fn(record, target))
                if not math.isfinite(value):
                    raise ValueError(f"{stage}_reward_fn(record, target) is {value} for {record.record_id}; it must be finite")
                reward[record.source_imager] += value / len(group)
            last[scope] = earliest
            self._paid[stage].add((scope, service))
        return reward
