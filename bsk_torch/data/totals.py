"""Total rewards of the current episodes, the ``cum_reward`` of rewarders."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor

from bsk_torch.data.base import GlobalReward
from bsk_torch.data.composed import ComposedReward
from bsk_torch.sats.fleet import SatelliteFleet
from bsk_torch.sim.state import FINITE

NAME = "cum_reward"
"""Field of the state with the sums of a rewarder, [N, S]; the fields of its parts are numbered."""


def declare(rewarder: GlobalReward, fleet: SatelliteFleet) -> None:
    """Declare the sums of a rewarder and of its parts in the state of a fleet."""
    for k, part in enumerate(_parts(rewarder)):
        name = f"{NAME}_{k}" if k else NAME
        fleet.state.declare(name, 0.0, fleet.size, low=-FINITE, high=FINITE)
        part.__dict__["total_name"] = name


def add(rewarder: GlobalReward, reward: Tensor, moves: Tensor) -> None:
    """Add the rewards [N, S] of a step to the sums of a rewarder and its parts; ``moves`` [N] are the episodes that took it."""
    state = rewarder.fleet.state
    state[rewarder.total_name] = state[rewarder.total_name] + reward
    if isinstance(rewarder, ComposedReward):
        for part, term in zip(rewarder.rewarders, rewarder.terms.values(), strict=True):
            add(part, term * moves.unsqueeze(-1), moves)


def _parts(rewarder: GlobalReward) -> Iterator[GlobalReward]:
    yield rewarder
    if isinstance(rewarder, ComposedReward):
        for part in rewarder.rewarders:
            yield from _parts(part)
