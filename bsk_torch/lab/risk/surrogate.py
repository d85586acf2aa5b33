"""A surrogate: predicts the level of an episode from what is drawn at reset, and the probability of an event.

It is a Gaussian process with a linear trend and a length for each feature, so that features that do not matter get long lengths.
Predictions are those of a regression on the kernels of a few centers, which costs microseconds for an episode.

Sources: C. E. Rasmussen and C. K. I. Williams, "Gaussian processes for machine learning", MIT Press 2006 (chapters 5 and 8);
J. Platt, "Probabilistic outputs for support vector machines", Advances in large margin classifiers, 1999.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

CENTERS = 300
"""Number of centers: episodes with the largest levels, and as many others."""

TUNED, STEPS, RATE = 500, 150, 0.1
"""Number of episodes from which lengths are learned, of Adam's steps, and their size."""

UPPER = (0.75, 0.9, 0.95, 0.98)
"""Quantiles of learned levels from which the probability of larger ones is learned."""

TAIL = 0.05
"""Share of the errors that are the tail."""

FIRST_LENGTH, FIRST_NOISE = 4.5, 0.2
"""First lengths, in standard deviations of features, and the first share of noise in the variance."""

RIDGE = 1e-3
"""Penalty of the trend, and of the kernels for a stable solution."""

AT_ONCE = 8192
"""Number of episodes predicted at once."""


@dataclass(frozen=True)
class Scaling:
    """Scaling of features, with the distance from the median as a second feature, since wheels may turn either way.

    Attributes:
        used: Columns that vary, [F].
        low: Replacement of minus infinity, [F].
        high: That of infinity, such as the time of a fault that never begins, [F].
        median: Medians, [F].
        spread: Standard deviations, [F].
    """

    used: Tensor
    low: Tensor
    high: Tensor
    median: Tensor
    spread: Tensor

    @staticmethod
    def of(values: Tensor) -> Scaling:
        """Return the scaling for values [n, D]."""
        finite = torch.where(values.isfinite(), values, torch.nan)
        low, high = (f(finite.nan_to_num(nan=end), 0).values for f, end in ((torch.min, torch.inf), (torch.max, -torch.inf)))
        width = (high - low).clamp(min=0.0).nan_to_num(posinf=0.0)
        low, high = (low - width).nan_to_num(posinf=-1.0), (high + width).nan_to_num(neginf=1.0)
        clear = torch.minimum(torch.maximum(values, low), high)
        spread = (clear - clear.mean(0)).square().mean(0).sqrt()
        used = torch.nonzero(spread > 1e-12 * clear.abs().amax(0)).squeeze(1)
        return Scaling(used, low[used], high[used], clear[:, used].median(0).values, spread[used])

    def __call__(self, values: Tensor) -> Tensor:
        """Return the features [n, 2 F] of values [n, D]."""
        scaled = (torch.minimum(torch.maximum(values[:, self.used], self.low), self.high) - self.median) / self.spread
        return torch.cat([scaled, scaled.abs()], 1)


@dataclass(frozen=True)
class Surrogate:
    """A fitted regression.

    Attributes:
        scaling: Scaling of the values.
        lengths: Length of each feature, [2 F].
        centers: Features of the centers over the lengths, [C, 2 F].
        weights: Weights of the kernels, of the features, and the constant, [C + 2 F + 1].
        left_out: Prediction of the level of each learned episode from all others, [n].
        spread: Standard deviation of their errors.
    """

    scaling: Scaling
    lengths: Tensor
    centers: Tensor
    weights: Tensor
    left_out: Tensor
    spread: float

    def __call__(self, values: Tensor) -> Tensor:
        """Return the predicted levels [m] of values [m, D]."""
        parts = []
        for some in values.split(AT_ONCE):
            features = self.scaling(some).float()
            parts.append((_terms(features, self.lengths.float(), self.centers.float()) @ self.weights.float()).double())
        return torch.cat(parts)


@dataclass(frozen=True)
class Chance:
    """Probability of an event, given a predicted level.

    It is ``1 / (1 + exp(-(slope z + offset)))`` with ``z = (predicted level - threshold) / spread``, but no less than the tail of
    the errors, ``TAIL exp(-(threshold - predicted level - begin) / scale)``, where the prediction is more than ``begin`` below
    the threshold.
    """

    threshold: float
    spread: float
    slope: float
    offset: float
    begin: float
    scale: float

    def __call__(self, level: Tensor) -> Tensor:
        """Return the probabilities [m] for predicted levels [m]."""
        near = torch.sigmoid(self.slope * (level - self.threshold) / self.spread + self.offset)
        beyond = self.threshold - level - self.begin
        return torch.maximum(near, torch.where(beyond >= 0.0, TAIL * torch.exp(-beyond / self.scale), 0.0))


