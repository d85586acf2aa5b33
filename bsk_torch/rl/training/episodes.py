"""Averages over the episodes that end while experience is collected."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import whole

MEASURES = ("return", "survival", "collected", "fill")
"""The four measures that the BSK-RL paper follows over training."""

MEANS = (*MEASURES, "decisions")
"""Names of the averages."""


class RecentEpisodes:
    """Means over the episodes that ended last.

    The first episode of each environment does not count: short ones end first, and it may have been cut.
    """

    def __init__(self, num_envs: int, penalty: float) -> None:
        """Follow ``num_envs`` environments, in which dying is rewarded with ``penalty``, and average over as many episodes."""
        self.penalty = penalty
        self.ended: deque[tuple[float, ...]] = deque(maxlen=num_envs)
        self.returns, self.decisions = torch.zeros(num_envs, dtype=torch.float64), torch.zeros(num_envs, dtype=torch.float32)
        self.first = torch.ones(num_envs, dtype=torch.bool)
        self.count = 0

    def add(self, reward: Tensor, done: Tensor, survived: Tensor, fill: Tensor | None) -> None:
        """Take a batch into account.

        Args:
            reward: Rewards [N, T] in order of time.
            done: Where episodes end, [N, T].
            survived: Whether they do so alive, [N, T].
            fill: What the data buffer holds after each step, fraction [N, T]; None if it is not observed.
        """
        columns = (part.cpu().unbind(1) for part in (reward.double(), done, survived))
        for step, (earned, ends, alive) in enumerate(zip(*columns, strict=True)):
            self.returns, self.decisions = self.returns + earned, self.decisions + 1
            counts = ends & ~self.first
            self.first = self.first & ~ends
            level = torch.full_like(self.returns, torch.nan) if fill is None else fill[:, step].cpu()
            collected = self.returns - self.penalty * (~alive).to(self.returns.dtype)
            rows = torch.stack([self.returns, alive, collected, level, self.decisions], 1)[counts]
            self.ended.extend(tuple(row) for row in rows.tolist())
            self.count += int(ends.sum())
            self.returns, self.decisions = (x.masked_fill(ends, 0) for x in (self.returns, self.decisions))

    def means(self) -> dict[str, float]:
        """Means by name, see :data:`MEANS`; nan before the first end."""
        if not self.ended:
            return dict.fromkeys(MEANS, float("nan"))
        return {name: sum(column) / len(self.ended) for name, column in zip(MEANS, zip(*self.ended, strict=True), strict=True)}

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        state = {name: getattr(self, name) for name in ("returns", "decisions", "first", "count")}
        return state | {"ended": list(self.ended)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned; ValueError if it is of another number of environments."""
        for name in ("returns", "decisions", "first"):
            if state[name].shape != self.returns.shape:
                raise ValueError(f"{name!r} has shape {tuple(state[name].shape)}, not {tuple(self.returns.shape)}")
        for name in ("returns", "decisions", "first", "count"):
            setattr(self, name, state[name])
        whole("count", self.count, 0)
        for row in state["ended"]:
            if len(row) != len(MEANS):
                raise ValueError(f"an ended episode has {len(row)} numbers, not {len(MEANS)}")
            self.ended.append(tuple(map(float, row)))
