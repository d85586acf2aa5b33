"""Rewards and measures of AEOS-Bench."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import number, switch
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.scene.recorded import RecordedProgress
from bsk_torch.sim.run.encounters import NEVER
from bsk_torch.tasks.aeos_bench.dyn import AEOSBenchTracedDynModel
from bsk_torch.tasks.aeos_bench.scene import ASSIGNED, AWAITED, AEOSBench, Sights

if TYPE_CHECKING:
    from bsk_torch.sats.bound import SatelliteFleet
    from bsk_torch.scene.base import Scenario
    from bsk_torch.sim.tick.trace import Flight

WATT_HOUR = 3600.0

CLOSENESS = 0.6, 0.2, 0.2
"""Weights of CR, PCR and WCR in the score."""


class Counts(NamedTuple):
    """What n episodes come to in K ticks, of the u tasks that are seen."""

    sights: Sights  # who sees which task at which tick, m entries
    place: Tensor  # which of the u tasks each of these is, [m]
    row: Tensor  # episode of each task, from 0 to n - 1, [u]
    task: Tensor  # its number, [u]
    viewers: Tensor  # by how many satellites it is seen, [u, K] float64
    run: Tensor  # its progress, [u, K]; see progress
    first: Tensor  # the tick at which it succeeds, [u], counted from one; NEVER for none


def task_measures(*, duration: Tensor, release: Tensor, success: Tensor, best: Tensor, energy: Tensor) -> dict[str, Tensor]:
    """Return the benchmark's measures of N episodes, [N] float64 each.

    With durations D, largest progress M, and the set S of the n tasks that have succeeded: ``CR = |S| / n``, ``WCR = sum_S D
    / sum D``, ``PCR = mean(M / D)``, ``WPCR = sum M / sum D``, ``TAT``, the mean time from release to success, s (NaN without
    success), ``PC``, the energy of the sensors of satellites with a task, W s, and ``CS = 1 / (0.6 CR + 0.2 PCR + 0.2 WCR) +
    TAT / 7 h + PC / 100 W h``, of which lower is better (NaN without success). Source: AEOS-Bench, arXiv 2510.26297.

    Args:
        duration: D of each task, s, [N, T]; 0 for those that an episode does not have.
        release: Time at which each task is released, s, [N, T].
        success: Time at which it has succeeded, s, [N, T]; negative for none.
        best: M of each task, s, [N, T].
        energy: Energy of sensors, W s, [N].
    """
    completed = success >= 0.0
    number_of, total = (duration > 0.0).sum(1).double(), duration.sum(1)
    measures = {
        "CR": completed.sum(1) / number_of,
        "WCR": (duration * completed).sum(1) / total,
        "PCR": (best / duration.clamp(min=1.0)).sum(1) / number_of,
        "WPCR": best.sum(1) / total,
        "TAT": ((success - release) * completed).sum(1) / completed.sum(1),
        "PC": energy,
    }
    weights = zip(CLOSENESS, ("CR", "PCR", "WCR"), strict=True)
    closeness = sum(weight * measures[name] for weight, name in weights)
    measures["CS"] = 1.0 / closeness + measures["TAT"] / WATT_HOUR / 7.0 + measures["PC"] / WATT_HOUR / 100.0
    return measures


def progress(visible: Tensor, before: Tensor, duration: Tensor) -> tuple[Tensor, Tensor]:
    """Return the progress of tasks at each of K ticks, [u, K], and the tick at which they succeed, [u], from one.

    Progress is the number of ticks without a gap in which a task has been visible, and zero once it has succeeded. It succeeds
    when its progress reaches its duration; :data:`NEVER` where it does not.

    Args:
        visible: Whether a satellite sees the task, and it counts, [u, K].
        before: Progress before the first tick, [u].
        duration: Ticks that the task lasts, [u].
    """
    tick = torch.arange(1, visible.shape[1] + 1, device=visible.device).expand(visible.shape)
    gap = torch.where(visible, 0, tick).cummax(1).values
    run = tick - gap + torch.where(gap == 0, before.unsqueeze(1), 0.0)
    first = torch.where(visible & (run >= duration.unsqueeze(1)), tick, NEVER).amin(1)
    return run * (tick <= first.unsqueeze(1)), first


class TaskReward(GlobalReward):
    """Counts the progress of the tasks of a :class:`bsk_torch.tasks.aeos_bench.AEOSBench`, and pays for tasks that succeed.

    In every tick, the progress of an ongoing task that a satellite sees grows by one, and that of all others is reset. A task
    succeeds when its progress reaches its duration. The reward is ``(1 - s) / n`` for a success, and ``s / n`` times the growth
    of its largest progress over the duration, with n tasks and s = ``progress_share``: by default, returns are the completion
    rate. It is divided equally among the satellites that see the task at that time.

    With ``end_when_closed``, an episode terminates once every task has succeeded or is overdue, and in flights second by second
    those that have just succeeded are no longer offered. Nothing is left to count then: measures are those of the whole hour, if
    satellites without an offered task point at none. Of a policy that ignores ``action_mask``, PC lacks what it would spend on
    closed tasks until the end of the hour.
    """

    scenario: AEOSBench

    def __init__(self, progress_share: float = 0.0, end_when_closed: bool = False) -> None:
        """Choose what is paid; ValueError unless ``progress_share`` is from 0 to 1."""
        self.progress_share = number("progress_share", progress_share, 0.0, 1.0)
        self.end_when_closed = switch("end_when_closed", end_when_closed)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; ValueError for another scenario."""
        super().link(scenario, fleet)
        if not isinstance(scenario, AEOSBench):
            raise ValueError(f"TaskReward needs an AEOSBench; the scenario is {type(scenario).__name__}")
        fleet.memory.declare("sensor_energy", 0.0)
        self._earned = self._nothing()
        self._traced = all(isinstance(satellite.dynamics, AEOSBenchTracedDynModel) for satellite in fleet.satellites)
        if self._traced:
            fleet.flight_observers.append(self._look)
        if self._traced and any(AWAITED in satellite.simulator.memory for satellite in fleet.satellites):
            fleet.stop_conditions.append(self._first_success)

    @override
    def recorded(self, env: int) -> RecordedProgress:
        return RecordedProgress(marks={"done": self.scenario.task_succeeded[env].cpu()})

    def is_terminated(self) -> Tensor:
        """See :meth:`GlobalReward.is_terminated`; all satellites, once all tasks are closed, with ``end_when_closed``."""
        if not self.end_when_closed:
            return super().is_terminated()
        scenario = self.scenario
        awaited = (
            scenario.task_exists & ~scenario.task_succeeded & (scenario.task_time.unsqueeze(1) <= scenario.drawn("task_due"))
        )
        remaining = awaited if self._traced else awaited | scenario.task_offered
        return ~remaining.any(1, keepdim=True).expand(self.fleet.shape)

    # -- counting -----------------------------------------------------------------------------------------------------

    def _first_success(self, flight: Flight) -> Tensor:
        """Return the first tick of a flight at which a task succeeds that ends the choice of a satellite, [n]."""
        ends, fleet = torch.full_like(flight.ticks, NEVER), self.fleet
        if not int(flight.ticks.max()):
            return ends
        counts = self._counts_of(flight)
        first = torch.full((len(ends), self.scenario.n_tasks), NEVER, device=ends.device)
        first[counts.row, counts.task] = counts.first
        for k, satellite in enumerate(fleet.satellites):
            if AWAITED in satellite.simulator.memory:
                task = satellite.simulator.memory[AWAITED].view(fleet.num_envs, flight.counts[k])[flight.envs]
                ends = torch.minimum(ends, torch.where(task >= 0, first.gather(1, task.clamp(min=0)), NEVER).amin(1))
        return ends

    def _look(self, flight: Flight) -> None:
        if len(flight.envs) and int(flight.ticks.max()):
            self._add(flight.envs, flight.ticks, self._counts_of(flight))

    def _counts_of(self, flight: Flight) -> Counts:
        scenario, fleet, envs, K = self.scenario, self.fleet, flight.envs, int(flight.ticks.max())
        tick = torch.arange(1, K + 1, device=fleet.device)
        ongoing = scenario.timely(envs, (flight.since.unsqueeze(1) + tick).double() * fleet.h)
        ongoing = ongoing & (tick <= flight.ticks.unsqueeze(1)).unsqueeze(2) & ~scenario.task_succeeded[envs].unsqueeze(1)
        views, on = scenario.flown_views(flight, K), scenario.sensor_in_mode[envs]
        return self._counts(envs, scenario.sights(envs, views, flight.ticks, on, ongoing), K)

    def _counts(self, envs: Tensor, sights: Sights, ticks: int) -> Counts:
        """Return the counts of the episodes ``envs`` [n] at so many ticks with the given sights."""
        number_of = self.scenario.n_tasks
        key, place = (sights.episode * number_of + sights.task).unique(return_inverse=True)
        row, task = key // number_of, key % number_of
        viewers = torch.zeros(len(key), ticks, dtype=torch.float64, device=envs.device)
        viewers = viewers.index_put((place, sights.tick), torch.ones_like(place, dtype=torch.float64), accumulate=True)
        before, duration = self.memory["task_progress"], self.scenario.drawn("task_duration")
        run, first = progress(viewers > 0.0, before[envs[row], task], duration[envs[row], task])
        return Counts(sights, place, row, task, viewers, run, first)

    def _add(self, envs: Tensor, ran: Tensor, counts: Counts) -> None:
        """Add what the episodes ``envs`` [n] have come to in ``ran`` ticks, [n]."""
        scenario, memory, fleet, share = self.scenario, self.memory, self.fleet, self.progress_share
        where = envs[counts.row], counts.task
        old = memory["task_best"][where].unsqueeze(1)
        best = torch.cat([old, torch.maximum(old, counts.run)], 1).cummax(1).values
        fresh = torch.arange(1, counts.run.shape[1] + 1, device=ran.device) == counts.first.unsqueeze(1)
        growth = best.diff(dim=1) / scenario.drawn("task_duration")[where].unsqueeze(1)
        worth = ((1.0 - share) * fresh + share * growth) / scenario.task_exists.sum(1)[where[0]].unsqueeze(1)
        final = counts.run.gather(1, (ran[counts.row] - 1).unsqueeze(1)).squeeze(1)
        time = (fleet.since[where[0]] + counts.first).double() * fleet.h
        before = torch.where((ran > 0).unsqueeze(1), 0.0, memory["task_progress"][envs])
        memory["task_progress"] = memory["task_progress"].index_copy(0, envs, before).index_put(where, final)
        memory["task_best"] = memory["task_best"].index_put(where, best[:, -1])
        success = torch.where(counts.first < NEVER, time, memory["task_success"][where])
        memory["task_success"] = memory["task_success"].index_put(where, success)
        energy = self._energy()[envs] * fleet.h * ran
        memory["sensor_energy"] = memory["sensor_energy"].index_add(0, envs, energy)
        row, at, satellite, _ = counts.sights
        payments = (worth / counts.viewers.clamp(min=1.0))[counts.place, at]
        self._earned = self._earned.index_put((envs[row], satellite), payments, accumulate=True)

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`; RuntimeError for steps longer than a tick of satellites without traces."""
        fleet = self.fleet
        if not self._traced:
            ran = fleet.ticks - fleet.since
            if int(ran.max()) > 1:
                raise RuntimeError(
                    "TaskReward counts in every tick, but this step had more; use only PointAtTask, which lasts one "
                    "tick, or satellites with AEOSBenchTracedDynModel"
                )
            visible = torch.stack(self.scenario.task_visible())
            episode, satellite, task = visible[:, ran[visible[0]] > 0]
            sights = Sights(episode, torch.zeros_like(task), satellite, task)
            self._add(fleet.all_envs, ran, self._counts(fleet.all_envs, sights, 1))
        else:
            self._ask_those_done()
        earned, self._earned = self._earned, self._nothing()
        return self.of_channel(earned)

    def _nothing(self) -> Tensor:
        return torch.zeros(self.fleet.shape, dtype=torch.float64, device=self.fleet.device)

    def _ask_those_done(self) -> None:
        """Let satellites choose again whose choice ends with its task, which succeeds now."""
        for satellite in self.fleet.satellites:
            simulator, task = satellite.simulator, satellite.task
            if AWAITED in simulator.memory:
                awaited = simulator.memory[AWAITED]
                success = simulator.look_up(self.memory["task_success"], awaited.clamp(min=0).unsqueeze(1)).squeeze(1)
                done = (awaited >= 0) & (success == simulator.ticks.double() * simulator.h) & ~task.dead
                task.requires_retasking = task.requires_retasking | done

    def _energy(self) -> Tensor:
        """Return the power of the sensors of satellites with a task, [N] W."""
        assigned = self.fleet.each(lambda s: s.simulator.memory[ASSIGNED]) >= 0
        power = self.fleet.each(lambda s: -s.simulator.argument("sensorPower"))
        return (assigned * power).sum(1)

    def measures(self) -> dict[str, Tensor]:
        """Return :func:`task_measures` of the current episodes, [N] float64 each."""
        scenario, memory = self.scenario, self.memory
        return task_measures(
            duration=scenario.drawn("task_duration"),
            release=scenario.drawn("task_release"),
            success=memory["task_success"],
            best=memory["task_best"],
            energy=memory["sensor_energy"],
        )
