"""Base class of communication methods, and those that need no lines of sight."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import final, override

from bsk_torch._checks import number
from bsk_torch.act.discrete import PENDING
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sim.hooks import FLEET_MEMORY, ChangeGuard, check_class, check_linked, check_tensor, overrides
from bsk_torch.sim.state import FINITE

PEER = "rso_peer"
"""Memory of satellites that send packets with the number of the object that is the satellite to which they transmit."""

LAST = "last_communication"
"""Memory name of the time of an episode's last communication, s since reset."""

HOOKS = ("refines", "link", "communication_pairs", "communicate")
"""Members of :class:`CommunicationMethod` that subclasses may define."""


class CommunicationMethod:
    """Determines after each step which satellites share their knowledge with which others.

    Subclasses define :meth:`communication_pairs`. Dead satellites continue to communicate. Keep values of episodes
    in ``self.fleet.memory``, a :class:`~bsk_torch.sim.state.StateTable`, which is reset, saved and restored with the episodes,
    and not in attributes. Public tensor attributes must not change between steps.

    N is the number of environments, S the number of satellites in each.

    Attributes:
        fleet: The satellites, once an environment has been built.
        due: Episodes in which satellites communicate now, [N] bool; pairs of the others are ignored.
        min_period: Minimum time between two communications of an episode, s.
    """

    refines: ClassVar[bool] = False
    """Whether the class only changes the pairs of another class, which must follow it among the base classes."""

    _delivers_packets: ClassVar[bool] = False

    fleet: SatelliteFleet
    due: Tensor

    def __init__(self, min_period: float = 0.0) -> None:
        """Communicate at most every ``min_period`` seconds; ValueError if it is negative."""
        self.min_period = number("min_period", min_period, 0.0, unit="s", finite=False)

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, CommunicationMethod, HOOKS)

    # -- hooks --------------------------------------------------------------------------------------------------------

    def link(self, fleet: SatelliteFleet) -> None:
        """Prepare for the satellites of an environment; called once when it is built.

        Overriding methods call ``super().link(fleet)`` first, and raise TypeError or ValueError for unsuitable satellites.
        """
        chain = [cls for cls in type(self).__mro__ if "communication_pairs" in vars(cls)]
        if len(chain) > 1 and vars(chain[-2]).get("refines", False):
            name = chain[-2].__name__
            raise TypeError(
                f"{type(self).__name__}: {name} refines another communication method, which must follow it, "
                f"as in class Mine(comm.{name}, comm.LOSCommunication)"
            )
        self.fleet = fleet
        self.due = torch.zeros(fleet.num_envs, dtype=torch.bool, device=fleet.device)
        fleet.memory.declare(LAST, 0.0, dtype=torch.float64, low=0.0, high=FINITE)

    def communication_pairs(self) -> Tensor:
        """Return the pairs that communicate, [N, S, S] booleans by episode, sender and receiver; the diagonal is ignored."""
        raise NotImplementedError(f"{type(self).__name__} must implement communication_pairs()")

    def communicate(self, moves: Tensor) -> Tensor:
        """Return the pairs that communicate after a step of the episodes ``moves`` [N]: [N, S, S], False for episodes not due.

        Due are those whose last communication was at least ``min_period`` ago.
        """
        time, memory = self.fleet.sim_time, self.fleet.memory
        self.due = moves & (time - memory[LAST] >= self.min_period)
        pairs, shape = self.communication_pairs(), (self.fleet.num_envs, self.fleet.size, self.fleet.size)
        check_tensor(f"{type(self).__name__}.communication_pairs()", pairs, shape, torch.bool)
        memory[LAST] = torch.where(self.due, time, memory[LAST])
        return pairs & self.due.view(-1, 1, 1)

    # -- calls by the environment -------------------------------------------------------------------------------------

    @final
    def attach(self, fleet: SatelliteFleet) -> None:
        """Call :meth:`link`; not to be overridden."""
        if not self._delivers_packets and any(PEER in simulator.memory for simulator in fleet.simulators):
            raise ValueError(
                f"{type(self).__name__} does not deliver what satellites send by TransmitCatalog; give the environment "
                "communicator=CatalogCommunication()"
            )
        self.link(fleet)
        check_linked(self, "link(fleet)", fleet)

    @property
    def is_silent(self) -> bool:
        """Whether satellites never communicate, so that environments can skip the exchange."""
        return False

    @final
    def exchange(self, moves: Tensor) -> Tensor:
        """Call :meth:`communicate` and check its result; not to be overridden."""
        links, n, s = self.communicate(moves), self.fleet.num_envs, self.fleet.size
        check_tensor(f"the result of {type(self).__name__}.communicate(moves)", links, (n, s, s), torch.bool)
        self.__dict__.setdefault("_guard", ChangeGuard()).check(self, FLEET_MEMORY, exempt=("due",))
        return self.of_present(links)

    def of_present(self, links: Tensor) -> Tensor:
        """Return the links [N, S, S] between present satellites."""
        present = self.fleet.present
        return links if present is None else links & present.unsqueeze(1) & present.unsqueeze(2)


class NoCommunication(CommunicationMethod):
    """Satellites never communicate."""

    @cached_property
    def is_silent(self) -> bool:
        """See :attr:`CommunicationMethod.is_silent`; False for subclasses that define one of the hooks."""
        return not any(overrides(self, NoCommunication, name) for name in ("communicate", "communication_pairs"))

    @override
    def communication_pairs(self) -> Tensor:
        n, s = self.fleet.num_envs, self.fleet.size
        return torch.zeros(n, s, s, dtype=torch.bool, device=self.fleet.device)


class FreeCommunication(CommunicationMethod):
    """All satellites communicate with all others after every step."""

    @override
    def communication_pairs(self) -> Tensor:
        return ~torch.eye(self.fleet.size, dtype=torch.bool, device=self.fleet.device).expand(self.fleet.num_envs, -1, -1)


def connected(pairs: Tensor) -> Tensor:
    """Return the pairs connected by a path along ``pairs`` [N, S, S], in either direction, nodes with themselves included.

    Repeated squaring finds paths of 1, 2, 4, ... links until there are no more: the transitive closure of the graph.
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
        same = torch.eye(self.fleet.size, dtype=torch.bool, device=self.fleet.device)
        return connected(self.of_present(super().communication_pairs())) & ~same


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
