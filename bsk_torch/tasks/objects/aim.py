"""Nodes of the objects at which satellites point, for their ticks."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.codegen.kernel import Samples
from bsk_torch.comm.base import PEER
from bsk_torch.sim.simulator import Simulator
from bsk_torch.sim.tick.trace import TrackSource, no_samples
from bsk_torch.tasks.objects.dyn import RSO_TRACK
from bsk_torch.tasks.objects.orbits import CatalogOrbits

AIM, NO_AIM = "rso_target", -1
"""Memory of satellites with the number of the object at which they point, and its value where they have pointed at none."""


class AimedNodes(TrackSource):
    """Supplies the nodes of the objects at which the satellites of a simulation point; see ``Simulator.sources``."""

    def __init__(self, simulator: Simulator, orbits: CatalogOrbits) -> None:
        """Supply the satellites of a simulation with objects on ``orbits``."""
        self._simulator, self._orbits = simulator, orbits
        self._mode = simulator.mode_names.index("image_rso")
        names = simulator.mode_names
        self._radio = names.index("transmit_rso") if "transmit_rso" in names else None
        self._nodes = no_samples(RSO_TRACK, simulator.state.rows, simulator.device)
        self._key: tuple[Tensor, int, int] | None = None
        self._end = -1.0

    @override
    def reach(self, time: Tensor) -> None:
        simulator, orbits = self._simulator, self._orbits
        key = simulator.mode, simulator.memory.version, orbits.version
        same = self._key is not None and key[0] is self._key[0] and key[1:] == self._key[1:]
        aim, points = simulator.memory[AIM], simulator.mode == self._mode
        if self._radio is not None and PEER in simulator.memory:
            transmits = simulator.mode == self._radio
            aim, points = torch.where(transmits, simulator.memory[PEER], aim), points | transmits
        points = torch.nonzero(points & (aim != NO_AIM)).squeeze(-1)
        end = float(time[points].max()) if len(points) else 0.0
        if same and end <= self._end:
            return
        owner = torch.zeros_like(aim)
        if len(points):
            # all nodes reach equally far, so that longer runs need no others; what lies behind a run does not affect it
            until = torch.full((len(points),), end, dtype=torch.float64, device=simulator.device)
            nodes = orbits.nodes(points // simulator.count, aim[points], until)
            owner[points] = torch.arange(len(points), device=simulator.device)
            self._nodes = nodes._replace(owner=owner)
        else:
            self._nodes = no_samples(RSO_TRACK, simulator.state.rows, simulator.device)
        self._key, self._end = key, end

    @override
    def samples(self) -> Samples:
        return self._nodes
