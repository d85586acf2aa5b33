"""Sums of several rewards, and total rewards of the current episodes."""

from __future__ import annotations

import copy
from collections.abc import Hashable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.data.checked import CheckedRewarder
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.recorded import RecordedProgress
from bsk_torch.sim.hooks import overrides
from bsk_torch.sim.state import FINITE

if TYPE_CHECKING:
    from bsk_torch.data.mixed import Looking


class ComposedReward(GlobalReward):
    """The sum of several rewards.

    Attributes that only one part has can be read from the sum, such as ``imaged`` of a
    :class:`~bsk_torch.data.UniqueImageReward`.

    Attributes:
        rewarders: The parts.
        terms: Reward of each part for the last step, [N, S] each, by the names of :attr:`names`.
    """

    checked: Sequence[CheckedRewarder] = ()
    """The hooks of the parts, once they are linked."""

    def __init__(self, *rewarders: GlobalReward) -> None:
        """Add up ``rewarders``; ValueError without any."""
        if not rewarders:
            raise ValueError("rewarders is empty; ComposedReward needs at least one, such as data.UniqueImageReward()")
        for rewarder in rewarders:
            if not isinstance(rewarder, GlobalReward):
                raise ValueError(f"rewarders has {rewarder!r}, which is not a rewarder; write data.NoReward(), with parentheses")
        self.rewarders: Sequence[GlobalReward] = tuple(rewarders)
        self.terms: dict[str, Tensor] = {}

    def __copy__(self) -> ComposedReward:
        new = type(self).__new__(type(self))
        new.__dict__ |= self.__dict__ | {"rewarders": tuple(map(copy.copy, self.rewarders)), "terms": {}}
        return new

    def __getattr__(self, name: str) -> Any:
        values = [getattr(rewarder, name) for rewarder in self.__dict__.get("rewarders", ()) if hasattr(rewarder, name)]
        if not values:
            raise AttributeError(f"neither {type(self).__name__} nor one of its rewarders has {name!r}")
        if any(value is not values[0] for value in values):
            raise AttributeError(f"several rewarders have {name!r}; read it from one of them, as in rewarders[0].{name}")
        return values[0]

    def __setattr__(self, name: str, value: object) -> None:
        parts = self.__dict__.get("rewarders", ())
        of_part = any(name in vars(part) or isinstance(getattr(type(part), name, None), property) for part in parts)
        of_part = of_part and not hasattr(type(self), name)
        if of_part and name not in (*self.__dict__, "scenario", "fleet", "terms"):
            raise AttributeError(f"{name!r} belongs to a part of the sum; set it there, as in rewarders[0].{name}")
        super().__setattr__(name, value)

    @property
    def names(self) -> list[str]:
        """Name of each term: its class, numbered if there are several."""
        return _numbered(type(rewarder).__name__ for rewarder in self.rewarders)

    @override
    def defines(self, hook: str) -> bool:
        return overrides(self, ComposedReward, hook) or any(part.defines(hook) for part in self.rewarders)

    @override
    def group_of(self, name: str) -> Hashable:
        return tuple(rewarder.group_of(name) for rewarder in self.rewarders)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """See :meth:`GlobalReward.link`; under ``compat="bsk_rl"``, parts limit nothing that satellites may choose."""
        super().link(scenario, fleet)
        looking: list[Looking] = [part for part in fleet.satellites if hasattr(part, "access_filters")]
        before = [list(part.access_filters) for part in looking]
        self.checked = tuple(map(CheckedRewarder, self.rewarders))
        for part in self.checked:
            part.rewarder._in_channel = self._in_channel
            part.link(scenario, fleet)
        if fleet.simulators[0].type.compat:
            for satellites, filters in zip(looking, before, strict=True):
                satellites.access_filters = filters

    def read_log(self) -> Log:
        """See :meth:`GlobalReward.read_log`; the logs of all parts, under names such as ``0.storage_level``."""
        return {f"{k}.{name}": value for k, part in enumerate(self.checked) for name, value in part.log().items()}

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        for k, (name, part) in enumerate(zip(self.names, self.checked, strict=True)):
            prefix = f"{k}."
            logs = (
                {key[len(prefix) :]: value for key, value in log.items() if key.startswith(prefix)} for log in (before, after)
            )
            self.terms[name] = part.reward(*logs)
        return torch.stack(list(self.terms.values())).sum(0)

    @property
    def resource_weights(self) -> tuple[Tensor, ...]:
        """Current weights of the resource rewards among the parts, [N] each."""
        return tuple(weight for part in self.rewarders for weight in getattr(part, "resource_weights", ()))

    @override
    def recorded(self, env: int) -> RecordedProgress:
        """Return what the first part that has something to record knows."""
        told = [part.recorded(env) for part in self.rewarders]
        return next((progress for progress in told if progress.kind or progress.track_kind or progress.marks), told[0])

    @override
    def share(self, links: Tensor) -> None:
        for part in self.checked:
            part.share(links)

    def counts(self) -> dict[str, Tensor]:
        """See :meth:`GlobalReward.counts`; names used by several parts are numbered."""
        return _joined(part.counts() for part in self.checked)

    def measures(self) -> dict[str, Tensor]:
        """See :meth:`GlobalReward.measures`; names used by several parts are numbered."""
        return _joined(part.measures() for part in self.checked)

    @override
    def is_terminated(self) -> Tensor:
        return torch.stack([part.terminated() for part in self.checked]).any(0)

    @override
    def is_truncated(self) -> Tensor:
        return torch.stack([part.truncated() for part in self.checked]).any(0)


def _numbered(names: Iterable[str]) -> list[str]:
    unique_names: list[str] = []
    for name in names:
        unique, number = name, 1
        while unique in unique_names:
            number += 1
            unique = f"{name}_{number}"
        unique_names.append(unique)
    return unique_names


def _joined(tables: Iterable[dict[str, Tensor]]) -> dict[str, Tensor]:
    pairs = [pair for table in tables for pair in table.items()]
    return dict(zip(_numbered(name for name, _ in pairs), (value for _, value in pairs), strict=True))


TOTAL = "cum_reward"
"""Field of the state with the sums of a rewarder, [N, S]; the fields of its parts are numbered."""


def declare_totals(rewarder: GlobalReward, fleet: SatelliteFleet) -> None:
    """Declare the sums of a rewarder and of its parts in the state of a fleet."""
    for k, part in enumerate(_parts(rewarder)):
        name = f"{TOTAL}_{k}" if k else TOTAL
        fleet.state.declare(name, 0.0, fleet.size, low=-FINITE, high=FINITE)
        part.__dict__["total_name"] = name


def add_totals(rewarder: GlobalReward, reward: Tensor, moves: Tensor) -> None:
    """Add the rewards [N, S] of a step to the sums of a rewarder and its parts; ``moves`` [N] are the episodes that took it."""
    state = rewarder.fleet.state
    state[rewarder.total_name] = state[rewarder.total_name] + reward
    if isinstance(rewarder, ComposedReward):
        for part, term in zip(rewarder.rewarders, rewarder.terms.values(), strict=True):
            add_totals(part, term * moves.unsqueeze(-1), moves)


def _parts(rewarder: GlobalReward) -> Iterator[GlobalReward]:
    yield rewarder
    if isinstance(rewarder, ComposedReward):
        for part in rewarder.rewarders:
            yield from _parts(part)
