"""The rest of the best sequence that a planner has found, which its next decision must not fall behind.

Without it, a planner that looks several actions ahead may take the first one and then not find the second again: its returns may
be worse than those of its base. Source: fortified rollout, D. P. Bertsekas, J. N. Tsitsiklis, C. Wu, J. Heuristics 3, 1997.
"""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.env import Tasking


class PlanCache:
    """Actions that are to follow the last decision of each of N episodes.

    Attributes:
        plan: Numbers of actions [N, D], -1 behind the last one, or real numbers [N, D, W], NaN behind it.
        slot: Agent, [N].
        made: Seed, episode and tick of the decision, [N, 3].
    """

    def __init__(self, num_envs: int, blank: Tensor) -> None:
        """Keep nothing yet; ``blank`` is an empty plan, [D] or [D, W]."""
        self.blank = blank
        self.plan = blank.expand(num_envs, *blank.shape).clone()
        self.slot = torch.full((num_envs,), -1, device=blank.device)
        self.made = torch.full((num_envs, 3), -1, device=blank.device)

    def keep(self, env: Tasking, rows: Tensor, slot: Tensor, plan: Tensor) -> None:
        """Keep what follows the first action of ``plan`` [n, D, ...] in episodes ``rows`` [n]."""
        rest = torch.cat([plan[:, 1:], self.blank[:1].expand(len(rows), 1, *self.blank.shape[1:])], 1)
        self.plan[rows], self.slot[rows], self.made[rows] = rest.to(self.plan.dtype), slot, self._now(env, rows)

    def look_up(self, env: Tasking, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        """Return plans [n, D, ...] of agents ``slot`` [n], and whether there are any, [n]: from earlier in the same episode."""
        made, now, plan = self.made[rows], self._now(env, rows), self.plan[rows]
        same = (made[:, :2] == now[:, :2]).all(1) & (made[:, 2] < now[:, 2]) & (self.slot[rows] == slot)
        first = plan[:, 0]
        there = ~torch.isnan(first).any(1) if first.ndim == 2 else first >= 0
        return plan, same & there

    @staticmethod
    def _now(env: Tasking, rows: Tensor) -> Tensor:
        return torch.stack([env.state.seed[rows], env.state.episode[rows], env.fleet.ticks[rows]], 1)
