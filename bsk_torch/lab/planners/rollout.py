"""Rollout: try every action, continue with the base policy, and take the best action.

Source: D. P. Bertsekas, J. N. Tsitsiklis, C. Wu, "Rollout algorithms for combinatorial optimization", J. Heuristics 3, 1997. With
an exact model and a horizon at the end of the episode, the planner is never worse than its base policy.
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from typing_extensions import override

from bsk_torch._checks import whole
from bsk_torch.env import Tasking
from bsk_torch.lab.planners.base_policies import Base
from bsk_torch.lab.planners.planner import Planner
from bsk_torch.lab.planners.priors import Prior


class Rollout(Planner):
    """Planner that simulates each action in a copy, followed by the base policy, and takes the action with the best return.

    The base policy's action is kept unless another one is better.
    """

    name: ClassVar[str] = "rollout"

    def __init__(
        self, env: Tasking, base: Base = None, *, horizon: float = 240.0, budget: int | None = None, **options: Any
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
        mine = self.slots.at(self.slots.chosen(td)[rows], slot)
        tried = self._tried(td, rows, slot, mine)
        totals, simulated = self._returns(td, memory, rows, slot, tried & (tried.sum(1, keepdim=True) > 1))
        q = totals.mean(1).nan_to_num(nan=-torch.inf).repeat_interleave(self._copies, 0)
        self._note(rows, slot, q)
        return self._preferred(q, mine), simulated

    def _returns(
        self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor, tried: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the returns of the actions ``tried`` [n, A] in each future, [n, futures, A], NaN for others, and seconds [n]."""
        totals = torch.full((len(rows), self._copies, tried.shape[1]), torch.nan, dtype=torch.float64, device=td.device)
        seconds = torch.zeros(len(rows), dtype=torch.float64, device=td.device)
        chosen = torch.nonzero(tried)
        if not len(chosen):
            return totals, seconds
        total, simulated = self._flown(td, memory, rows, slot, chosen)
        totals[chosen[:, 0], :, chosen[:, 1]] = total
        return totals, seconds.index_add(0, chosen[:, 0], simulated)

    def _tried(self, td: TensorDictBase, rows: Tensor, slot: Tensor, mine: Tensor) -> Tensor:
        """Return the actions to try, [n, A], including the base policy's."""
        legal = self.slots.at(self.slots.legal(td)[rows], slot)
        own = torch.nn.functional.one_hot(mine, legal.shape[1]).bool()
        if self.budget is None or self.budget >= legal.shape[1]:
            return legal | own
        weight = self._prior(td[rows], slot, legal).masked_fill(own, torch.inf)
        best = torch.zeros_like(legal).scatter(1, weight.topk(self.budget, 1).indices, True)
        return (legal & best) | own

    def _flown(
        self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor, tried: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return returns [J, futures] and simulated seconds [J]; ``tried`` [J, 2] has indices into ``rows`` and actions."""
        which, action = tried.unbind(1)
        if self.futures is None:
            source, places, each = self.env, rows[which], which
        else:
            source = self._store(len(rows) * self.futures)
            self._plant(source, torch.arange(len(rows) * self.futures, device=rows.device), rows)
            places = (which.unsqueeze(1) * self.futures + torch.arange(self.futures, device=rows.device)).flatten()
            each, action = which.repeat_interleave(self.futures), action.repeat_interleave(self.futures)
        jobs = self._jobs(td, memory, rows[each], slot[each], action.unsqueeze(1), places)
        flown = self.branches.fly(source, jobs)
        total = self._discounting.before(flown.reward, flown.seconds, flown.rest)
        shape = (len(which), self._copies)
        return total.view(shape), flown.simulated.view(shape).sum(1)
