"""Satellites talk to those that they see."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import Tensor

from bsk_torch.comm.base import CommunicationMethod
from bsk_torch.comm.multi import MultiDegreeCommunication
from bsk_torch.sim.dyn import LOSCommDynModel
from bsk_torch.sim.los import in_sight

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet


class LOSCommunication(CommunicationMethod):
    """Two satellites talk, both ways, if at any time since the previous step one of them saw the other.

    What counts is the straight line between them, which the Earth must not block, and ``losMaximumRange`` of the one that sees.
    All dynamics models must have :class:`~bsk_torch.sim.dyn.LOSCommDynModel` among their bases. What is seen in steps after which
    ``min_period`` forbids communication is forgotten.

    bsk_rl lists every direction of a link twice, and lets everybody talk to everybody where the entries are as many as there are
    ordered pairs, such as with three links among four satellites. Here those that do not see one another never talk.
    """

    def link(self, fleet: Fleet) -> None:
        """See :meth:`CommunicationMethod.link`.

        Raises:
            TypeError: For a satellite without :class:`~bsk_torch.sim.dyn.LOSCommDynModel`.
            ValueError: Where the orbit is integrated in the tick, which leaves nothing to look back at.
        """
        super().link(fleet)
        for part, simulator, columns in zip(fleet.parts, fleet.simulators, fleet.columns, strict=True):
            name = fleet.names[int(columns[0])]
            if not issubclass(part.dyn_type, LOSCommDynModel):
                raise TypeError(
                    f"{type(self).__name__} needs dyn.LOSCommDynModel among the bases of {name}'s dyn_type, which is "
                    f"{part.dyn_type.__name__}"
                )
            if simulator.orbit != "arc":
                raise ValueError(
                    f"{type(self).__name__} looks back along orbits that are computed in advance, but {name} has "
                    f"orbit={simulator.orbit!r}; pass orbit='arc' to the environment"
                )

    def communication_pairs(self) -> Tensor:
        """See :meth:`CommunicationMethod.communication_pairs`."""
        return in_sight(self.fleet, self.due)


class LOSMultiCommunication(MultiDegreeCommunication, LOSCommunication):
    """Satellites talk to those that they see, and to those that these see, and so on."""
