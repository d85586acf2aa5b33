"""Networks of constellations: actors asked for those who decide only, and critics that observe all satellites."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import torch
from torch import Tensor, nn
from torch.nn.functional import relu

from bsk_torch.rl.networks.attention import mean_where


class DecidingOnly(nn.Module):
    """A network evaluated for satellites that decide only.

    The others get zeros, and deviations of one where the network gives means and deviations.
    """

    def __init__(self, network: nn.Module) -> None:
        """``network`` gives [B, A], or two of them, for what is seen, [B, ...] each."""
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        """Outputs [..., S, A] for what satellites see, [..., S, ...] each, of which the last, ``decides`` [..., S], decide."""
        *parts, decides = inputs
        outputs = self.network(*(part[decides] for part in parts))
        if isinstance(outputs, tuple):
            loc, scale = outputs
            shape = *decides.shape, loc.shape[-1]
            return loc.new_zeros(shape).index_put((decides,), loc), loc.new_ones(shape).index_put((decides,), scale)
        return outputs.new_zeros(*decides.shape, outputs.shape[-1]).index_put((decides,), outputs)


class Gist(nn.Module):
    """Observation of a satellite as one vector: its features, and the mean over its targets if it observes a set."""

    def __init__(self, n_own: int, n_features: int, width: int) -> None:
        """Expect ``n_own`` numbers of a satellite and ``n_features`` of each of its targets; 0 for none."""
        super().__init__()
        self.own = nn.Linear(n_own, width)
        if n_features:
            self.context, self.row = nn.Linear(n_own, width), nn.Linear(n_features, width)
        self.gist = nn.Linear(2 * width if n_features else width, width)
        self.n_inputs = 3 if n_features else 1

    def embed(self, satellite: Tensor, *targets: Tensor) -> Tensor:
        """Vectors [..., S, W] by ``satellite`` [..., S, D] and, of a set, rows [..., S, K, F] and their mask [..., S, K]."""
        parts = [relu(self.own(satellite))]
        if targets:
            rows, mask = targets
            parts.append(mean_where(relu(self.row(rows) + self.context(satellite).unsqueeze(-2)), mask))
        return relu(self.gist(torch.cat(parts, -1)))


class ConstellationCritic(Gist):
    """Value of the state of each satellite of a group, from its own observation and, in MAPPO, the mean over all alive."""

    def __init__(
        self, n_own: int, n_features: int, width: int, sees_all: bool, other_sizes: Sequence[tuple[int, int]] = ()
    ) -> None:
        """Expect what :class:`Gist` does; ``other_sizes`` are the same two numbers of each other observed group."""
        super().__init__(n_own, n_features, width)
        self.sees_all = sees_all
        self.value = nn.Sequential(nn.Linear((1 + sees_all) * width, width), nn.ReLU(), nn.Linear(width, 1))
        self.others = nn.ModuleList(Gist(*sizes, width) for sizes in other_sizes)

    def forward(self, *inputs: Tensor) -> Tensor:
        """Values [..., S, 1] by what each group sees, its own first: the arguments of :meth:`embed`, then who is alive."""
        parts = iter(inputs)
        gists, alive = [], []
        for group in (self, *self.others):
            gists.append(group.embed(*islice(parts, group.n_inputs)))
            alive.append(next(parts))
        each = gists[0]
        if not self.sees_all:
            return self.value(each)
        team = mean_where(torch.cat(gists, -2), torch.cat(alive, -1)).unsqueeze(-2)
        return self.value(torch.cat([each, team.expand_as(each)], -1))
