"""Communication methods of one episode, such as bsk_rl's, run for each environment of a batch."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Protocol

import torch
from torch import Tensor

from bsk_torch.comm.base import CommunicationMethod

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.sats.one import OneSatellite

NOT_CALLED = (
    "link_satellites", "communicate", "reset_overwrite_previous", "reset_pre_sim_init", "reset_during_sim_init",
    "reset_post_sim_init",
)  # fmt: skip
"""Hooks of methods of one episode that have no counterpart here."""

ROOTS = ("CommunicationMethod", "Resetable")
"""Classes of bsk_rl that define these hooks."""


class OneMethod(Protocol):
    """A communication method of one episode: its hook is that of ``bsk_torch.bsk_rl.comm.CommunicationMethod``."""

    min_period: float
    satellites: list[Any]

    def communication_pairs(self) -> Iterable[tuple[Any, Any]]:
        """Return pairs of senders and receivers."""


class PerEnvironmentCommunication(CommunicationMethod):
    """Runs a communication method of one episode for each environment; see :func:`bsk_torch.per_environment`.

    Attributes:
        given: The method of one episode.
    """

    def __init__(self, given: OneMethod) -> None:
        """Run copies of ``given``; TypeError for one with hooks that would not be called."""
        super().__init__(given.min_period)
        kinds = type(given).__mro__
        owners = {name: next((kind for kind in kinds if name in vars(kind)), None) for name in NOT_CALLED}
        own = sorted(name for name, owner in owners.items() if owner is not None and owner.__name__ not in ROOTS)
        if own:
            raise TypeError(
                f"per_environment({type(given).__name__}()): {', '.join(own)} would not be called; communication_pairs() is. "
                "Methods of bsk_torch.comm, such as comm.LOSCommunication, run for all environments at once"
            )
        self.given = given

    def communication_pairs(self) -> Tensor:
        """See :meth:`CommunicationMethod.communication_pairs`; TypeError for pairs that are not satellites."""
        fleet = self.fleet
        links = torch.zeros(fleet.num_envs, fleet.size, fleet.size, dtype=torch.bool)
        for env in torch.nonzero(self.due).squeeze(-1).tolist():
            one = copy.copy(self.given)
            one.satellites = satellites_of(fleet, env)
            pairs = one.communication_pairs()
            try:
                for sender, receiver in pairs:
                    links[env, fleet.names.index(sender.name), fleet.names.index(receiver.name)] = True
            except (TypeError, ValueError, AttributeError) as error:
                title = f"{type(one).__name__}.communication_pairs()"
                raise TypeError(f"{title} gave {pairs!r}; it must give (sender, receiver) pairs of satellites") from error
        return links.to(fleet.device)


def satellites_of(fleet: SatelliteFleet, env: int) -> list[OneSatellite]:
    """Return the satellites of an environment, by their number."""
    found: dict[int, OneSatellite] = {}
    for part, columns in zip(fleet.satellites, fleet.columns, strict=True):
        for number, column in enumerate(columns.tolist()):
            found[column] = part.one(env * len(columns) + number)
    return [found[column] for column in range(fleet.size)]
