"""Rollout: try every action, continue with the base policy, and take the best action, or only note the returns of all.

Source: D. P. Bertsekas, J. N. Tsitsiklis, C. Wu, "Rollout algorithms for combinatorial optimization", J. Heuristics 3, 1997. With
an exact model and a horizon at the end of the episode, the planner is never worse than its base policy.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from typing_extensions import Unpack, override

from bsk_torch._checks import whole
from bsk_torch.env import Tasking
from bsk_torch.env.rollout import ACTION_VALUE
from bsk_torch.lab.planners.agent_table import AgentTable
from bsk_torch.lab.planners.base_policies import Base
from bsk_torch.lab.planners.planner import DiscountOptions, Planner, PlannerOptions
from bsk_torch.lab.planners.priors import Prior

ACTION_VALUES = "action_values"
"""Key of the returns of actions in each future, [N, S, futures, A]."""


class Rollout(Planner):
    """Planner that simulates each action in a copy, followed by the base policy, and takes the action with the best return.

    The base policy's action is kept unless another one is better.
    """

    name: ClassVar[str] = "rollout"

    def __init__(
        self,
        env: Tasking,
        base: Base = None,
        *,
        horizon: float = 240.0,
        budget: int | None = None,
        **options: Unpack[DiscountOptions],
    ) -> None:
        """See :class:`~bsk_torch.lab.planners.planner.Planner` for the other arguments, and for errors.

        Args:
            env: The environment in which the planner acts.
            base: The base policy.
            horizon: Length of branches, s.
            budget: Number of actions tried for a decision, in the order of the base policy's preference; None for all legal ones.
            **options: Further arguments of :class:`~bsk_torch.lab.planners.planner.Planner`.
        """
        self.budget = None if budget is None else whole("budget", budget, 1)
        super().__init__(env, base, horizon=horizon, **options)
        self._prior = Prior(self.base, self.slots, self.budget or 1)

    def _branching(self) -> int:
        return min(self.budget or self.slots.most_actions, self.slots.most_actions)

    @override
    def _improved(self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        base = self.slots.at(self.slots.chosen(td)[rows], slot)
        tried = self._tried(td, rows, slot, base)
        totals, simulated = self._returns(td, memory, rows, slot, tried & (tried.sum(1, keepdim=True) > 1))
        q = totals.mean(1).nan_to_num(nan=-torch.inf).repeat_interleave(self._copies, 0)
        self._note(rows, slot, q)
        return self._preferred(q, base), simulated

    def _returns(
        self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor, tried: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the returns of the actions ``tried`` [n, A] in each future, [n, futures, A], NaN for others, and seconds [n]."""
        totals = torch.full((len(rows), self._copies, tried.shape[1]), torch.nan, dtype=torch.float64, device=td.device)
        seconds = torch.zeros(len(rows), dtype=torch.float64, device=td.device)
        chosen = torch.nonzero(tried)
        if not len(chosen):
            return totals, seconds
        which, action = chosen.unbind(1)
        total, flown = self._flown(td, memory, rows, slot, which, action.unsqueeze(1))
        totals[which, :, action] = total
        return totals, seconds.index_add(0, which, flown.simulated.view(len(which), -1).sum(1))

    def _tried(self, td: TensorDictBase, rows: Tensor, slot: Tensor, base: Tensor) -> Tensor:
        """Return the actions to try, [n, A], including the base policy's."""
        legal = self.slots.at(self.slots.legal(td)[rows], slot)
        is_base = torch.nn.functional.one_hot(base, legal.shape[1]).bool()
        if self.budget is None or self.budget >= legal.shape[1]:
            return legal | is_base
        weight = self._prior(td[rows], slot, legal).masked_fill(is_base, torch.inf)
        best = torch.zeros_like(legal).scatter(1, weight.topk(self.budget, 1).indices, True)
        return (legal & best) | is_base


class ValueOptions(PlannerOptions, total=False):
    """Further arguments of :class:`ActionValues`."""

    budget: int | None


class JudgeOptions(ValueOptions, total=False):
    """All arguments of :class:`ActionValues` behind its policy."""

    horizon: float
    gamma: float


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
        self,
        env: Tasking,
        base: Base = None,
        *,
        horizon: float = float("inf"),
        gamma: float = 1.0,
        **options: Unpack[ValueOptions],
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

    @override
    def _check_actions(self, slots: AgentTable) -> None:
        if all(n <= 1 for n in slots.n_actions):
            names = ", ".join(dict.fromkeys(slots.acting))
            raise ValueError(f"returns are computed of numbered actions; those of {names} are real numbers")
        super()._check_actions(slots)

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

    @override
    def _improved(self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        base = self.slots.at(self.slots.chosen(td)[rows], slot)
        self._values[rows, slot], simulated = self._returns(td, memory, rows, slot, self._tried(td, rows, slot, base))
        return base, simulated
