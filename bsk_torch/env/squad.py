"""The satellites of one type in an environment: what they have been told to do, and until when."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.act.base import Decision
from bsk_torch.sats.satellite import Satellite
from bsk_torch.sim.dyn.events import DISARMED
from bsk_torch.sim.fleet import NEVER

KEPT = ("previous_action", "dead", "requires_retasking", "ends", "action", "task_duration", "expected")
"""What the future depends on beside the simulation."""


class Squad:
    """The N satellites of one type: rows as in their simulator.

    Attributes:
        satellite: What all of them are.
        previous_action: What the last action, or the one in progress, is remembered by; see :class:`bsk_torch.act.base.Decision`.
        dead: Which have died.
        requires_retasking: Which have nothing left to do.
        ends: Tick since reset at which the task's time is up.
        action: Number of the action in progress.
        task_duration: Its duration, s.
        expected: Tick at which it will probably end.
    """

    def __init__(self, satellite: Satellite) -> None:
        """Nothing has been commanded yet."""
        self.satellite, self.simulator = satellite, satellite.simulator
        zero = torch.zeros_like(self.simulator.ticks)
        self.previous_action, self.ends = zero - 1, zero + NEVER
        self.dead = torch.zeros_like(zero, dtype=torch.bool)
        self.requires_retasking = torch.ones_like(self.dead)
        self.action, self.expected = zero.clone(), zero + NEVER
        self.task_duration = zero.double()

    def begin(self, rows: Tensor) -> None:
        """New episodes in ``rows`` [n]."""
        fresh: dict[str, float] = {"previous_action": -1, "requires_retasking": True, "ends": NEVER, "expected": NEVER}
        fresh |= {"action": 0, "task_duration": 0.0}
        for name, value in fresh.items():  # never in place: the tensors may be the user's
            setattr(self, name, getattr(self, name).index_fill(0, rows, value))

    def checked(self, action: Tensor, acts: Tensor) -> Tensor:
        """The actions [N] as int64; raises where one that counts, ``acts`` [N], is not legal."""
        n, explicit = self.satellite.actions.n_actions, self.satellite.actions.explicit
        action = action.long()
        wrong = ((action < -explicit) | (action >= n)) & acts
        if bool(wrong.any()):
            row = int(torch.nonzero(wrong)[0])
            names = ", ".join(f"{k}: {name}" for k, name in enumerate(self.satellite.action_description))
            more = f", and -1 to {-explicit} for a target by its index" if explicit else ""
            raise ValueError(f"action {int(action[row])} of {self.satellite.title(row)} is out of range; legal are {names}{more}")
        return action

    def command(self, action: Tensor, acts: Tensor, all_act: bool = False) -> None:
        """Do ``action`` [N] where ``acts`` [N] is true (``all_act``: everywhere); the others go on with their tasks."""
        simulator, actions = self.simulator, self.satellite.actions
        decision = actions.decide(action, self.previous_action, acts)
        simulator.command(decision.retask & acts, decision.mode)
        actions.begin(action, acts, decision)
        self.previous_action = torch.where(acts, decision.key, self.previous_action)
        self.requires_retasking = self.requires_retasking & ~acts
        now = simulator.ticks
        ends = now + self.whole_ticks(decision.duration)
        expected = ends if decision.expected is decision.duration else now + self.whole_ticks(decision.expected)
        task = {"ends": ends, "expected": expected, "action": action, "task_duration": decision.duration}
        for name, value in task.items():
            setattr(self, name, value if all_act else torch.where(acts, value, getattr(self, name)))

    def whole_ticks(self, duration: Tensor) -> Tensor:
        """Ticks after which a duration [N] s has passed: an event fires at the first tick at or after its time."""
        return torch.ceil(torch.floor(duration * 1e9 + 0.5) / self.simulator.h_ns).long()

    def settle(self, event: Tensor | None, moves: Tensor, last: Tensor) -> None:
        """Note what ended a run of those that ``moves`` [N] says.

        Args:
            event: Where an event happened that ends the action, [N]; None where there are no such events.
            moves: Who took part, [N].
            last: Whose episode has reached its limit, [N]: the clock stops there before a task's end is looked at.
        """
        simulator = self.simulator
        fired = (self.ends <= simulator.ticks - last.long()) & moves
        was_busy = ~self.requires_retasking
        self.requires_retasking = self.requires_retasking | fired
        self.ends = torch.where(fired, NEVER, self.ends)
        if event is None:
            event = torch.zeros_like(fired)
        else:
            self.requires_retasking = self.requires_retasking | event
        self.satellite.note_events(event)
        decision = Decision(simulator.mode, fired, self.task_duration, self.previous_action, self.task_duration)
        self.satellite.actions.end(self.action, fired & was_busy, decision, event)

    def dismiss(self, rows: Tensor) -> None:
        """Forget the events of ``rows`` [N], a mask: they end no step any more."""
        self.ends, self.expected = (torch.where(rows, NEVER, ticks) for ticks in (self.ends, self.expected))
        self.requires_retasking = self.requires_retasking & ~rows
        if "image_level" in self.simulator.tick.state.fields:
            self.simulator.write("image_level", rows, torch.full_like(self.simulator.sim_time, DISARMED))
