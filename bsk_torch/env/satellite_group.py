"""The satellites of one type in an environment: models, actions, observations, and tasks in progress."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from bsk_torch.act.base import Decision
from bsk_torch.act.builders import action_builder
from bsk_torch.obs.base import ObservationBuilder
from bsk_torch.sats.satellite import Satellite
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.dyn.events import DISARMED
from bsk_torch.sim.fleet import NEVER, Fleet
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.state import StateTable


class TaskState(StateTable):
    """Tasks in progress of N satellites.

    Attributes:
        previous_action: Key of the last action, or of the one in progress; see :class:`bsk_torch.act.base.Decision`.
        dead: Which satellites have died.
        requires_retasking: Which have no task left.
        ends: Tick since reset at which the task's time is up.
        action: The action in progress, which the builder of actions declares: its number [N], or its values [N, A].
        task_duration: Its duration, s.
        expected: Tick at which it will probably end.
    """

    previous_action: Tensor
    dead: Tensor
    requires_retasking: Tensor
    ends: Tensor
    action: Tensor
    task_duration: Tensor
    expected: Tensor

    def __init__(self, num_envs: int, count: int, device: torch.device) -> None:
        """Make the table; no satellite has a task."""
        super().__init__(num_envs, count, device)
        self.declare("previous_action", -1)
        self.declare("dead", False)
        self.declare("requires_retasking", True)
        self.declare("ends", NEVER, low=0, high=NEVER)
        self.declare("task_duration", 0.0, low=0.0)
        self.declare("expected", NEVER, low=0, high=NEVER)


class SatelliteGroup:
    """The N satellites of one type; rows as in their simulator.

    Attributes:
        satellite: Copy of the user's satellite that is bound to the environment; hooks and functions of users receive it.
        simulator: Their simulation.
        fleet: All satellites of the environment.
        index: Number of the group in the fleet.
        names: Name of each satellite of an episode.
        scenario, rewarder: Those of the environment, once it has linked them.
        dynamics, fsw: Their models.
        actions: Their actions.
        observations: Their observations.
        task: Their tasks in progress, which are part of the state.
    """

    def __init__(self, satellite: Satellite, fleet: Fleet, index: int) -> None:
        """Bind the description ``satellite`` to the simulation number ``index`` of a fleet."""
        self.fleet, self.index = fleet, index
        self.simulator: Simulator = fleet.simulators[index]
        self.names = tuple(fleet.names[column] for column in fleet.columns[index].tolist())
        self.scenario: Any = None
        self.rewarder: Any = None
        self.observation_description: list[str] = []
        state = self.simulator.state
        self.task = TaskState(state.num_envs, state.count, state.device)
        state.add("task", self.task)
        self.satellite = satellite.bound_to(self)
        self.dynamics, self.fsw = satellite.dyn_type(self.simulator), satellite.fsw_type(self.simulator)
        self.dynamics.satellite = self.fsw.satellite = self.satellite
        self.satellite.on_bind()
        self.actions = action_builder(copy.deepcopy(list(satellite.action_spec)), self.satellite)
        self.actions.declare(self.task)
        self.observations = ObservationBuilder(copy.deepcopy(list(satellite.observation_spec)), self.satellite)
        self.simulator.observer.want((*self.observations.observables, *self.dynamics.vitals(), *self.fsw.vitals()))

    @property
    def functions(self) -> list[UserFunction]:
        """Functions of users that observations and satellites call."""
        return [*self.observations.functions, *self.satellite.functions]

    @property
    def time_limit(self) -> Tensor:
        """Time limits of the episodes, [N] s."""
        return self.simulator.state.of_env(self.fleet.state.time_limit)

    @property
    def removed(self) -> Tensor | None:
        """Satellites that have left their episodes, [N]; None where none can."""
        return self.fleet.rows_of(self.index, self.fleet.state.removed) if self.fleet.size > 1 else None

    def checked(self, action: Tensor, acts: Tensor) -> Tensor:
        """Return the actions [N, ...] as they are kept, 0 where they do not count; see the builder's method."""
        return self.actions.checked(action, acts)

    def decide(self, action: Tensor, acts: Tensor) -> Decision:
        """Return the commands of ``action`` [N] where ``acts`` [N] is true; nothing changes yet."""
        return self.actions.decide(action, self.task.previous_action, acts)

    def command(self, action: Tensor, acts: Tensor, decision: Decision, all_act: bool = False) -> None:
        """Begin ``action`` [N] where ``acts`` [N] is true (``all_act``: everywhere); other satellites continue their tasks."""
        task, simulator = self.task, self.simulator
        simulator.command(decision.retask & acts, decision.mode)
        self.actions.begin(action, acts, decision)
        task.previous_action = torch.where(acts, decision.key, task.previous_action)
        task.requires_retasking = task.requires_retasking & ~acts
        now = simulator.state.ticks
        ends = now + self.whole_ticks(decision.duration)
        expected = ends if decision.expected is decision.duration else now + self.whole_ticks(decision.expected)
        new = {"ends": ends, "expected": expected, "action": action, "task_duration": decision.duration}
        for name, value in new.items():
            where = acts if value.ndim == 1 else acts.unsqueeze(-1)
            setattr(task, name, value if all_act else torch.where(where, value, task[name]))
        if simulator.has_tank:  # who has emptied it is dead from now on, though the action takes its course
            task.dead = task.dead | (acts & ~self.fsw.fuel_remaining())

    def whole_ticks(self, duration: Tensor) -> Tensor:
        """Return the ticks after which a duration [N] s has passed: an event fires at the first tick at or after its time."""
        return torch.ceil(torch.floor(duration * 1e9 + 0.5) / self.simulator.h_ns).long()

    def settle(self, event: Tensor | None, moves: Tensor, last: Tensor) -> None:
        """Record how a run of the rows ``moves`` [N] ended.

        Args:
            event: Where an event happened that ends the action, [N]; None where there are no such events.
            moves: Rows that took part, [N].
            last: Rows whose episode has reached its limit, [N]: the clock stops there before a task's end is evaluated.
        """
        task, simulator = self.task, self.simulator
        fired = (task.ends <= simulator.state.ticks - last.long()) & moves
        was_busy = ~task.requires_retasking
        task.requires_retasking = task.requires_retasking | fired
        task.ends = torch.where(fired, NEVER, task.ends)
        if event is None:
            event = torch.zeros_like(fired)
        else:
            task.requires_retasking = task.requires_retasking | event
        self.satellite.note_events(event)
        ended = (fired | event) & was_busy
        decision = Decision(simulator.state.mode, ended, task.task_duration, task.previous_action, task.task_duration)
        self.actions.end(task.action, ended, decision, event)

    def cancel(self, rows: Tensor) -> None:
        """Cancel the tasks of ``rows`` [N], a mask: their events end no step any more."""
        task, state = self.task, self.simulator.state
        task.ends, task.expected = (torch.where(rows, NEVER, ticks) for ticks in (task.ends, task.expected))
        task.requires_retasking = task.requires_retasking & ~rows
        if "image_level" in state.layout.fields:
            state.write("image_level", rows, torch.full_like(state.sim_time, DISARMED))


def groups_of(satellites: Sequence[Satellite], fleet: Fleet) -> tuple[SatelliteGroup, ...]:
    """Make and return the groups of a fleet from the ``satellites`` of all types, listed by their number in an episode."""
    fleet.groups = groups = tuple(SatelliteGroup(satellites[s.columns[0]], fleet, k) for k, s in enumerate(fleet.simulators))
    return groups
