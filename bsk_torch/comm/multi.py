"""Communication over several hops within one step."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.comm.base import CommunicationMethod


def connected(pairs: Tensor) -> Tensor:
    """Return the pairs of nodes connected by a path along ``pairs`` [N, S, S], in either direction; [N, S, S] booleans.

    Each node is connected to itself. Repeated squaring of the connection matrix finds paths of up to 1, 2, 4, ... links until
    there are no more: the transitive closure of the undirected graph.
    """
    size = pairs.shape[-1]
    near = pairs | pairs.mT | torch.eye(size, dtype=torch.bool, device=pairs.device)
    for _ in range(max(0, size - 2).bit_length()):
        links = near.float()  # counts of paths may round, but never to zero
        before, near = near, links @ links > 0.5
        if torch.equal(near, before):
            break
    return near


class MultiDegreeCommunication(CommunicationMethod):
    """Refines another method: all satellites connected by a chain of its pairs communicate in the same step."""

    refines: ClassVar[bool] = True

    @override
    def communication_pairs(self) -> Tensor:
        own = torch.eye(self.fleet.size, dtype=torch.bool, device=self.fleet.device)
        return connected(self.of_present(super().communication_pairs())) & ~own
