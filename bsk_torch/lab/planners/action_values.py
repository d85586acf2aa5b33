"""Returns of all legal actions at every decision of a policy, from branches of the episode."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.env.rollout import ACTION_VALUE
from bsk_torch.lab.planners.agent_table import AgentTable
from bsk_torch.lab.planners.base_policies import Base
from bsk_torch.lab.planners.rollout import Rollout

__all__ = ["ACTION_VALUE", "ACTION_VALUES", "ActionValues"]

ACTION_VALUES = "action_values"
"""Key of the returns of actions in each future, [N, S, futures, A]."""


class ActionValues(Rollout):
    """Plays its base policy, and writes the return of every legal action of the agents that decide.

    The value of an action is the return of a branch that takes it and then follows the base policy, up to the horizon: the action
    value of the base policy. Without futures, it is exact for deterministic environments; the value of the chosen action is then
    the rest of the return of the episode, if the horizon does not cut it. Agents of a constellation are judged one at a time,
    with the actions of the base policy for all others.
    """

    name: ClassVar[str] = "values"
    _values: Tensor

    def __init__(
        self, env: Tasking, base: Base = None, *, horizon: float = float("inf"), gamma: float = 1.0, **options: Any
    ) -> None:
        """See :class:`~bsk_torch.lab.planners.planner.Planner` for the other arguments, and for errors.

        Args:
            env: The environment in which the policy acts.
            base: The policy.
            horizon: Length of branches, s (default: to the end of the episode).
            gamma: Discount per second.
            **options: Further arguments of :class:`~bsk_torch.lab.planners.planner.Planner`.
        """
        super().__init__(env, base, horizon=horizon, gamma=gamma, **options)
        self.out_keys = [*self.out_keys, ACTION_VALUES]

    def _check_actions(self, env: Tasking, slots: AgentTable) -> None:
        """Raise ValueError unless some agent has numbered actions, all of which can be tried."""
        if all(n <= 1 for n in slots.n_actions):
            names = ", ".join(dict.fromkeys(slots.acting))
            raise ValueError(f"returns are computed of numbered actions; those of {names} are real numbers")
        super()._check_actions(env, slots)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the actions of the base policy, and the returns of all actions.

        ``action_value`` [N, S, A] has the mean over futures, and ``action_values`` [N, S, futures, A] the return in each: of S
        agents, with at most A actions, in the order of the environment's groups. Illegal actions, actions of agents that do not
        decide, and those of ended episodes have NaN.
        """
        slots, n = self.slots, self.env.num_envs
        shape = (n, slots.size, self._copies, slots.most_actions)
        self._values = torch.full(shape, torch.nan, dtype=torch.float64, device=self.env.device)
        tensordict = super().forward(tensordict)
        tensordict.set(ACTION_VALUES, self._values)
        return tensordict.set(ACTION_VALUE, self._values.mean(2))

    def _improved(self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        """Note the returns of the legal actions; return those of the base policy."""
        mine = self.slots.at(self.slots.chosen(td)[rows], slot)
        self._values[rows, slot], simulated = self._returns(td, memory, rows, slot, self._tried(td, rows, slot, mine))
        return mine, simulated
