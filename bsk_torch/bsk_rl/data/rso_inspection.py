"""Reward for inspecting the points of another spacecraft; counterpart of ``bsk_rl.data.rso_inspection``."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from bsk_torch.bsk_rl.data.base import Data, DataStore, GlobalReward
from bsk_torch.bsk_rl.scene.rso_points import RSOPoint
from bsk_torch.bsk_rl.sim.inspection import Found
from bsk_torch.tasks.inspection import RSOInspectorDynModel

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


logger = logging.getLogger(__name__)

RSO = "rso"
INSPECTOR = "inspector"

Status = dict[RSOPoint, bool]
"""Whether something is true of each point; points may be missing."""


class RSOInspectionData(Data):
    """Points that have been inspected, and that have been lit."""

    def __init__(
        self,
        point_inspect_status: Mapping[RSOPoint, bool] | None = None,
        point_illuminate_status: Mapping[RSOPoint, bool] | None = None,
    ) -> None:
        """Initialize with the status of points; empty by default."""
        self.point_inspect_status: Status = dict(point_inspect_status or {})
        self.point_illuminate_status: Status = dict(point_illuminate_status or {})

    def __add__(self, other: RSOInspectionData) -> RSOInspectionData:
        return RSOInspectionData(
            _either(self.point_inspect_status, other.point_inspect_status),
            _either(self.point_illuminate_status, other.point_illuminate_status),
        )

    @property
    def num_points_inspected(self) -> int:
        """Number of points that have been inspected."""
        return sum(self.point_inspect_status.values())

    @property
    def num_points_illuminated(self) -> int:
        """Number of points that have been lit."""
        return sum(self.point_illuminate_status.values())

    def __repr__(self) -> str:
        return f"RSOInspectionData(inspected={self.num_points_inspected}, illuminated={self.num_points_illuminated})"


def _either(one: Status, other: Status) -> Status:
    return one | {point: one.get(point, False) or status for point, status in other.items()}


class RSOInspectionDataStore(DataStore):
    """Reads the points inspected in a step from ``scenario.inspection``; the RSO itself, by its ``role``, inspects none."""

    data_type = RSOInspectionData

    @override
    def __init__(self, satellite: Satellite, initial_data: object = None) -> None:
        super().__init__(satellite, initial_data)
        self.role = INSPECTOR if issubclass(self.satellite.dyn_type, RSOInspectorDynModel) else RSO
        self.scenario: Any = None

    def get_log_state(self) -> Found | None:
        """Return the points that the inspector has found since the last call, [P] bool each."""
        return self.scenario.inspection.take(self.satellite.core_row) if self.role == INSPECTOR else None

    def compare_log_states(self, _: Found | None, logs: Found | None) -> RSOInspectionData:
        """Return the points that were found."""
        if logs is None:
            return RSOInspectionData()
        tables = self.data.point_inspect_status, self.data.point_illuminate_status
        inspected, lit = (
            {point: True for point, flag in zip(table, flags, strict=True) if flag}
            for table, flags in zip(tables, logs, strict=True)
        )
        if inspected:
            self.satellite.logger.info("Inspected %d points this step", len(inspected))
        return RSOInspectionData(inspected, lit)


class RSOInspectionReward(GlobalReward):
    """Rewards the first inspection of each point, and once the completion of the inspection.

    A satellite that inspects k of P points that had not been inspected before the step gets ``inspection_reward_scale * k / P``;
    two that inspect the same point in one step are both paid. The inspection is complete when ``completion_threshold`` of the
    points that have been lit are inspected, and ``min_illuminated_for_completion`` of all points have been lit or
    ``min_time_for_completion`` s have passed. Every satellite then gets ``completion_bonus``, the RSO included.

    Attributes:
        bonus_reward_yielded: Whether the inspection has been completed in the episode.
        bonus_reward_time: Time of completion, s; None before.
    """

    data_store_type = RSOInspectionDataStore

    def __init__(
        self,
        inspection_reward_scale: float = 1.0,
        completion_bonus: float = 0.0,
        completion_threshold: float = 0.90,
        min_illuminated_for_completion: float = 0.4,
        min_time_for_completion: float = 5700,
        terminate_on_completion: bool = True,
    ) -> None:
        """Initialize the rewarder.

        Args:
            inspection_reward_scale: Reward for inspecting all points.
            completion_bonus: Reward of each satellite when the inspection is complete.
            completion_threshold: Fraction of the points lit so far that must be inspected for completion.
            min_illuminated_for_completion: Fraction of all points that must have been lit for completion before
                ``min_time_for_completion``.
            min_time_for_completion: Time after which the previous condition no longer applies, s.
            terminate_on_completion: Whether the episode terminates on completion.
        """
        super().__init__()
        self.inspection_reward_scale, self.completion_bonus = inspection_reward_scale, completion_bonus
        self.completion_threshold, self.min_illuminated_for_completion = completion_threshold, min_illuminated_for_completion
        self.min_time_for_completion, self.terminate_on_completion = min_time_for_completion, terminate_on_completion

    def reset_overwrite_previous(self) -> None:
        """Forget the last episode."""
        super().reset_overwrite_previous()
        self.bonus_reward_yielded = False
        self.bonus_reward_time: float | None = None

    def reset_post_sim_init(self) -> None:
        """Let the stores of inspectors read the scenario."""
        super().reset_post_sim_init()
        for inspector in self.scenario.inspectors:
            parts = getattr(inspector.data_store, "data_stores", (inspector.data_store,))
            for store in parts.values() if isinstance(parts, Mapping) else parts:
                if isinstance(store, RSOInspectionDataStore):
                    store.scenario = self.scenario

    def initial_data(self, satellite: Satellite) -> RSOInspectionData:
        """Return all points as neither inspected nor lit, for inspectors."""
        if not issubclass(satellite.dyn_type, RSOInspectorDynModel):
            return RSOInspectionData()
        return RSOInspectionData(*(dict.fromkeys(self.scenario.rso_points, False) for _ in range(2)))

    def determine_point_colors(self, total_data: RSOInspectionData, new_data_dict: dict[str, RSOInspectionData]) -> None:
        """Choose the colors of points in Vizard."""

    def update_point_colors(self, rso_points: list[RSOPoint], colors: object, alpha: float = 0.5) -> None:
        """Color points in Vizard."""

    @override
    def calculate_reward(self, new_data_dict: dict[str, RSOInspectionData]) -> dict[str, float]:
        before, total, reward = self.data.point_inspect_status, self.data_type() + self.data, {}
        for name, data in new_data_dict.items():
            new = sum(inspected and not before.get(point, False) for point, inspected in data.point_inspect_status.items())
            reward[name] = new / len(self.scenario.rso_points) * self.inspection_reward_scale
            total += data
        if self._completed(total) and not self.bonus_reward_yielded:
            logger.info("The inspection is complete: %s. Every satellite gets %g.", total, self.completion_bonus)
            for name in self.cum_reward:
                reward[name] = reward.get(name, 0.0) + self.completion_bonus
            self.bonus_reward_yielded, self.bonus_reward_time = True, self._sim_time
        return reward

    @property
    def _sim_time(self) -> float:
        return self.scenario.satellites[0].simulator.sim_time

    def _completed(self, total: RSOInspectionData) -> bool:
        lit, points = total.num_points_illuminated, len(self.scenario.rso_points)
        enough = lit >= points * self.min_illuminated_for_completion or self._sim_time > self.min_time_for_completion
        return enough and total.num_points_inspected >= self.completion_threshold * lit

    def is_terminated(self, satellite: object) -> bool:
        """See :meth:`GlobalReward.is_terminated`; all satellites, when the inspection is complete."""
        return self.bonus_reward_yielded and self.terminate_on_completion
