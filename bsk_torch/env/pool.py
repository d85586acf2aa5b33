"""Episodes prepared in bulk.

Solving orbits and windows for a few rows costs as much as for dozens, and in a large batch a few rows end at every step.
So a second fleet holds the next episode of every environment; when one is missing, all that have been used are refilled at
once. Draws do not depend on when they are made: an episode is the same, bit for bit, with and without a pool.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.rand import Key
from bsk_torch.sim.fleet import Drawn, Fleet

SMALLEST = 32
"""Number of satellites in a batch from which a pool pays."""


class EpisodePool:
    """The next episode of every environment, in ``fleet``; ``limit`` [N] is its time limit, s."""

    def __init__(self, fleet: Fleet) -> None:
        """Keep episodes in ``fleet``, which nothing else uses."""
        self.fleet = fleet
        unset = torch.full_like(fleet.ticks, -1)
        self.seed, self.episode, self.filled = unset, unset.clone(), torch.zeros_like(unset, dtype=torch.bool)
        self.limit = torch.zeros_like(fleet.sim_time)

    def fill(
        self,
        rows: Tensor,
        seeds: Tensor,
        env_ids: Tensor,
        episodes: Tensor,
        draw: Callable[[Fleet, Key], tuple[Drawn, Tensor]],
        start: Callable[[Fleet, Tensor, Drawn, Tensor], None],
    ) -> None:
        """Make sure that ``rows`` hold the episodes ``episodes`` [N] under ``seeds`` [N]; all stale rows are refilled at once.

        ``draw`` gives what episodes start from and their time limits, ``start`` begins them in a fleet.
        """
        stale = ~self.filled | (self.seed != seeds) | (self.episode != episodes)
        if not bool(stale[rows].any()):
            return
        used = torch.nonzero(stale).squeeze(-1)
        drawn, limit = draw(self.fleet, Key(seeds[used].cpu(), env_ids[used].cpu(), episodes[used].cpu()))
        start(self.fleet, used, drawn, limit)
        self.limit[used], self.filled[used] = limit, True
        self.seed, self.episode = torch.where(stale, seeds, self.seed), torch.where(stale, episodes, self.episode)
