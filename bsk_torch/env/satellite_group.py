"""The satellites of one type in an environment with their actions, observations and tasks in progress."""

from __future__ import annotations

import copy
import functools
from collections.abc import Sequence

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.act.base import ActionBuilder, Decision
from bsk_torch.act.builders import ContinuousBuilder, action_builder
from bsk_torch.obs.base import ObservationBuilder
from bsk_torch.sats.bound import BoundSatellite, SatelliteFleet
from bsk_torch.sats.satellite import Satellite
from bsk_torch.sim.dyn.events import DISARMED, DOWNLINK_TICK
from bsk_torch.sim.fleet import as_ticks
from bsk_torch.sim.hooks import check_tensor, overrides
from bsk_torch.sim.run.encounters import NEVER


class SatelliteGroup(BoundSatellite):
    """The N satellites of one type in an environment."""

    actions: ActionBuilder | ContinuousBuilder
    observations: ObservationBuilder

    def _join(self, fleet: SatelliteFleet, type_index: int) -> None:
        super()._join(fleet, type_index)
        self.on_bind()
        self.actions = action_builder(copy.deepcopy(list(self.action_spec)), self)
        self.action_description = self.actions.description
        self.actions.declare(self.task)
        self.observations = ObservationBuilder(copy.deepcopy(list(self.observation_spec)), self)
        vitals = (*self.dynamics.vitals().values(), *self.fsw.vitals().values())
        self.simulator.observer.want((*self.observations.observables, *vitals))

    @functools.cached_property
    def hears_ends(self) -> bool:
        """Whether satellites or actions have hooks for the ends of actions."""
        return self.actions.hears_ends or overrides(self, Satellite, "note_events")

    @override
    def action_mask(self) -> Tensor:
        mask, legal = self.actions.mask(), self.legal_actions()
        if legal is not None:
            check_tensor(f"{type(self).__name__}.legal_actions()", legal, mask.shape, torch.bool)
            mask = mask & legal
        elif self.actions.some_legal:
            return mask
        return mask | ~mask.any(1, keepdim=True)


def died(satellites: BoundSatellite) -> Tensor:
    """Return the satellites that fail a check now, [N]; absent satellites are not checked."""
    alive, present = satellites.is_alive(), satellites.simulator.present
    check_tensor(f"{type(satellites).__name__}.is_alive()", alive, satellites.task.dead.shape, torch.bool)
    failed = ~alive
    return failed if present is None else failed & present


def begin_tasks(satellites: BoundSatellite, envs: Tensor) -> None:
    """Record which satellites are dead or need no task in the episodes ``envs`` [n], which begin."""
    task, present = satellites.task, satellites.simulator.present
    rows = task.rows_of(envs)
    task.dead = task.dead.index_copy(0, rows, died(satellites)[rows])
    if present is not None:
        task.requires_retasking = task.requires_retasking.index_copy(0, rows, present[rows])


def command(
    satellites: SatelliteGroup, action: Tensor, acts: Tensor, decision: Decision, moves: Tensor, all_act: bool = False
) -> None:
    """Begin ``action`` [N] where ``acts`` [N] is true (``all_act``: everywhere); other satellites continue their tasks.

    A dead satellite of ``moves`` [N] no longer requires a task, unless its new task ends.
    """
    task, simulator = satellites.task, satellites.simulator
    simulator.command(decision.retask if all_act else decision.retask & acts, decision.mode)
    satellites.actions.begin(action, acts, decision)
    waits = task.requires_retasking
    task.requires_retasking = torch.zeros_like(waits) if all_act else waits & ~(acts | (task.dead & moves))
    now = simulator.state.ticks
    ends = now + whole_ticks(decision.duration, simulator.h_ns)
    expected = ends if decision.expected is decision.duration else now + whole_ticks(decision.expected, simulator.h_ns)
    new = {
        "ends": ends,
        "expected": expected,
        "action": action,
        "task_duration": decision.duration,
        "previous_action": decision.key,
    }
    for name, value in new.items():
        where = acts if value.ndim == 1 else acts.unsqueeze(-1)
        setattr(task, name, value if all_act else torch.where(where, value, task[name]))
    if simulator.has_tank:  # an empty tank is fatal at once; the action still completes
        task.dead = task.dead | (acts & ~satellites.fsw.fuel_remaining())


def whole_ticks(duration: Tensor, h_ns: int) -> Tensor:
    """Return the ticks of ``h_ns`` in a duration [N] s: an event fires at the first tick at or after its time."""
    return as_ticks(torch.ceil(torch.floor(duration * 1e9 + 0.5) / h_ns))


def soonest(ticks: Tensor, count: int) -> Tensor:
    """Return the first of the ticks [N * count] of the satellites of each episode, [N]."""
    return ticks if count == 1 else ticks.view(-1, count).amin(1)


def first_task_end(groups: Sequence[SatelliteGroup], ticks: Tensor) -> Tensor:
    """Return the first tick at which a task ends and with it the step, at most ``ticks`` [N], [N]."""
    for satellites in groups:
        if satellites.variable_interval:
            ticks = torch.minimum(ticks, soonest(satellites.task.ends, satellites.simulator.count))
    return ticks


def settle(satellites: SatelliteGroup, event: Tensor | None, moves: Tensor, last: Tensor) -> None:
    """Record how a run of the rows ``moves`` [N] of one type ended; ``event`` [N] ended the action of some, None of none.

    The rows ``last`` [N] have reached the limit of their episode, where the clock stops before the end of a task is evaluated.
    """
    task, state = satellites.task, satellites.simulator.state
    fired, waited = (task.ends <= state.ticks - as_ticks(last)) & moves, task.requires_retasking
    over = fired if event is None else fired | event
    task.requires_retasking = waited | over
    task.ends = torch.where(fired, NEVER, task.ends)
    if event is None and not satellites.hears_ends:
        return
    event = torch.zeros_like(fired) if event is None else event
    satellites.note_events(event)
    ended = over & ~waited
    decision = Decision(state.mode, ended, task.task_duration, task.previous_action, task.task_duration)
    satellites.actions.end(task.action, ended, decision, event)


def cancel(satellites: SatelliteGroup, rows: Tensor) -> None:
    """Cancel the tasks of ``rows``, a mask [N]; satellites whose task has ended by then still require a task."""
    task, state = satellites.task, satellites.simulator.state
    task.ends, task.expected = (torch.where(rows, NEVER, ticks) for ticks in (task.ends, task.expected))
    for name in ("image_level", DOWNLINK_TICK):
        if name in state.layout.fields:
            state.write(name, rows, torch.full_like(state.sim_time, DISARMED))


def groups_of(satellites: Sequence[Satellite], fleet: SatelliteFleet) -> tuple[SatelliteGroup, ...]:
    """Create the satellites of each type of a fleet from the descriptions of all, by their index in an episode."""
    groups = tuple(SatelliteGroup.of(satellites[s.columns[0]], fleet, k) for k, s in enumerate(fleet.simulators))
    fleet.satellites = groups
    return groups
