"""Screened sampling: probabilities of rare events, from the few of very many episodes that are most likely to have the event.

What is drawn at reset follows from the seed of an episode, without a simulation. A surrogate
(:mod:`bsk_torch.lab.risk.surrogate`) predicts from it the probability q of the event, and is then fixed. Each repetition takes
M new seeds, and flies seed i with a probability of inclusion ``pi_i`` that is known before the flight. The estimate of Horvitz
and Thompson,

    p = (1 / M) sum of 1 / pi_i over the flown episodes with the event,

has no bias, whatever the surrogate predicts. A poor surrogate costs variance only. About n seeds are flown: a tenth of them
independently of the surrogate, the others by systematic sampling along the predicted level with probabilities proportional to
``sqrt(q (1 - q))``, the best ones for flights of equal cost, where q is bounded away from 1.

Sources: D. G. Horvitz and D. J. Thompson, "A generalization of sampling without replacement from a finite universe", J. Am. Stat.
Assoc. 47 (1952); C.-E. Sarndal, B. Swensson and J. Wretman, "Model assisted survey sampling", Springer 1992 (chapters 3 and 12).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from bsk_torch.lab.risk.subset import SEEDS, Fly, Sample, Tally
from bsk_torch.lab.risk.surrogate import Chance, Surrogate, chance, fitted, largest_finite
from bsk_torch.rand import Key

BLIND = 0.1
"""Share of the flights that are chosen independently of the surrogate."""

FIRST_SHARE, ROUNDS = 0.25, 6
"""Share of independent episodes among those learned from, and the number of rounds of the others."""

DARING = 0.5
"""Random errors of the predictions by which learned episodes are chosen, in standard deviations of the surrogate's."""

CERTAIN = 1.05
"""``q`` counts as ``q (CERTAIN - q)``, so that episodes with a certain event are flown too."""

AT_ONCE = 1 << 15
"""Number of seeds whose draws are held at once."""

Draws = Callable[[Tensor], Tensor]
"""Returns what is drawn at reset for seeds [m], without a simulation, [m, D]."""


@dataclass(frozen=True)
class Screen:
    """What was learned.

    Attributes:
        surrogate: Predicts levels.
        chance: Probability of the event, given a predicted level.
        first: The independent episodes among those learned from.
        explained: Share of the variance of their levels that the surrogate explains, predicting each from others.
        events: Number of learned episodes with the event.
        highest: Largest finite level.
    """

    surrogate: Surrogate
    chance: Chance
    first: Sample
    explained: float
    events: int
    highest: float


@dataclass(frozen=True)
class Screened:
    """R independent estimates.

    Attributes:
        estimates: Estimates of the probability, [R].
        sample: Flown episodes with the event, [n].
        weight: What each of them adds to the mean of the estimates, [n].
        blind: Number of flights that were chosen independently of the surrogate, on average.
    """

    estimates: Tensor
    sample: Sample
    weight: Tensor
    blind: float