def fitted(values: Tensor, level: Tensor, lots: Tensor) -> Surrogate:
    """Return the surrogate of n episodes.

    Args:
        values: What was drawn, [n, D].
        level: Finite levels, [n].
        lots: Uniform numbers by which episodes are chosen, [n].
    """
    scaling = Scaling.of(values)
    features, mean = scaling(values), float(level.mean())
    size = max(float(level.std()), 1e-12)
    target = (level - mean) / size
    plain = torch.cat([features, torch.ones_like(features[:, :1])], 1)
    trend = torch.linalg.solve(plain.mT @ plain + torch.eye(plain.shape[1], dtype=plain.dtype), plain.mT @ target)
    order = _ordered(level, lots)
    lengths, amplitude, noise = _tuned(features[order[:TUNED]], (target - plain @ trend)[order[:TUNED]])
    centers = features[order[:CENTERS]] / lengths
    terms = _terms(features, lengths, centers)
    penalty = RIDGE * torch.eye(terms.shape[1], dtype=terms.dtype)
    c = len(centers)
    penalty[:c, :c] += noise / amplitude * _kernel(centers, centers)
    factor = torch.linalg.cholesky(terms.mT @ terms + penalty)
    weights = torch.cholesky_solve((terms.mT @ target).unsqueeze(1), factor).squeeze(1)
    own = torch.linalg.solve_triangular(factor, terms.mT, upper=False).square().sum(0).clamp(max=1.0 - 1e-6)
    left_out = (target - (target - terms @ weights) / (1.0 - own)) * size + mean
    weights = weights * size
    weights[-1] += mean
    return Surrogate(scaling, lengths, centers, weights, left_out, max(float((left_out - level).std()), 1e-12))


def largest_finite(level: Tensor) -> float:
    """Return the largest finite level, 0 if there is none: that of episodes with the event, for the surrogate."""
    finite = level[level < torch.inf]
    return float(finite.max()) if len(finite) else 0.0


def chance(surrogate: Surrogate, level: Tensor, threshold: float) -> Chance:
    """Return the probability of a level from ``threshold`` on, learned from the levels [n] of the surrogate's episodes.

    The fit maximizes the likelihood of whether levels reach the threshold and, since few may do so, several of their quantiles,
    given the prediction of each episode from all others. A normal prior on slope and offset has the mean of logistic errors.

    Args:
        surrogate: The surrogate.
        level: Levels, infinite with the event.
        threshold: The threshold.
    """
    spread = surrogate.spread * 3.0**0.5 / torch.pi
    thresholds = torch.tensor([*level.quantile(torch.tensor(UPPER, dtype=level.dtype)).tolist(), threshold], dtype=level.dtype)
    thresholds = thresholds[thresholds < torch.inf]
    happened = level.unsqueeze(1) >= thresholds
    z, prior = (surrogate.left_out.unsqueeze(1) - thresholds) / spread, torch.tensor([1.0, 0.0], dtype=torch.float64)
    line = prior.clone().requires_grad_()
    search = torch.optim.LBFGS([line], max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        search.zero_grad()
        value = binary_cross_entropy_with_logits(line[0] * z + line[1], happened.double(), reduction="sum")
        value = value + (line - prior).square().sum()
        value.backward()
        return value

    with torch.enable_grad():
        search.step(loss)
    slope, offset = line.detach().tolist()
    return Chance(threshold, spread, max(slope, 0.0), offset, *_tail(surrogate, level))


def _tail(surrogate: Surrogate, level: Tensor) -> tuple[float, float]:
    """Return begin and scale of the tail of the errors: exponential, by maximum likelihood.

    The surrogate learned the largest finite level from episodes with the event, whose errors may be larger.
    """
    known = level < torch.inf
    errors = level.clamp(max=largest_finite(level)) - surrogate.left_out
    begin = float(errors.quantile(1.0 - TAIL))
    beyond = errors > begin
    excess = float((errors[beyond] - begin).sum())
    return begin, max(excess / max(int((beyond & known).sum()), 1), 1e-12)


def _ordered(level: Tensor, lots: Tensor) -> Tensor:
    """Return the episodes in an order that alternates between those of the largest levels, and others in random order."""
    rank = level.argsort(descending=True).argsort()
    return torch.minimum(2 * rank, 2 * lots.argsort().argsort() + 1).argsort(stable=True)


def _kernel(a: Tensor, b: Tensor) -> Tensor:
    """Return Matern's kernel of order 3/2, [n, m], of features over lengths."""
    square = a.square().sum(1, keepdim=True) + b.square().sum(1) - 2.0 * a @ b.mT
    distance = (3.0 * square.clamp(min=1e-12)).sqrt()
    return (1.0 + distance) * torch.exp(-distance)


def _terms(features: Tensor, lengths: Tensor, centers: Tensor) -> Tensor:
    """Return the terms of the regression, [n, C + 2 F + 1]."""
    return torch.cat([_kernel(features / lengths, centers), features, torch.ones_like(features[:, :1])], 1)


@torch.enable_grad()
def _tuned(features: Tensor, target: Tensor) -> tuple[Tensor, float, float]:
    """Return lengths, amplitude and variance of noise with the largest likelihood that a few steps find."""
    first = ([FIRST_LENGTH] * features.shape[1], 1.0, FIRST_NOISE)
    found = [torch.tensor(value, dtype=torch.float64).log().requires_grad_() for value in first]
    search, one = torch.optim.Adam(found, RATE), torch.eye(len(target), dtype=torch.float64)
    for _ in range(STEPS):
        length, amplitude, noise = (value.exp() for value in found)
        scaled = features / length
        factor = torch.linalg.cholesky(amplitude * _kernel(scaled, scaled) + (noise + 1e-6) * one)
        white = torch.linalg.solve_triangular(factor, target.unsqueeze(1), upper=False)
        loss = 0.5 * white.square().sum() + factor.diagonal().log().sum()
        search.zero_grad()
        loss.backward()
        search.step()
    length, amplitude, noise = (value.detach().exp() for value in found)
    return length, float(amplitude), float(noise)
