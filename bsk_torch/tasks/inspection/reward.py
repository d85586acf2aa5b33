"""Reward for inspecting the points of a resident space object (RSO)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, switch
from bsk_torch.constants import NANO
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.data.images import spread
from bsk_torch.scene.recorded import RecordedProgress
from bsk_torch.sim.state import FINITE
from bsk_torch.sim.tick.trace import Flight
from bsk_torch.tasks.inspection.flags import Records, find_flags
from bsk_torch.tasks.inspection.scene import RSOPoints

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario

KINDS = ("inspected", "illuminated")
"""Flags known of a point."""

NEVER = -1.0
"""Time of completion of an incomplete inspection, s."""


class RSOInspectionData(NamedTuple):
    """Knowledge of the points of RSOs, of all satellites together [N, P] or of the satellites of one type [N * count, P].

    Attributes:
        inspected: Inspected points, bool.
        illuminated: Points lit at any time, bool.
    """

    inspected: Tensor
    illuminated: Tensor


class InspectionStore(NamedTuple):
    """The ``data_store`` of satellites; ``data`` is its content."""

    data: RSOInspectionData


class _StepFlags(NamedTuple):
    """Points of a step: episodes that took part [N], and points [N, S, P] inspected, or seen lit, by satellites."""

    moved: Tensor
    inspected: Tensor
    illuminated: Tensor


class RSOInspectionReward(GlobalReward):
    """Reward for the first inspection of every point of an RSO, and for completing the inspection.

    A satellite that inspects k of the P points not inspected before the step receives ``inspection_reward_scale * k / P``. If two
    satellites inspect the same point in one step, both are rewarded. The scenario must be a
    :class:`RSOPoints`. For the conditions of an inspection, see :mod:`bsk_torch.tasks.inspection.flags`.

    The inspection is complete at the end of the first step in which enough points have been lit, and enough of these inspected::

        lit >= min_illuminated_for_completion * P, or sim_time > min_time_for_completion
        inspected >= completion_threshold * lit

    where ``lit`` and ``inspected`` are the numbers of points lit and inspected at any time in the episode. Every satellite of the
    environment, including the RSO, then receives ``completion_bonus``, once; in a channel of a
    :class:`~bsk_torch.data.MixedReward`, every satellite of the channel. At least one point must have been lit, except
    under ``compat="bsk_rl"``.

    Points in view or lit at time zero do not count, because the RSO has no attitude before the execution of its first command.
    Under ``compat="bsk_rl"``, its attitude is zero in the first two records of an episode; points seen then count as inspected
    and, depending on rounding, also as lit.

    Dead satellites continue to inspect: their points earn no reward, but count toward completion.
    """

    def __init__(
        self,
        inspection_reward_scale: float = 1.0,
        completion_bonus: float = 0.0,
        completion_threshold: float = 0.90,
        min_illuminated_for_completion: float = 0.4,
        min_time_for_completion: float = 5700.0,
        terminate_on_completion: bool = True,
    ) -> None:
        """Choose what is paid; ValueError for a wrong argument.

        Args:
            inspection_reward_scale: Reward for inspecting all points.
            completion_bonus: Reward of each satellite for completing the inspection.
            completion_threshold: Fraction of the lit points to inspect for completion.
            min_illuminated_for_completion: Fraction of all points that must have been lit for completion before
                ``min_time_for_completion``.
            min_time_for_completion: Time after which the inspection can be complete regardless of the number of lit points, s.
            terminate_on_completion: Whether completion terminates the episode.
        """
        self.inspection_reward_scale = number("inspection_reward_scale", inspection_reward_scale)
        self.completion_bonus = number("completion_bonus", completion_bonus)
        self.completion_threshold = number("completion_threshold", completion_threshold, 0.0)
        self.min_illuminated_for_completion = number("min_illuminated_for_completion", min_illuminated_for_completion, 0.0, 1.0)
        self.min_time_for_completion = number("min_time_for_completion", min_time_for_completion, unit="s", finite=False)
        self.terminate_on_completion = switch("terminate_on_completion", terminate_on_completion)

    @property
    @override
    def observed_columns(self) -> list[int]:
        return self._points.inspector_columns

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError for a scenario without points."""
        super().link(scenario, fleet)
        if not isinstance(scenario, RSOPoints):
            raise ValueError(
                f"RSOInspectionReward needs a scenario with points, such as SphericalRSO; the scenario is "
                f"{type(scenario).__name__}"
            )
        self._points: RSOPoints = scenario
        self._step: _StepFlags | None = None
        shape = fleet.size, scenario.n_points
        for kind in KINDS:
            self.memory.declare(f"{kind}_points", False, shape[1])
            self.memory.declare(f"known_{kind}", False, *shape)
        self.memory.declare("inspection_bonus_time", NEVER, low=NEVER, high=FINITE)
        fleet.flight_observers.append(self._look)

    # -- what a step shows --------------------------------------------------------------------------------------------

    def _look(self, flight: Flight) -> None:
        """Record the points of the episodes of a flight."""
        fleet, scenario, step = self.fleet, self._points, self._step
        if step is None:
            none = torch.zeros(fleet.num_envs, fleet.size, scenario.n_points, dtype=torch.bool, device=fleet.device)
            step = self._step = _StepFlags(torch.zeros_like(none[:, 0, 0]), none, none.clone())
        step.moved[flight.envs] = True
        if not len(flight.envs) or not int(flight.ticks.max()):
            return
        n, points = len(flight.envs), scenario.columns
        for k in scenario.inspector_types:
            columns = points if points.ndim == 2 else points[:, flight.envs.repeat_interleave(flight.counts[k])]
            flags = find_flags(columns, self._records(flight, k), fleet.simulators[k].type.options.backend == "compiled")
            for table, new in zip((step.inspected, step.illuminated), flags, strict=True):
                entries = new.view(n, flight.counts[k], -1)
                if fleet.present is not None:
                    present = fleet.present[flight.envs]
                    pairs = present[:, fleet.columns[k]] & present[:, fleet.columns[scenario.rso_type]]
                    entries = entries & pairs.unsqueeze(-1)
                table[flight.envs.unsqueeze(-1), fleet.columns[k]] = entries

    def _records(self, flight: Flight, k: int) -> Records:
        chief, inspectors = flight.traces[self._points.rso_type], flight.traces[k]
        assert chief is not None
        assert inspectors is not None
        count = flight.counts[k]
        episodes = torch.arange(len(flight.envs), device=flight.envs.device).repeat_interleave(count)
        pairs = torch.arange(len(episodes), device=flight.envs.device)
        of_pairs = (part.repeat_interleave(count) for part in (flight.ticks, *self._first_records(flight)))
        return Records(chief, episodes, inspectors, pairs, *of_pairs)

    def _first_records(self, flight: Flight) -> tuple[Tensor, Tensor]:
        """Return the first record in which points may be inspected, and the first in which they may be lit, [n] each."""
        begins, zero = flight.since == 0, torch.zeros_like(flight.since)
        simulator = self.fleet.simulators[0]
        if not simulator.type.compat:
            first = torch.where(begins, 1, zero)
            return first, first
        # BSK-RL recognizes the first step of an episode by this difference, which rounding sometimes makes fail
        time, n = (flight.ticks * simulator.h_ns).double() * NANO, flight.ticks.double()
        return zero, torch.where(begins & (time - simulator.h * n == 0.0), 2, zero)

    # -- knowledge ----------------------------------------------------------------------------------------------------

    @property
    def inspected(self) -> Tensor:
        """Points inspected in the current episodes, [N, P] bool."""
        return self.memory["inspected_points"]

    @property
    def illuminated(self) -> Tensor:
        """Points lit in the current episodes, whether or not observed, [N, P] bool."""
        return self.memory["illuminated_points"]

    @property
    def known(self) -> RSOInspectionData:
        """Knowledge of each satellite, including knowledge received by communication, [N, S, P] each."""
        return RSOInspectionData(*(self.memory[f"known_{kind}"] for kind in KINDS))

    @property
    def bonus_reward_time(self) -> Tensor:
        """Time at which the inspection was completed, [N] s; NaN before."""
        return torch.where(self.bonus_reward_yielded, self.memory["inspection_bonus_time"], torch.nan)

    @property
    def bonus_reward_yielded(self) -> Tensor:
        """Whether the inspection has been completed, [N] bool."""
        return self.memory["inspection_bonus_time"] != NEVER

    def store_of(self, part: int) -> InspectionStore:
        """Return the knowledge of the satellites of type number ``part``, [N * count, P], their ``data_store``."""
        return InspectionStore(RSOInspectionData(*(self.fleet.rows_of(part, table) for table in self.known)))

    def share(self, links: Tensor) -> None:
        """See :meth:`GlobalReward.share`; knowledge spreads along one link in a step."""
        for kind in KINDS:
            self.memory[f"known_{kind}"] = spread(self.memory[f"known_{kind}"], links)

    @override
    def recorded(self, env: int) -> RecordedProgress:
        return RecordedProgress(
            kind="inspection",
            marks={"done": self.inspected[env].cpu(), "lit": self.illuminated[env].cpu()},
            completed=float(self.bonus_reward_time[env]) if bool(self.bonus_reward_yielded[env]) else None,
        )

    # -- reward -------------------------------------------------------------------------------------------------------

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        step, self._step = self._step, None
        fleet, memory = self.fleet, self.memory
        if step is None:  # a trial, without a run
            return torch.zeros(fleet.num_envs, fleet.size, dtype=torch.float64, device=fleet.device)
        new = (step.inspected & ~self.inspected.unsqueeze(1)).sum(2).double()
        for kind, points in zip(KINDS, (step.inspected, step.illuminated), strict=True):
            memory[f"{kind}_points"] = memory[f"{kind}_points"] | points.any(1)
            memory[f"known_{kind}"] = memory[f"known_{kind}"] | points
        completed = self._completed() & step.moved & ~self.bonus_reward_yielded
        memory["inspection_bonus_time"] = torch.where(completed, fleet.sim_time, memory["inspection_bonus_time"])
        reward = new * (self.inspection_reward_scale / self._points.n_points)
        bonus = self.completion_bonus * completed.double().unsqueeze(1)
        return reward + self.of_channel(bonus.expand_as(reward))

    def _completed(self) -> Tensor:
        inspected, lit = (points.sum(1).double() for points in (self.inspected, self.illuminated))
        enough = (lit >= self.min_illuminated_for_completion * self._points.n_points) | (
            self.fleet.sim_time > self.min_time_for_completion
        )
        something = torch.ones_like(enough) if self.fleet.simulators[0].type.compat else lit > 0.0
        return enough & something & (inspected >= self.completion_threshold * lit)

    def is_terminated(self) -> Tensor:
        """See :meth:`GlobalReward.is_terminated`; all satellites of completed episodes."""
        ends = self.bonus_reward_yielded & self.terminate_on_completion
        return ends.unsqueeze(1).expand(-1, self.fleet.size)
