"""Calls of a rewarder's hooks with checks of their results.

Environments and :class:`~bsk_torch.data.ComposedReward` call hooks only through a :class:`CheckedRewarder`. A tensor of a wrong
shape therefore raises an error naming the hook, instead of being broadcast to a wrong reward. The checks read shapes and dtypes,
and values of users' rewarders only.
"""

from __future__ import annotations

from collections.abc import Collection

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.data.base import GlobalReward, Log
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.sim.hooks import ChangeGuard, check_linked, check_tensor, is_of_package
from bsk_torch.sim.state import SHOWN

REWARD_MEMORY = (
    "keep values that are reset with every episode in self.fleet.memory, where link(scenario, fleet) declares them: "
    "fleet.memory.declare(name, initial_value, fleet.size)"
)
"""Advice for rewarders that keep values of episodes themselves."""


class CheckedRewarder:
    """The hooks of a rewarder, with checks of their results."""

    def __init__(self, rewarder: GlobalReward) -> None:
        """Call the hooks of ``rewarder``."""
        self.rewarder, self._name = rewarder, type(rewarder).__name__
        self._guard = None if is_of_package(type(rewarder)) else ChangeGuard()
        self.terminates = rewarder.defines("is_terminated")
        self.truncates = rewarder.defines("is_truncated")

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """Link the rewarder; TypeError if a subclass does not pass the call on to its base class."""
        self.rewarder.link(scenario, fleet)
        check_linked(self.rewarder, "link(scenario, fleet)", fleet)

    def log(self) -> Log:
        """Return the log of the current state; TypeError unless it is a dictionary of tensors [N, S, ...]."""
        log, shape = self.rewarder.read_log(), self.rewarder.fleet.shape
        if not isinstance(log, dict):
            raise TypeError(f"{self._name}.read_log() returns {log!r}; it must return a dictionary of tensors")
        for name, value in log.items():
            if not isinstance(value, Tensor) or value.shape[:2] != shape:
                check_tensor(f"{self._name}.read_log()[{name!r}]", value, shape)
        return log

    def reward(self, before: Log, after: Log) -> Tensor:
        """Return the reward of a step, [N, S]; FloatingPointError if that of a user's rewarder is NaN or infinite."""
        with torch.enable_grad():  # so that a reward that depends on parameters can be told
            reward = self.rewarder.calculate_reward(before, after)
        title = f"{self._name}.calculate_reward()"
        check_tensor(title, reward, self.rewarder.fleet.shape, torch.float64, torch.float32)
        if self._guard is not None:
            rows = torch.nonzero(~torch.isfinite(reward).all(1)).squeeze(-1).tolist()
            if rows:
                raise FloatingPointError(f"{title} is NaN or infinite for environments {rows[:SHOWN]} ({len(rows)} in all)")
            self._guard.check(self.rewarder, REWARD_MEMORY)
        return no_gradient(title, reward)

    def terminated(self) -> Tensor:
        """Return the satellites whose episode the rewarder terminates, [N, S] bool; TypeError for a wrong shape or dtype."""
        flags = self.rewarder.is_terminated()
        check_tensor(f"{self._name}.is_terminated()", flags, self.rewarder.fleet.shape, torch.bool)
        return flags

    def truncated(self) -> Tensor:
        """Return the satellites whose episode the rewarder truncates, [N, S] bool; TypeError for a wrong shape or dtype."""
        flags = self.rewarder.is_truncated()
        check_tensor(f"{self._name}.is_truncated()", flags, self.rewarder.fleet.shape, torch.bool)
        return flags

    def share(self, links: Tensor) -> None:
        """Share knowledge along ``links`` [N, S, S] bool; TypeError if the hook returns a value, which would be lost."""
        if self.rewarder.share(links) is not None:  # type: ignore[func-returns-value]
            raise TypeError(f"{self._name}.share(links) must return None; keep what it computes in fleet.memory")

    def measures(self) -> dict[str, Tensor]:
        """Return the measures of the rewarder, [N] float64 each; TypeError for one with a wrong shape or dtype."""
        measures = self.rewarder.measures()
        for name, value in measures.items():
            check_tensor(f"{self._name}.measures()[{name!r}]", value, self.rewarder.fleet.shape[:1], torch.float64)
        return measures

    def counts(self, taken: Collection[str] = ()) -> dict[str, Tensor]:
        """Return the counters of the rewarder, [N, S] int64 each."""
        counters = self.rewarder.counts()
        if not isinstance(counters, dict):
            raise TypeError(f"{self._name}.counts() returns {counters!r}; it must return a dictionary of tensors")
        for name, value in counters.items():
            check_tensor(f"{self._name}.counts()[{name!r}]", value, self.rewarder.fleet.shape, torch.int64)
            if name in taken:
                raise ValueError(f"{self._name}.counts() has {name!r}, which the satellites count, too; rename it")
        return counters
