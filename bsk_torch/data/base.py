"""Base class of rewarders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from bsk_torch.sim.hooks import check_class

if TYPE_CHECKING:
    from bsk_torch.scene.base import Scenario
    from bsk_torch.sim.fleet import Fleet
    from bsk_torch.sim.state import StateTable

Log = dict[str, Tensor]
"""Properties of the satellites at a decision boundary by name, [N, S, ...] each."""

HOOKS = ("link", "read_log", "calculate_reward", "share", "counts", "is_terminated", "is_truncated")
"""Members of :class:`GlobalReward` that subclasses may define."""

LOGS = "define read_log(), and calculate_reward(before, after), which gets what it returned before and after a step"
MEMORY = (
    "keep values that start anew with every episode in fleet.memory, where link(scenario, fleet) declares them: "
    "memory.declare(name, initial_value, *shape)"
)

UNUSED = {
    "reward": "define calculate_reward(before, after)",
    "get_log_state": LOGS,
    "compare_log_states": LOGS,
    "update_from_logs": LOGS,
    "data_type": LOGS,
    "data_store_type": LOGS,
    "datastore_type": LOGS,
    "create_data_store": MEMORY,
    "initial_data": MEMORY,
    "link_scenario": "define link(scenario, fleet)",
    "link_satellite": "define link(scenario, fleet); fleet.each(function) reads a property of all satellites",
    "link_simulator": "define link(scenario, fleet)",
    "stage_communicated_data": "define share(links)",
    "update_with_communicated_data": "define share(links)",
    "reset_overwrite_previous": MEMORY,
    "reset_pre_sim_init": MEMORY,
    "reset_during_sim_init": MEMORY,
    "reset_post_sim_init": MEMORY,
}
"""Names that are no hooks of rewarders, those of bsk_rl among them, and what to write instead."""


class GlobalReward:
    """Base of rewarders, which score a step by the logs of the satellites before and after it.

    Subclasses define :meth:`calculate_reward`, and :meth:`read_log` for what it needs; the other hooks are optional. N is the
    number of episodes, S that of satellites in each; :meth:`bsk_torch.sim.fleet.Fleet.each` reads a property of all satellites.

    Attributes:
        scenario: The scenario, once an environment has been built.
        fleet: The satellites, once an environment has been built.
    """

    scenario: Any
    fleet: Fleet

    total_name: str
    """Field of the state with :attr:`cum_reward`; see :mod:`bsk_torch.data.totals`."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse definitions that no environment would use; TypeError says what to write instead."""
        super().__init_subclass__(**options)
        check_class(cls, GlobalReward, HOOKS, UNUSED)

    def link(self, scenario: Scenario, fleet: Fleet) -> None:
        """Prepare for a scenario and its satellites; called once when an environment is built.

        Overriding methods call ``super().link(scenario, fleet)`` first, and raise ValueError for a scenario or satellites that do
        not fit.
        """
        self.scenario, self.fleet = scenario, fleet

    @property
    def memory(self) -> StateTable:
        """Tensors [N, ...] that start anew with every episode; ``memory.declare(name, initial, *shape)`` in ``link`` adds one."""
        return self.fleet.memory

    @property
    def cum_reward(self) -> dict[str, Tensor]:
        """Reward of each satellite in the present episodes so far, without failure penalties: [N] float64 by its name.

        AttributeError for a rewarder that belongs to no environment.
        """
        if not hasattr(self, "total_name"):
            raise AttributeError("cum_reward is read from the rewarder of an environment: env.rewarder.cum_reward")
        return dict(zip(self.fleet.names, self.fleet.state[self.total_name].unbind(1), strict=True))

    def read_log(self) -> Log:
        """Return the present log, read at every decision boundary; tensors [N, S, ...] by name."""
        return {}

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """Return the reward of each satellite for a step, [N, S] float64, from the logs before and after it."""
        raise NotImplementedError(f"{type(self).__name__} must implement calculate_reward(before, after)")

    def share(self, links: Tensor) -> None:
        """Spread knowledge of collected data after a step.

        Args:
            links: Whether a satellite (second dimension) sends its knowledge to another one (third dimension), [N, S, S] bool.
        """

    def counts(self) -> dict[str, Tensor]:
        """Return counters of the present episodes by name, [N, S] int64 each; environments put them under ``counts``."""
        return {}

    def is_terminated(self) -> Tensor:
        """Return the satellites whose episode the rewarder terminates, [N, S] bool."""
        return torch.zeros(self.fleet.num_envs, self.fleet.size, dtype=torch.bool, device=self.fleet.device)

    def is_truncated(self) -> Tensor:
        """Return the satellites whose episode the rewarder truncates, [N, S] bool."""
        return torch.zeros(self.fleet.num_envs, self.fleet.size, dtype=torch.bool, device=self.fleet.device)


class NoReward(GlobalReward):
    """Zero for every step."""

    def calculate_reward(self, before: Log, after: Log) -> Tensor:
        """See :meth:`GlobalReward.calculate_reward`."""
        return torch.zeros(self.fleet.num_envs, self.fleet.size, dtype=torch.float64, device=self.fleet.device)
