"""Base class of communication methods, and the two trivial ones."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import torch
from torch import Tensor
from typing_extensions import final, override

from bsk_torch._checks import number
from bsk_torch.sim.hooks import FLEET_MEMORY, ChangeGuard, check_class, check_linked, check_tensor, overrides
from bsk_torch.sim.state import FINITE

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet

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
        """Raise TypeError, suggesting a replacement, for definitions that no environment would use."""
        super().__init_subclass__(**options)
        check_class(cls, CommunicationMethod, HOOKS)

    # -- hooks --------------------------------------------------------------------------------------------------------

    def link(self, fleet: SatelliteFleet) -> None:
        """Prepare for the satellites of an environment; called once when it is built.

        Overriding methods call ``super().link(fleet)`` first.

        Raises:
            TypeError: If there is no class to refine, or satellites do not support this method.
            ValueError: Likewise, depending on arguments.
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
        """Return the pairs that communicate after a step, in episodes whose last communication was at least ``min_period`` ago.

        Args:
            moves: Episodes that took part in the step, [N].

        Returns:
            Pairs, [N, S, S] booleans by episode, sender and receiver; False for all pairs of episodes that are not due.

        Raises:
            TypeError: If the pairs are not booleans [N, S, S].
        """
        time, memory = self.fleet.sim_time, self.fleet.memory
        self.due = moves & (time - memory[LAST] >= self.min_period)
        pairs, wanted = self.communication_pairs(), (self.fleet.num_envs, self.fleet.size, self.fleet.size)
        if not isinstance(pairs, Tensor) or pairs.dtype != torch.bool or pairs.shape != wanted:
            given = f"{pairs.dtype} {list(pairs.shape)}" if isinstance(pairs, Tensor) else repr(pairs)
            raise TypeError(
                f"{type(self).__name__}.communication_pairs() gave {given}; "
                f"it must give torch.bool {list(wanted)}: episode, sender, receiver"
            )
        memory[LAST] = torch.where(self.due, time, memory[LAST])
        return pairs & self.due.view(-1, 1, 1)

    # -- calls by the environment -------------------------------------------------------------------------------------

    @final
    def attach(self, fleet: SatelliteFleet) -> None:
        """Call :meth:`link`; not to be overridden.

        Raises:
            TypeError: If an override does not call ``super().link(fleet)``.
            ValueError: If satellites send packets that this method does not deliver.
        """
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
        """Call :meth:`communicate` and check its result; not to be overridden.

        Raises:
            TypeError: If the result is not a bool tensor [N, S, S], or a public tensor attribute has changed.
        """
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
