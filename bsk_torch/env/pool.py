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
from bsk_torch.sim.fleet import Fleet

SMALLEST = 32
"""Number of satellites in a batch from which a pool pays."""


class EpisodePool:
    """The next episode of every environment, in ``fleet``."""

    def __init__(self, fleet: Fleet, start: Callable[[Fleet, Tensor, Key], None]) -> None:
        """Keep episodes in ``fleet``, which nothing else uses; ``start(fleet, envs, key)`` begins those of a key in it."""
        self.fleet, self.start = fleet, start
        unset = torch.full_like(fleet.ticks, -1)
        self.seed, self.episode, self.filled = unset, unset.clone(), torch.zeros_like(unset, dtype=torch.bool)

    def forget(self, envs: Tensor | None) -> None:
        """Drop the episodes prepared for ``envs`` [n], or all of them: their arguments have changed."""
        self.filled[slice(None) if envs is None else envs.to(self.filled.device)] = False

    def fill(self, envs: Tensor, seeds: Tensor, env_ids: Tensor, episodes: Tensor) -> None:
        """Let ``envs`` [n] hold their ``episodes`` [N] of ``seeds`` [N]; if any lacks it, all stale rows are refilled."""
        stale = ~self.filled | (self.seed != seeds) | (self.episode != episodes)
        if not bool(stale[envs].any()):
            return
        used = torch.nonzero(stale).squeeze(-1)
        self.filled[used] = False  # until all is done
        self.start(self.fleet, used, Key(seeds[used].cpu(), env_ids[used].cpu(), episodes[used].cpu()))
        self.filled[used] = True
        self.seed, self.episode = torch.where(stale, seeds, self.seed), torch.where(stale, episodes, self.episode)
