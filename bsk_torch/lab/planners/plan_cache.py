"""Remainder of the best sequence found by a planner, a lower bound for its next decision.

Without it, a planner over several actions may take the first action of a sequence and then not find the second one again, so its
returns could be worse than those of its base policy. Source: fortified rollout, D. P. Bertsekas, J. N. Tsitsiklis, C. Wu,
J. Heuristics 3, 1997.
"""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.env import Tasking


class PlanCache:
    """Planned actions after the last decision of each of N episodes.

    Attributes:
        plan: Discrete actions [N, D], padded with -1, or continuous actions [N, D, W], padded with NaN.
        slot: Agent, [N].
        made: Seed, episode and tick of the decision, [N, 3].
    """

    def __init__(self, num_envs: int, blank: Tensor) -> None:
        """Start without plans; ``blank`` is an empty plan, [D] or [D, W]."""
        self.blank = blank
        self.plan = blank.expand(num_envs, *blank.shape).clone()
        self.slot = torch.full((num_envs,), -1, device=blank.device)
        self.made = torch.full((num_envs, 3), -1, device=blank.device)

    def keep(self, env: Tasking, rows: Tensor, slot: Tensor, plan: Tensor) -> None:
        """Keep the actions after the first one of ``plan`` [n, D, ...] for the episodes ``rows`` [n]."""
        rest = torch.cat([plan[:, 1:], self.blank[:1].expand(len(rows), 1, *self.blank.shape[1:])], 1)
        self.plan[rows], self.slot[rows], self.made[rows] = rest.to(self.plan.dtype), slot, self._now(env, rows)

    def look_up(self, env: Tasking, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        """Return plans [n, D, ...] of agents ``slot`` [n] from earlier in the same episode, and whether they exist, [n]."""
        made, now, plan = self.made[rows], self._now(env, rows), self.plan[rows]
        same = (made[:, :2] == now[:, :2]).all(1) & (made[:, 2] < now[:, 2]) & (self.slot[rows] == slot)
        first = plan[:, 0]
        there = ~torch.isnan(first).any(1) if first.ndim == 2 else first >= 0
        return plan, same & there

    @staticmethod
    def _now(env: Tasking, rows: Tensor) -> Tensor:
        return torch.stack([env.state.seed[rows], env.state.episode[rows], env.fleet.ticks[rows]], 1)
