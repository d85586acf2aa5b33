"""Base class of rewarders."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.recorded import RecordedProgress
from bsk_torch.sim.hooks import check_class, check_tensor, overrides
from bsk_torch.sim.state import StateTable

Log = dict[str, Tensor]
"""Properties of the satellites at a decision boundary by name, [N, S, ...] each."""

HOOKS = ("link", "read_log", "calculate_reward", "share", "counts", "measures", "is_terminated", "is_truncated", "recorded")
"""Members of :class:`GlobalReward` that subclasses may define."""


class GlobalReward:
    """Base class of rewarders, which compute rewards from logs read before and after a step.

    Subclasses define :meth:`calculate_reward`, and :meth:`read_log` to read the values it needs; the other hooks are optional. N
    is the number of episodes, S the number of satellites in each. :meth:`bsk_torch.sim.fleet.Fleet.each` reads a property of all
    satellites.

    Attributes:
        scenario: The scenario, once an environment has been built.
        fleet: The satellites, once an environment has been built.
    """

    scenario: Scenario
    fleet: SatelliteFleet

    total_name: str
    """Field of the state with :attr:`cum_reward`; see :mod:`bsk_torch.data.composed`."""

    _in_channel: Tensor | None = None
    """Satellites of the channel of a rewarder in a :class:`bsk_torch.data.MixedReward`, [S] bool; None elsewhere."""

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, GlobalReward, HOOKS)

    def link(self, scenario: Scenario, fleet: SatelliteFleet) -> None:
        """Prepare for a scenario and its satellites; called once when an environment is built.

        Overriding methods call ``super().link(scenario, fleet)`` first, and raise ValueError for an unsuitable scenario or
        satellites.
        """
        self.scenario, self.fleet = scenario, fleet

    def recorded(self, env: int) -> RecordedProgress:
        """Return what is known of the current episode of environment ``env``, for recordings (default: nothing)."""
        return RecordedProgress()

    @property
    def observed_columns(self) -> Sequence[int]:
        """Indices of the satellites of an episode whose flights count for the reward, other than by their own logs."""
        return ()

    @property
    def memory(self) -> StateTable:
        """Tensors [N, ...] reset with every episode; ``memory.declare(name, initial, *shape)`` in ``link`` adds one."""
        return self.fleet.memory

    @property
    def cum_reward(self) -> dict[str, Tensor]:
        """Total reward of each satellite in the current episodes, without failure penalties: [N] float64 by name."""
        if not hasattr(self, "total_name"):
            raise AttributeError("cum_reward is read from the rewarder of an environment: env.rewarder.cum_reward")
        return dict(zip(self.fleet.names, self.fleet.state[self.total_name].unbind(1), strict=True))

    @property
    def step_duration(self) -> Tensor:
        """Duration of the current step, [N] s; for :meth:`calculate_reward`."""
        return (self.fleet.ticks - self.fleet.since).double() * self.fleet.h

    def read_log(self) -> Log:
        """Return the log of the current state, read at every decision: tensors [N, S, ...] by name."""
        return {}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """Return the reward of each satellite for a step, [N, S] float64, from the logs before and after it."""
        raise NotImplementedError(f"{type(self).__name__} must implement calculate_reward(before, after)")

    def of_channel(self, reward: Tensor) -> Tensor:
        """Return a reward [N, S] with zeros for satellites outside of the rewarder's channel in a ``data.MixedReward``.

        Elsewhere the reward is returned unchanged. TypeError for a wrong shape, or a dtype that is not floating-point.
        """
        if self._in_channel is None:
            return reward
        check_tensor(f"{type(self).__name__}.of_channel(reward)", reward, self.fleet.shape, torch.float64, torch.float32)
        return torch.where(self._in_channel, reward, 0.0)

    def share(self, links: Tensor) -> None:
        """Share knowledge of collected data after a step, along ``links`` [N, S, S] bool by episode, sender and receiver."""

    def defines(self, hook: str) -> bool:
        """Return whether a hook is more than that of this class; not to be overridden."""
        return overrides(self, GlobalReward, hook)

    def group_of(self, name: str) -> Hashable:
        """Return what differs between satellites that are simulated as different types; not to be overridden."""
        return None

    def counts(self) -> dict[str, Tensor]:
        """Return counters of the current episodes by name, [N, S] int64 each; environments return them under ``counts``."""
        return {}

    def measures(self) -> dict[str, Tensor]:
        """Return measures of the current episodes by name, [N] float64 each, which evaluations show besides returns.

        Means are over the episodes in which a measure is not NaN.
        """
        return {}

    def is_terminated(self) -> Tensor:
        """Return the satellites whose episode the rewarder terminates, [N, S] bool."""
        return torch.zeros(self.fleet.shape, dtype=torch.bool, device=self.fleet.device)

    def is_truncated(self) -> Tensor:
        """Return the satellites whose episode the rewarder truncates, [N, S] bool."""
        return torch.zeros(self.fleet.shape, dtype=torch.bool, device=self.fleet.device)


class NoReward(GlobalReward):
    """Zero for every step."""

    @override
    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        return torch.zeros(self.fleet.shape, dtype=torch.float64, device=self.fleet.device)
