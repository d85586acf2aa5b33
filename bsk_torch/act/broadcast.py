"""Action that sends a satellite's knowledge to other satellites."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.act.base import LONGEST, Action, Decision, positive_duration

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite

PENDING = "broadcast_pending"
"""Name of the value in ``simulator.memory`` that marks satellites with an unsent message, [N] bool."""


class Broadcast(Action):
    """Send a satellite's knowledge to the satellites that can receive it; its flight mode continues.

    Use it with :class:`~bsk_torch.comm.BroadcastCommunication`. The message is sent at the end of the step, which another
    satellite may end before ``duration`` has passed. The next action counts as new, even if it equals the action before the
    broadcast.
    """

    def __init__(self, name: str = "action_broadcast", duration: float | None = None) -> None:
        """Last ``duration`` seconds, None for 1e9 s; ValueError unless it is positive."""
        super().__init__(name)
        self.duration = positive_duration("duration", duration, name, LONGEST)

    @override
    def link_satellite(self, satellite: BoundSatellite) -> None:
        super().link_satellite(satellite)
        if PENDING not in satellite.simulator.memory:
            satellite.simulator.memory.declare(PENDING, False, dtype=torch.bool)

    @override
    def decide(self, index: Tensor, mask: Tensor, action: Tensor, previous: Tensor) -> Decision:
        seconds = torch.full_like(action, self.duration, dtype=torch.float64)
        return Decision(self.satellite.simulator.mode, torch.zeros_like(mask), seconds, action, seconds)

    @override
    def begin(self, mask: Tensor, decision: Decision) -> None:
        memory = self.satellite.simulator.memory
        memory[PENDING] = memory[PENDING] | mask