@dataclass
class ScreenedSampling:
    """Estimates from the episodes that ``fly`` plays.

    Attributes:
        fly: Plays episodes.
        draws: What is drawn at reset.
        size: Number of episodes n flown in a repetition.
        pool: Number of seeds M of a repetition.
        learned: Number of episodes from which the surrogate learns.
        threshold: Level from which on the event happens; None if unknown, for about the largest level without it.
        seed: Seed of the choices.
        tally: Cost so far.
        tell: Called with a description of each stage.
    """

    fly: Fly
    draws: Draws
    size: int
    pool: int
    learned: int
    threshold: float | None = None
    seed: int = 0
    tally: Tally = field(default_factory=Tally)
    tell: Callable[[str], object] = lambda words: None

    def learn(self) -> Screen:
        """Fly independent episodes, then those that are predicted to come nearest to the event, and fit the surrogate."""
        size = max(2, round(FIRST_SHARE * self.learned))
        sample = first = self._play(self._seeds("first", 0, size))
        for k in range(ROUNDS):
            count = (self.learned - size) * (k + 1) // ROUNDS - (self.learned - size) * k // ROUNDS
            if not count:
                continue
            self.tell(f"learning, round {k + 1} of {ROUNDS}: highest level {float(sample.level.max()):.4g}")
            surrogate, level = self._fitted(sample, k)
            seeds = self._seeds("round", k, max(count, self.pool >> (ROUNDS - 1 - k)))
            predicted = self._predicted(surrogate, seeds)
            errors = surrogate.spread * self._key("round, errors", k).normal(len(seeds)).squeeze(0)
            index = (predicted + DARING * errors).topk(count).indices
            sample = Sample.joined(sample, self._play(seeds[index]))
        surrogate, level = self._fitted(sample, ROUNDS)
        threshold = float(level.max()) if self.threshold is None else self.threshold
        n = len(first.seeds)
        errors = surrogate.left_out[:n] - level[:n]
        variance = float(level[:n].var())
        return Screen(
            surrogate=surrogate,
            chance=chance(surrogate, sample.level, threshold),
            first=first,
            explained=max(0.0, 1.0 - float(errors.square().mean()) / variance) if variance > 0.0 else 0.0,
            events=int((sample.level == torch.inf).sum()),
            highest=float(level.max()),
        )

    def repeat(self, screen: Screen, count: int) -> Screened:
        """Return ``count`` independent estimates."""
        estimates, parts, weights = [], [], []
        for k in range(count):
            self.tell(f"repetition {k + 1} of {count}: screening {self.pool:,} seeds")
            seeds = self._seeds("repetition", k, self.pool)
            predicted = self._predicted(screen.surrogate, seeds)
            lots = self._lots("repetition, choice", k, self.size)
            index, inclusion = _choose(predicted, screen.chance(predicted), self.size, lots)
            sample = self._play(seeds[index])
            rows = torch.nonzero(sample.level == torch.inf).squeeze(1)
            weights.append(1.0 / (self.pool * inclusion[rows]))
            parts.append(sample.take(rows))
            estimates.append(weights[-1].sum())
        return Screened(torch.stack(estimates), Sample.joined(*parts), torch.cat(weights) / count, BLIND * self.size * count)

    def _fitted(self, sample: Sample, k: int) -> tuple[Surrogate, Tensor]:
        """Return the surrogate of the episodes, and their levels [n], the largest finite one for those with the event."""
        level = sample.level.clamp(max=largest_finite(sample.level))
        values = self.draws(sample.seeds)
        return fitted(values, level, self._lots("fit", k, len(level))[: len(level)]), level

    def _predicted(self, surrogate: Surrogate, seeds: Tensor) -> Tensor:
        return torch.cat([surrogate(self.draws(some)) for some in seeds.split(AT_ONCE)])

    def _play(self, seeds: Tensor) -> Sample:
        flown = self.fly(seeds)
        self.tally.add(flown)
        return Sample.independent(seeds, flown)

    def _key(self, run: str, k: int) -> Key:
        return Key(torch.tensor([self.seed]), torch.tensor([0]), torch.tensor([k]), f"screened sampling, {run}")

    def _lots(self, run: str, k: int, count: int) -> Tensor:
        """Return uniform numbers of round or repetition k, more than the choice of about ``count`` seeds needs."""
        return self._key(run, k).uniform(count + int(10.0 * count**0.5) + 20).squeeze(0)

    def _seeds(self, run: str, k: int, count: int) -> Tensor:
        """Return consecutive seeds of round or repetition k, [count], from a random one."""
        first = int(float(self._lots(f"{run}, seeds", k, 1)[0]) * (SEEDS - count))
        return first + torch.arange(count)


def _choose(level: Tensor, chances: Tensor, count: int, lots: Tensor) -> tuple[Tensor, Tensor]:
    """Return about ``count`` of M seeds, [n], and their probabilities of inclusion, [n].

    The sampling is systematic along the predicted ``level`` [M]; ``chances`` [M] are the probabilities of the event. Some seeds
    may be chosen in both ways.
    """
    blind = min(1.0, BLIND * count / len(level))
    even = _bernoulli(blind, len(level), lots[1:])
    size = (chances * (CERTAIN - chances)).sqrt().clamp(min=torch.finfo(torch.float64).tiny)
    share = _proportional(size, (1.0 - BLIND) * count)
    order = level.argsort(stable=True)
    cumulative = share[order].cumsum(0)
    marks = lots[0] + torch.arange(int(float(cumulative[-1])) + 1)
    marks = marks[marks < cumulative[-1]]
    index = torch.cat([even, order[torch.searchsorted(cumulative, marks, right=True)]]).unique()
    return index, 1.0 - (1.0 - blind) * (1.0 - share[index])


def _bernoulli(probability: float, count: int, lots: Tensor) -> Tensor:
    """Return which of ``count`` trials succeed, by the distances between successes, from enough uniform numbers ``lots``."""
    if probability == 1.0:
        return torch.arange(count)
    gaps = torch.log1p(-lots) / torch.log1p(-torch.tensor(probability, dtype=torch.float64))
    places = (gaps.floor().clamp(max=count).long() + 1).cumsum(0) - 1
    return places[places < count]


def _proportional(size: Tensor, count: float) -> Tensor:
    """Return probabilities of inclusion in (0, 1], [M], proportional to ``size`` where below 1, with the sum ``count``."""
    share = torch.zeros_like(size)
    while True:
        sure = share >= 1.0
        remaining = size[~sure]
        if not len(remaining) or count <= float(sure.sum()):
            return sure.double().clamp(min=torch.finfo(torch.float64).tiny)
        share = torch.where(sure, 1.0, size * ((count - float(sure.sum())) / float(remaining.sum())))
        if not bool((share[~sure] > 1.0).any()):
            return share
        share = share.clamp(max=1.0)
