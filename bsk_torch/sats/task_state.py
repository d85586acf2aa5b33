"""Tasks in progress of satellites, as part of the state."""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.sim.fleet import NEVER
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
