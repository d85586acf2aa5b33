"""Random catalogs of objects in low, medium and geosynchronous orbits, in given shares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch._checks import number, switch
from bsk_torch.rand import Key
from bsk_torch.sim.names import one_of

BODY = 6371e3
"""Radius from which altitudes count, m."""

LOWEST_PERIGEE = 6771e3
"""Smallest distance from the Earth's center, m."""


class Regime(NamedTuple):
    """Bounds of uniform elements: altitude of the semi-major axis, m; eccentricity, and inclination, degrees, both from 0 on."""

    altitude: tuple[float, float]
    e: float
    i: float


REGIMES = {
    "LEO": Regime((400e3, 2000e3), 0.02, 180.0),
    "MEO": Regime((2000e3, 35000e3), 0.10, 120.0),
    "GEO": Regime((35486e3, 36086e3), 0.0015, 15.0),
}
"""Kinds of orbits by name, in the order of shares."""

SHARES = ("LEO", "random")
"""Shares by name."""


@dataclass(frozen=True)
class RSOMixture:
    """Orbits of which some are low, some medium and some geosynchronous, as in a branch of BSK-RL's authors.

    All orbital elements are uniform in the ranges of :data:`REGIMES`, and the angles of the node, of perigee and of the object in
    [0, 360) degrees. Eccentricities are such that no perigee lies below 6,771 km: those of a given semi-major axis are uniform up
    to the smaller of the two bounds.

    Args:
        shares: Shares of low, medium and geosynchronous orbits, which sum up to 1; ``"LEO"`` for low ones only; or ``"random"``,
            which draws a share x of low orbits from [0, 1) and one of medium orbits from [0, 1 - x) in every episode.
        exact: Whether exactly these shares of the catalog, rounded to whole numbers by largest remainders, are of each kind,
            in random order; otherwise each object draws its kind independently.
    """

    shares: tuple[float, float, float] | str = (0.5, 0.3, 0.2)
    exact: bool = False

    def __post_init__(self) -> None:
        switch("exact", self.exact)
        if isinstance(self.shares, str):
            if one_of("shares", self.shares, SHARES) == "LEO":
                object.__setattr__(self, "shares", (1.0, 0.0, 0.0))
            return
        entries = tuple(self.shares) if isinstance(self.shares, Sequence) else ()
        if len(entries) != len(REGIMES):
            raise ValueError(f"shares={self.shares!r} must be three numbers, those of {list(REGIMES)}, or one of {list(SHARES)}")
        object.__setattr__(self, "shares", tuple(number("shares", share, 0.0, 1.0) for share in entries))
        if abs(sum(self.shares) - 1.0) > 1e-9:
            raise ValueError(f"shares={self.shares!r} sum up to {sum(self.shares):g}; they must sum up to 1")

    def draw(self, key: Key, count: int) -> Tensor:
        """Return the elements a (m), e, i, Omega, omega, f (rad) of ``count`` objects in the episodes of a key, [n, count, 6]."""
        u = key.of_satellites(torch.arange(count)).uniform(7).view(len(key), count, 7)
        kind = self._kinds(key, u[..., 6])
        table = torch.tensor([[*regime.altitude, regime.e, math.radians(regime.i)] for regime in REGIMES.values()]).double()
        low, high, most_e, most_i = table.to(kind.device)[kind].unbind(-1)
        a = BODY + low + (high - low) * u[..., 0]
        e = torch.minimum(most_e, 1.0 - LOWEST_PERIGEE / a).clamp(min=0.0) * u[..., 1]
        angles = 2.0 * math.pi * u[..., 3:6]
        return torch.cat([torch.stack([a, e, most_i * u[..., 2]], -1), angles], -1)

    def shares_of(self, key: Key) -> Tensor:
        """Return the shares of the kinds of orbits in the episodes of a key, [n, 3]."""
        if isinstance(self.shares, tuple):
            return torch.tensor(self.shares, dtype=torch.float64, device=key.env_id.device).expand(len(key), -1)
        low, rest = key.named(f"{key.name} shares").uniform(2).unbind(1)
        medium = (1.0 - low) * rest
        return torch.stack([low, medium, 1.0 - low - medium], 1)

    def _kinds(self, key: Key, u: Tensor) -> Tensor:
        """Return the number of the regime of each object, [n, G], for independent uniform numbers ``u`` [n, G]."""
        shares, count = self.shares_of(key), u.shape[1]
        if self.exact:
            rank = u.argsort(dim=1, stable=True).argsort(dim=1, stable=True)
            ends = largest_remainders(shares, count).cumsum(1)[:, :-1]
            return (rank.unsqueeze(-1) >= ends.unsqueeze(1)).sum(-1)
        return (u.unsqueeze(-1) >= shares.cumsum(1)[:, None, :-1]).sum(-1)


def largest_remainders(shares: Tensor, count: int) -> Tensor:
    """Return whole numbers [n, k] in the proportions of ``shares`` [n, k] that sum up to ``count``.

    Every share gets the whole part of its number; the rest goes to the largest remainders, the first of equal ones.
    """
    quota = shares * count
    number = torch.floor(quota + 1e-9).long()
    order = (quota - number).argsort(dim=1, descending=True, stable=True).argsort(dim=1, stable=True)
    return number + (order < (count - number.sum(1, keepdim=True)))
