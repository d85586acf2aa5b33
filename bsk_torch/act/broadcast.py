"""Telling others what one knows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.act.base import Action, Decision
from bsk_torch.act.discrete import FOREVER

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite

PENDING = "broadcast_pending"
"""Name under which a simulation remembers who has something to send."""


class Broadcast(Action):
    """Send what the satellite knows to those that can hear it; it goes on doing what it does.

    Use it with :class:`~bsk_torch.comm.BroadcastCommunication`. The message leaves at the end of the step, which another
    satellite may end before ``duration`` has passed. The action that follows counts as a new one, even if it is that from before.
    """

    def __init__(self, name: str = "action_broadcast", duration: float | None = None) -> None:
        """Last ``duration`` seconds, None for as long as nothing else ends the step; ValueError unless it is positive."""
        super().__init__(name)
        self.duration = FOREVER if duration is None else float(duration)
        if not self.duration > 0.0:
            raise ValueError(f"duration={duration!r} s of action {name!r} must be positive, or None")

    def link_satellite(self, satellite: Satellite) -> None:
        """See :meth:`Action.link_satellite`."""
        super().link_satellite(satellite)
        if PENDING not in satellite.simulator.memory:
            satellite.simulator.memory.add(PENDING, False, dtype=torch.bool)

    def decide(self, index: Tensor, mine: Tensor, action: Tensor, previous: Tensor) -> Decision:
        """See :meth:`Action.decide`."""
        seconds = torch.full_like(action, self.duration, dtype=torch.float64)
        return Decision(self.satellite.simulator.mode, torch.zeros_like(mine), seconds, action, seconds)

    def begin(self, rows: Tensor, decision: Decision) -> None:
        """See :meth:`Action.begin`."""
        memory = self.satellite.simulator.memory
        memory[PENDING] = memory[PENDING] | rows
