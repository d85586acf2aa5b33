"""Normalization of observations to zero mean and unit standard deviation, with bounded outliers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from typing_extensions import override

OWN, ROWS, MASK = ("seen", "own"), ("seen", "rows"), ("seen", "mask")
"""Keys of normalized observations: the satellite [..., D], rows of targets [..., K, F], and a mask of rows [..., K]."""

CLOCK = ("seen", "clock")
"""Key of the remaining time, [..., 2], observed only by critics; see :class:`~bsk_torch.rl.training.collect.Clock`."""

FLOOR = 1e-4
"""Minimum standard deviation used as a divisor."""

LARGEST = 10.0
"""Bound of normalized observations, in standard deviations."""


def symlog(x: Tensor) -> Tensor:
    """Return sign(x) log(1 + abs(x)), which compresses large numbers (Hafner et al. 2023, arXiv:2301.04104)."""
    return torch.sign(x) * torch.log1p(x.abs())


class FeatureNormaliser(nn.Module):
    """Standardizes features, after :func:`symlog`, with running mean and variance."""

    def __init__(self, width: int) -> None:
        """Start without samples of ``width`` features; before the first update, features are only compressed."""
        super().__init__()
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(width, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(width, dtype=torch.float64))

    count: Tensor
    mean: Tensor
    variance: Tensor

    @torch.no_grad()
    def update(self, x: Tensor, mask: Tensor | None = None) -> None:
        """Include the samples x [..., F] in mean and variance, or only those in ``mask`` [...].

        Moments of two parts are merged as in Chan, Golub and LeVeque, "Algorithms for computing the sample variance" (1983).
        """
        samples = symlog(x.reshape(-1, x.shape[-1]) if mask is None else x[mask.bool()]).double()
        if not len(samples):
            return
        variance, mean = torch.var_mean(samples, 0, correction=0)
        share = len(samples) / (self.count + len(samples))
        shift = mean - self.mean
        self.mean += share * shift
        self.variance.copy_(torch.lerp(self.variance, variance, share) + share * (1.0 - share) * shift**2)
        self.count += len(samples)

    def forward(self, x: Tensor) -> Tensor:
        """Return the standardized features, [..., F]."""
        deviation = self.variance.sqrt().clamp(min=FLOOR)
        z = (symlog(x) - self.mean.to(x.dtype)) / deviation.to(x.dtype)
        return z.clamp(-LARGEST, LARGEST)


class ObservationNormaliser(TensorDictModuleBase, ABC):
    """Writes normalized observations into tensordicts."""

    @abstractmethod
    def update(self, tensordict: TensorDictBase) -> None:
        """Include the observations of a batch in mean and variance."""


class VectorNormaliser(ObservationNormaliser):
    """Normalizer of an observation vector."""

    def __init__(self, n_observed: int) -> None:
        """Expect vectors of width ``n_observed``."""
        super().__init__()
        self.in_keys, self.out_keys = ["observation"], [OWN]
        self.own = FeatureNormaliser(n_observed)

    @override
    def update(self, tensordict: TensorDictBase) -> None:
        self.own.update(tensordict["observation"])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write :data:`OWN`."""
        return tensordict.set(OWN, self.own(tensordict["observation"]))


class SetNormaliser(ObservationNormaliser):
    """Normalizer of an observation with one set: its rows share mean and deviation, all other parts are concatenated."""

    def __init__(self, set_key: NestedKey, own_keys: Sequence[NestedKey], n_own: int, n_features: int) -> None:
        """Expect ``rows`` and ``mask`` under ``set_key``, with ``n_features`` columns, and ``n_own`` other numbers."""
        super().__init__()
        self.rows_key, self.mask_key = (*set_key, "rows"), (*set_key, "mask")
        self.own_keys = own_keys
        self.in_keys, self.out_keys = [*own_keys, self.rows_key, self.mask_key], [OWN, ROWS, MASK]
        self.own, self.rows = FeatureNormaliser(n_own), FeatureNormaliser(n_features)

    def _join(self, tensordict: TensorDictBase) -> Tensor:
        """Return the observations other than the set, [..., D]."""
        batch = tensordict.batch_size
        return torch.cat([tensordict[key].reshape(*batch, -1) for key in self.own_keys], -1)

    @override
    def update(self, tensordict: TensorDictBase) -> None:
        self.own.update(self._join(tensordict))
        self.rows.update(tensordict[self.rows_key], tensordict[self.mask_key])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write :data:`OWN`, :data:`ROWS` and :data:`MASK`."""
        tensordict.set(OWN, self.own(self._join(tensordict)))
        tensordict.set(ROWS, self.rows(tensordict[self.rows_key]))
        return tensordict.set(MASK, tensordict[self.mask_key].bool())
