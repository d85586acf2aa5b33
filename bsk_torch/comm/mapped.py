"""Communication methods in bsk_rl's form: a list of pairs of satellites, for each environment."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bsk_torch.sim.hooks import note_slow

if TYPE_CHECKING:
    from bsk_torch.comm.base import CommunicationMethod
    from bsk_torch.sats.fleet import SatelliteFleet
    from bsk_torch.sats.one import OneSatellite

ADVICE = "return torch.bool [N, S, S] by episode, sender and receiver, from what fleet.each(function) reads of all satellites"


class OneEnvironmentNeededError(Exception):
    """Raised when a method accesses the satellites of one environment."""


def satellites_of(fleet: SatelliteFleet, env: int) -> list[OneSatellite]:
    """Return the satellites of an environment, by their number."""
    found: dict[int, OneSatellite] = {}
    for part, columns in zip(fleet.satellites, fleet.columns, strict=True):
        for number, column in enumerate(columns.tolist()):
            found[column] = part.one(env * len(columns) + number)
    return [found[column] for column in range(fleet.size)]


def listed_pairs(method: CommunicationMethod) -> Tensor:
    """Return the pairs of each due environment, [N, S, S] bool; TypeError unless they are a list of pairs."""
    title = f"{type(method).__name__}.communication_pairs()"
    note_slow(title, ADVICE)
    fleet = method.fleet
    links = torch.zeros(fleet.num_envs, fleet.size, fleet.size, dtype=torch.bool)
    for env in torch.nonzero(method.due).squeeze(-1).tolist():
        one = copy.copy(method)
        one.one_environment = satellites_of(fleet, env)
        pairs = one.communication_pairs()
        try:
            for sender, receiver in pairs:
                links[env, fleet.names.index(sender.name), fleet.names.index(receiver.name)] = True
        except (TypeError, ValueError, AttributeError) as error:
            raise TypeError(f"{title} gave {pairs!r}; it must give torch.bool [N, S, S], or (sender, receiver) pairs") from error
    return links.to(fleet.device)
