"""Rewards and measures of AEOS-Bench."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.scene.aeos_bench import ASSIGNED, AEOSBench

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.scene.base import Scenario

WATT_HOUR = 3600.0

CLOSENESS = 0.6, 0.2, 0.2
"""Weights of CR, PCR and WCR in the score."""


class TaskReward(GlobalReward):
    """Counts the progress of the tasks of a :class:`bsk_torch.scene.AEOSBench`, and pays for tasks that succeed.

    In every tick, the progress of an ongoing task that a satellite sees grows by one, and that of all others is reset. A task
    succeeds when its progress reaches its duration. The reward is ``(1 - s) / n`` for a success, and ``s / n`` times the growth
    of its largest progress over the duration, with n tasks and s = ``progress_share``: by default, returns are the completion
    rate. It is divided equally among the satellites that see the task at that time.
    """

    scenario: AEOSBench

    def __init__(self, progress_share: float = 0.0) -> None:
        """ValueError unless ``progress_share`` is from 0 to 1."""
        self.progress_share = number("progress_share", progress_share, 0.0, 1.0)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError for another scenario."""
        super().link(scenario, fleet)
        if not isinstance(scenario, AEOSBench):
            raise ValueError(f"data.TaskReward needs a scene.AEOSBench; the scenario is {type(scenario).__name__}")
        fleet.memory.declare("sensor_energy", 0.0)

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`; RuntimeError for steps longer than a tick."""
        scenario, memory, fleet = self.scenario, self.memory, self.fleet
        ran = fleet.ticks - fleet.since
        if int(ran.max()) > 1:
            raise RuntimeError(
                "data.TaskReward counts in every tick, but this step had more; use only act.PointAtTask, which lasts one tick"
            )
        moved = (ran > 0).unsqueeze(1)
        episode, satellite, task = scenario.task_visible()
        ones = torch.ones(len(task), dtype=torch.float64, device=fleet.device)
        seen = torch.zeros_like(memory["task_progress"]).index_put((episode, task), ones, accumulate=True)
        progress = torch.where(moved, (memory["task_progress"] + 1.0) * (seen > 0.0), memory["task_progress"])
        best = torch.maximum(memory["task_best"], progress)
        duration, exists = scenario.drawn("task_duration"), scenario.task_exists
        fresh = moved & exists & (progress >= duration) & ~scenario.task_succeeded
        share = self.progress_share
        growth = torch.where(exists, (best - memory["task_best"]) / duration.clamp(min=1.0), 0.0)
        worth = ((1.0 - share) * fresh + share * growth) / exists.sum(1, keepdim=True)
        memory["task_progress"], memory["task_best"] = progress, best
        memory["task_success"] = torch.where(fresh, scenario.task_time.unsqueeze(1), memory["task_success"])
        memory["sensor_energy"] = memory["sensor_energy"] + self._energy() * fleet.h * ran
        share_of_each = (worth / seen.clamp(min=1.0))[episode, task]
        earned = torch.zeros(fleet.shape, dtype=torch.float64, device=fleet.device)
        return self.of_channel(earned.index_put((episode, satellite), share_of_each, accumulate=True))

    def _energy(self) -> Tensor:
        """Return the power of the sensors of satellites with a task, [N] W."""
        assigned = self.fleet.each(lambda s: s.simulator.memory[ASSIGNED]) >= 0
        power = self.fleet.each(lambda s: -s.simulator.argument("sensorPower"))
        return (assigned * power).sum(1)

    def measures(self) -> dict[str, Tensor]:
        """Return the benchmark's measures of the current episodes, [N] float64 each.

        With durations D, largest progress M, and the set S of the n tasks that have succeeded: ``CR = |S| / n``, ``WCR = sum_S D
        / sum D``, ``PCR = mean(M / D)``, ``WPCR = sum M / sum D``, ``TAT``, the mean time from release to success, s (NaN without
        success), ``PC``, the energy of the sensors of satellites with a task, W s, and ``CS = 1 / (0.6 CR + 0.2 PCR + 0.2 WCR) +
        TAT / 7 h + PC / 100 W h``, of which lower is better (NaN without success).
        """
        scenario, memory = self.scenario, self.memory
        duration, exists, done = scenario.drawn("task_duration"), scenario.task_exists, scenario.task_succeeded
        best, number_of = memory["task_best"], exists.sum(1).double()
        whole = duration.sum(1)
        measures = {
            "CR": done.sum(1) / number_of,
            "WCR": (duration * done).sum(1) / whole,
            "PCR": torch.where(exists, best / duration.clamp(min=1.0), 0.0).sum(1) / number_of,
            "WPCR": best.sum(1) / whole,
            "TAT": ((memory["task_success"] - scenario.drawn("task_release")) * done).sum(1) / done.sum(1),
            "PC": memory["sensor_energy"],
        }
        weights = zip(CLOSENESS, ("CR", "PCR", "WCR"), strict=True)
        closeness = sum(weight * measures[name] for weight, name in weights)
        measures["CS"] = 1.0 / closeness + measures["TAT"] / WATT_HOUR / 7.0 + measures["PC"] / WATT_HOUR / 100.0
        return measures
