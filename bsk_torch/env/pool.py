"""Episodes prepared in bulk.

Solving orbits and windows for a few rows costs as much as for dozens, and in a large batch a few rows end at every step.
So a second simulation holds the next episode of every environment; when one is missing, all that have been used are refilled at
once. Draws do not depend on when they are made: an episode is the same, bit for bit, with and without a pool.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.rand import Key
from bsk_torch.sim.simulator import Simulator

SMALLEST = 32
"""Batch size from which a pool pays."""


class EpisodePool:
    """The next episode of every environment, in ``simulator``; ``limit`` [N] is its time limit, s."""

    def __init__(self, simulator: Simulator) -> None:
        """Keep episodes in ``simulator``, which nothing else uses."""
        self.simulator = simulator
        unset = torch.full_like(simulator.ticks, -1)
        self.seed, self.episode, self.filled = unset, unset.clone(), torch.zeros_like(unset, dtype=torch.bool)
        self.limit = torch.zeros_like(simulator.sim_time)

    def fill(
        self,
        rows: Tensor,
        seeds: Tensor,
        env_ids: Tensor,
        episodes: Tensor,
        limit_of: Callable[[Key], Tensor],
        generation: Callable[[Tensor], Tensor],
    ) -> None:
        """Make sure that ``rows`` hold the episodes ``episodes`` [N] under ``seeds`` [N]; all stale rows are refilled at once."""
        stale = ~self.filled | (self.seed != seeds) | (self.episode != episodes)
        if not bool(stale[rows].any()):
            return
        used = torch.nonzero(stale).squeeze(-1)
        key = Key(seeds[used].cpu(), env_ids[used].cpu(), episodes[used].cpu())
        values, limit = self.simulator.draw(key), limit_of(key).to(self.limit.device)
        self.simulator.reset(used, values, generation(limit))
        self.limit[used], self.filled[used] = limit, True
        self.seed, self.episode = torch.where(stale, seeds, self.seed), torch.where(stale, episodes, self.episode)
