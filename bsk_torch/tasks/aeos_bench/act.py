"""Pointing the sensor at a task, as in AEOS-Bench."""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import switch, whole
from bsk_torch.act.base import Decision, positive_duration
from bsk_torch.act.candidates import CandidateAction
from bsk_torch.sats.bound import BoundSatellite
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.aeos_bench.dyn import AEOSBenchTracedDynModel
from bsk_torch.tasks.aeos_bench.scene import ASSIGNED, AWAITED, NO_TASK, PLACES, AEOSBench

SENSORS = ("assigned", "on", "chosen")


class PointAtTask(CandidateAction):
    """Points the sensor at a task; action 0 points at the Earth's center, action k at task k - 1, or at the k-th candidate.

    What is chosen at a time acts from the next tick on, as in the benchmark. A task that is not offered can be pointed at, but
    ``action_mask`` excludes it: see :attr:`offered`.
    """

    first_is_legal = True
    aim = ASSIGNED

    def __init__(
        self,
        sensor: Literal["assigned", "on", "chosen"] = "assigned",
        name: str = "point",
        n_candidates: int | None = None,
        duration: float | None = None,
        until_done: bool = False,
    ) -> None:
        """Provide an action for each task or candidate, and one for none.

        Args:
            sensor: ``"assigned"``: the sensor is on while a task is chosen. ``"on"``: it is always on, as under the benchmark's
                rule. ``"chosen"``: there are twice as many actions; the second half are the same with the sensor on, the first
                with the sensor off.
            name: Name in ``action_description``.
            n_candidates: Number of candidates of each satellite to choose from, see
                :meth:`bsk_torch.tasks.aeos_bench.AEOSBench.candidates`; None for all tasks of the scenario.
            duration: Time until the next decision, s (default: one tick, as in the benchmark). Choices that last longer than a
                tick need satellites with :class:`bsk_torch.tasks.aeos_bench.AEOSBenchTracedDynModel`, and still count in every
                tick.
            until_done: Whether a choice ends earlier once its task has succeeded, whoever saw it, or is overdue.
        """
        super().__init__(name)
        self.n_candidates = None if n_candidates is None else whole("n_candidates", n_candidates, 1)
        self.duration = None if duration is None else positive_duration("duration", duration, name, math.inf)
        self.sensor = one_of("sensor", sensor, SENSORS)
        self.until_done = switch("until_done", until_done)

    @property
    @override
    def target_actions(self) -> range:
        return range(0) if self.n_candidates is None or self.sensor == "chosen" else range(1, self.n_actions)

    def link_satellite(self, satellite: BoundSatellite) -> None:
        """See :meth:`Action.link_satellite`; ValueError unless the scenario has tasks of AEOS-Bench."""
        super().link_satellite(satellite)
        if PLACES not in satellite.simulator.scenario_state:
            raise ValueError(f"PointAtTask {self.name!r} needs AEOSBench as the scenario of the environment")
        traced = isinstance(satellite.dynamics, AEOSBenchTracedDynModel)
        if self.duration is not None and self.duration > satellite.simulator.h and not traced:
            raise ValueError(
                f"PointAtTask {self.name!r}: duration={self.duration:g} s is longer than a tick of {satellite.simulator.h:g} "
                "s; give the satellite dyn_type = AEOSBenchTracedDynModel, which records all ticks"
            )
        for command in ("sensor_off", "sensor_on"):
            satellite.simulator.check_command(command)
        self._choices = 1 + (self.n_candidates or satellite.simulator.scenario_state[PLACES].shape[1])
        self.n_actions = self._choices * (2 if self.sensor == "chosen" else 1)
        for name in (ASSIGNED, AWAITED) if self.until_done else (ASSIGNED,):
            satellite.simulator.memory.declare(name, NO_TASK, low=NO_TASK)

    @property
    def _scenario(self) -> AEOSBench:
        scenario: AEOSBench = self.satellite.scenario
        return scenario

    @property
    def offered(self) -> Tensor:
        """Which tasks can be chosen, [N, T]: the ongoing ones, and for choices of one tick those that have just succeeded."""
        return self._scenario.task_offered if self.duration is None else self._scenario.task_ongoing

    @override
    def names(self) -> list[str]:
        names = [f"{self.name}_none", *(f"{self.name}_{k}" for k in range(self._choices - 1))]
        return names if self.sensor != "chosen" else [*(f"{name}_off" for name in names), *(f"{name}_on" for name in names)]

    @override
    def candidates(self) -> tuple[Tensor, Tensor]:
        fleet, candidates = self._scenario.fleet, self._scenario.candidates(self._choices - 1)
        task, exists = (fleet.rows_of(self.satellite.type_index, part) for part in (candidates.task, candidates.exists))
        return task, exists

    @override
    def mask(self) -> Tensor:
        offered = self.offered if self.n_candidates is None else self.candidates()[1]
        legal = torch.cat([torch.ones_like(offered[:, :1]), offered], 1)
        legal = self.satellite.of_env(legal) if self.n_candidates is None else legal
        return torch.cat([legal, legal], 1) if self.sensor == "chosen" else legal

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        simulator, choice = self.satellite.simulator, index % self._choices - 1
        task = choice
        if self.n_candidates is not None:
            number, exists = self.chosen(choice.clamp(min=0))
            task = torch.where((choice >= 0) & exists, number, NO_TASK)
        off, on = (torch.full_like(index, simulator.mode_names.index(name)) for name in ("sensor_off", "sensor_on"))
        if self.sensor == "on":
            mode = on
        else:
            mode = torch.where(task >= 0 if self.sensor == "assigned" else index >= self._choices, on, off)
        duration = torch.full_like(simulator.sim_time, self.duration or simulator.h)
        if self.until_done:
            due = simulator.look_up(self._scenario.drawn("task_due"), task.clamp(min=0).unsqueeze(1)).squeeze(1)
            remaining = (due - simulator.ticks.double() * simulator.h).clamp(min=0.0) + simulator.h
            duration = torch.where(task >= 0, torch.minimum(duration, remaining), duration)
        return Decision(mode, torch.ones_like(mask), duration, action, duration, task)

    def begin(self, mask: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`: set the place."""
        simulator, task = self.satellite.simulator, decision.command
        assert task is not None
        chosen = task.clamp(min=0)
        place = simulator.look_up(self._scenario.drawn(PLACES), chosen.unsqueeze(1)).squeeze(1)
        simulator.write("r_LP_P", mask, torch.where((task >= 0).unsqueeze(1), place, 0.0))
        memory = simulator.memory
        for name in (ASSIGNED, AWAITED) if self.until_done else (ASSIGNED,):
            memory[name] = torch.where(mask, task, memory[name])
