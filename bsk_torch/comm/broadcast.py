"""Communication by broadcast actions."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import torch
from torch import Tensor

from bsk_torch.act.broadcast import PENDING
from bsk_torch.comm.base import CommunicationMethod

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet


class BroadcastCommunication(CommunicationMethod):
    """Refines another method: only satellites that chose :class:`~bsk_torch.act.Broadcast` send.

    They send at the end of the first step with communication in their episode, whether or not their action has ended and whether
    or not any satellite receives the message.
    """

    refines: ClassVar[bool] = True

    def link(self, fleet: SatelliteFleet) -> None:
        """See :meth:`CommunicationMethod.link`; ValueError if no satellite can broadcast."""
        super().link(fleet)
        if not any(PENDING in simulator.memory for simulator in fleet.simulators):
            raise ValueError(
                f"{type(self).__name__} needs a satellite with act.Broadcast() in its action_spec; there are {fleet.names[:5]}"
            )

    def communication_pairs(self) -> Tensor:
        """See :meth:`CommunicationMethod.communication_pairs`; pending messages of episodes that are due are sent thereby."""
        links = super().communication_pairs()
        pending = []
        for simulator in self.fleet.simulators:
            if PENDING in simulator.memory:
                pending.append(simulator.memory[PENDING])
                simulator.memory[PENDING] = pending[-1] & ~simulator.of_env(self.due)
            else:
                pending.append(torch.zeros_like(simulator.ticks, dtype=torch.bool))
        return links & self.fleet.joined(pending).unsqueeze(-1)
