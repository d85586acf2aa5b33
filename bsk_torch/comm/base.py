"""Base of all ways in which satellites share what they know."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import torch
from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.sim.fleet import Fleet

LAST = "last_communication"
"""Name under which an episode remembers when its satellites were last asked, s since reset."""


class CommunicationMethod:
    """Who tells whom what it knows after a step.

    Subclasses implement :meth:`communication_pairs`. Satellites that have died go on talking, as in bsk_rl.

    Attributes:
        fleet: The satellites; known once an environment has been built.
        due: Episodes whose satellites are being asked, [N]; what :meth:`communication_pairs` says of others is not looked at.
    """

    refines: ClassVar[bool] = False
    """Whether the class only changes the pairs of another one, which must follow it among the base classes."""

    fleet: Fleet
    due: Tensor

    def __init__(self, min_period: float = 0.0) -> None:
        """Ask at most every ``min_period`` seconds; ValueError if it is negative."""
        if not min_period >= 0.0:
            raise ValueError(f"min_period={min_period!r} s must not be negative")
        self.min_period = float(min_period)

    def link(self, fleet: Fleet) -> None:
        """Called once when the environment is built.

        Raises:
            TypeError: If nothing is there for the class to refine, or satellites cannot communicate in this way.
            ValueError: Likewise, where that depends on arguments.
        """
        chain = [cls for cls in type(self).__mro__ if "communication_pairs" in vars(cls)]
        if len(chain) > 1 and vars(chain[-2]).get("refines", False):
            name = chain[-2].__name__
            raise TypeError(
                f"{type(self).__name__}: {name} refines another way of communication, which must follow it, "
                f"as in class Mine(comm.{name}, comm.LOSCommunication)"
            )
        self.fleet = fleet
        self.due = torch.zeros(fleet.num_envs, dtype=torch.bool, device=fleet.device)
        fleet.memory.add(LAST, 0.0, dtype=torch.float64)

    def communication_pairs(self) -> Tensor:
        """Who talks to whom, [N, S, S] booleans by sender and receiver; the diagonal does not matter."""
        raise NotImplementedError(f"{type(self).__name__} must implement communication_pairs()")

    def communicate(self, moves: Tensor) -> Tensor:
        """Ask for pairs where at least ``min_period`` has passed since that was done last.

        Args:
            moves: Episodes that took part in the present step, [N].

        Returns:
            Who talks to whom, [N, S, S] booleans by sender and receiver; nobody where it is not time.

        Raises:
            TypeError: If the pairs are not booleans [N, S, S].
        """
        time, memory = self.fleet.sim_time, self.fleet.memory
        self.due = moves & (time - memory[LAST] >= self.min_period)
        pairs, wanted = self.communication_pairs(), (self.fleet.num_envs, self.fleet.size, self.fleet.size)
        if pairs.dtype != torch.bool or pairs.shape != wanted:
            raise TypeError(
                f"{type(self).__name__}.communication_pairs() gave {pairs.dtype} {list(pairs.shape)}; "
                f"it must give torch.bool {list(wanted)}: episode, sender, receiver"
            )
        memory[LAST] = torch.where(self.due, time, memory[LAST])
        return pairs & self.due.view(-1, 1, 1)


class NoCommunication(CommunicationMethod):
    """Nobody talks to anybody."""

    def communication_pairs(self) -> Tensor:
        """See :meth:`CommunicationMethod.communication_pairs`."""
        n, s = self.fleet.num_envs, self.fleet.size
        return torch.zeros(n, s, s, dtype=torch.bool, device=self.fleet.device)


class FreeCommunication(CommunicationMethod):
    """Everybody talks to everybody after every step."""

    def communication_pairs(self) -> Tensor:
        """See :meth:`CommunicationMethod.communication_pairs`."""
        return ~torch.eye(self.fleet.size, dtype=torch.bool, device=self.fleet.device).expand(self.fleet.num_envs, -1, -1)
