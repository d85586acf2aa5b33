"""Subset simulation: probabilities of rare events, from random walks among the random numbers of episodes.

Let the *level* of an episode grow toward the event, and be infinite where it happens. The probability is the product of those of
reaching one threshold after the other, each about a tenth. Episodes above a threshold are the starts of Markov chains whose
states stay above it: a proposal blends some of the random numbers of an episode with new ones (:class:`bsk_torch.rand.Blend`),
which leaves their distribution unchanged, and is taken if its level is not below the threshold.

A first run chooses thresholds and the sizes of steps. In the repetitions these are fixed, the starts are drawn from the episodes
above the threshold, and all chains have the same length. Then every estimate is unbiased, and the repetitions are independent.

Sources: S.-K. Au and J. L. Beck, "Estimation of small failure probabilities in high dimensions by subset simulation",
Probabilistic Engineering Mechanics 16 (2001); I. Papaioannou et al., "MCMC algorithms for subset simulation", ibid. 41 (2015).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from tensordict import TensorDict
from torch import Tensor

from bsk_torch.rand import Blend, Key, blended

CHAIN = 10
"""Number of states of a chain; a tenth of the episodes are above the next threshold in the first run."""

SEEDS = 2**53
"""Exclusive upper limit of the seeds of independent episodes."""

FIRST_BLENDED = 2**61
"""Smallest seed of blended episodes, which no independent one has."""

ACCEPTED = 0.44
"""Share of accepted proposals toward which the first run changes the size of the steps; see Papaioannou et al."""

LEAST_SHARE = 0.05
"""Smallest share of the quantities that a proposal changes; its logarithm is uniform."""

SMALLEST_STEP, FIRST_STEP = 0.01, 0.7
"""Smallest size of steps, and that of the first ones; at 1, episodes are drawn independently."""


Fly = Callable[[Tensor], TensorDict]
"""Plays the episodes of seeds [m]; all random numbers are drawn from keys of these seeds (:class:`bsk_torch.rand.Key`).

Results are the largest ``level`` [m], infinite where the event has happened, the simulated time ``seconds`` [m] s, and whatever
else is to be kept of each episode."""


@dataclass(frozen=True)
class Sample:
    """n played episodes.

    Attributes:
        seeds: Their seeds, [n].
        parts: Seeds whose random numbers they blend, with ``steps`` and ``shares``, [n, J]; see :class:`bsk_torch.rand.Blend`.
        flown: Their results, [n]; see :data:`Fly`.
    """

    seeds: Tensor
    parts: Tensor
    steps: Tensor
    shares: Tensor
    flown: TensorDict

    @property
    def level(self) -> Tensor:
        """Largest level of each episode, [n]."""
        return self.flown["level"]

    @staticmethod
    def independent(seeds: Tensor, flown: TensorDict) -> Sample:
        """Return the episodes of seeds [n] that blend no others."""
        blank = torch.ones(len(seeds), 1, dtype=torch.float64)
        return Sample(seeds, seeds.unsqueeze(1), blank, blank, flown)

    def blend(self) -> Blend:
        """Return the blend that gives the seeds their random numbers."""
        return Blend(self.seeds, self.parts, self.steps, self.shares)

    def take(self, rows: Tensor) -> Sample:
        """Return the episodes ``rows`` [m], without parts that none of them has."""
        tables = _packed(self.parts[rows], self.steps[rows], self.shares[rows])
        return Sample(self.seeds[rows], *tables, self.flown[rows])

    def where(self, better: Tensor, other: Sample) -> Sample:
        """Return the episodes of ``other`` where ``better`` [n], and these elsewhere."""
        return self.joined(self, other).take(torch.arange(len(better)) + len(better) * better.long())

    @staticmethod
    def joined(*samples: Sample) -> Sample:
        """Return the episodes of all samples, in order."""
        width = max(sample.parts.shape[1] for sample in samples)
        parts, steps, shares = (
            torch.cat([torch.nn.functional.pad(getattr(sample, name), (0, width - sample.parts.shape[1])) for sample in samples])
            for name in ("parts", "steps", "shares")
        )
        seeds, flown = (torch.cat([getattr(sample, name) for sample in samples]) for name in ("seeds", "flown"))
        return Sample(seeds, parts, steps, shares, flown)


def _packed(parts: Tensor, steps: Tensor, shares: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the tables [n, J] with the used parts first, in their order, and as few columns as possible."""
    order = (steps == 0.0).byte().argsort(dim=1, stable=True)
    most = max(1, int((steps != 0.0).sum(1).max())) if len(steps) else 1
    return parts.gather(1, order)[:, :most], steps.gather(1, order)[:, :most], shares.gather(1, order)[:, :most]


@dataclass(frozen=True)
class Stage:
    """What the first run has chosen for a threshold.

    Attributes:
        threshold: Level that the states of the chains do not go below.
        step: Size of the steps of proposals, in (0, 1]; see :class:`bsk_torch.rand.Blend`.
    """

    threshold: float
    step: float


@dataclass
class Tally:
    """What flights have cost: number of episodes and simulated time (s), and the number of accepted and of all proposals."""

    episodes: int = 0
    seconds: float = 0.0
    accepted: int = 0
    proposed: int = 0

    def add(self, flown: TensorDict) -> None:
        """Add flights."""
        self.episodes += len(flown["seconds"])
        self.seconds += float(flown["seconds"].sum())


@dataclass(frozen=True)
class Climb:
    """Result of the first run.

    Attributes:
        stages: Thresholds and steps.
        last: The episodes above the last threshold, or all of them without one.
        why: Why no further threshold was added: :data:`HAPPENS`, :data:`STUCK` or :data:`RARER`.
    """

    stages: list[Stage]
    last: Sample
    why: str


HAPPENS, STUCK, RARER = "happens", "stuck", "rarer"
"""A tenth of the episodes has the event; the level stopped rising; the smallest probability of interest was reached."""


@dataclass(frozen=True)
class Repetitions:
    """R independent estimates.

    Attributes:
        shares: Share of the episodes that reach each threshold, and of those with the event, [R, K + 1]; 0 after a threshold
            that none reaches.
        first: The independent episodes of all repetitions, [R * n].
        last: The episodes above the last threshold, [r * n], of the r repetitions that have reached it.
        repetition: Numbers of their repetitions, [r * n].
    """

    shares: Tensor
    first: Sample
    last: Sample
    repetition: Tensor

    @property
    def estimates(self) -> Tensor:
        """Estimates of the probability of the event, [R]."""
        return self.shares.prod(1)

    @property
    def reached(self) -> Tensor:
        """Estimates of the probability of reaching the last threshold, [R]; 1 without thresholds."""
        return self.shares[:, :-1].prod(1)


@dataclass
class SubsetSimulation:
    """Runs on the episodes that ``fly`` plays.

    Attributes:
        fly: Plays episodes.
        size: Number of episodes n of a repetition, a multiple of :data:`CHAIN`.
        seed: Seed of the random walks.
        tally: Cost so far.
        tell: Called with a description of each stage.
    """

    fly: Fly
    size: int
    seed: int = 0
    tally: Tally = field(default_factory=Tally)
    tell: Callable[[str], object] = lambda words: None

    def climb(self, smallest: float) -> Climb:
        """Choose thresholds and steps in a first run, down to a probability of about ``smallest``.

        Ends with a threshold above which a tenth of the episodes has the event, or with the last one that could be reached.
        """
        sample, stages, share = self._independent(1, "first run"), list[Stage](), 1.0
        count = self.size // CHAIN
        while True:
            level = sample.level.sort(descending=True).values
            above = level[level > (stages[-1].threshold if stages else level[-1])]
            if not len(above):
                return Climb(stages, sample, HAPPENS if bool(level[-1] == torch.inf) else STUCK)
            threshold = float(torch.maximum(level[count - 1], above[-1]))
            if threshold == torch.inf:
                return Climb(stages, sample, HAPPENS)
            if share <= smallest:
                return Climb(stages, sample, RARER)
            rows = torch.nonzero(sample.level >= threshold).squeeze(1)
            share *= len(rows) / len(level)
            self.tell(f"first run: threshold {len(stages) + 1}, reached with a probability of {share:.0e}")
            starts = sample.take(_draw(rows, count, self._key("first run, starts", len(stages), 1)))
            first = Stage(threshold, stages[-1].step if stages else FIRST_STEP)
            sample, step = self._chains(starts, first, len(stages), None)
            stages.append(Stage(threshold, step))

    def repeat(self, stages: Sequence[Stage], count: int) -> Repetitions:
        """Return ``count`` independent estimates with the given thresholds and steps."""
        sample, repetition = self._independent(count, "repetition"), torch.arange(count)
        first, shares = sample, torch.zeros(count, len(stages) + 1, dtype=torch.float64)
        for k, stage in enumerate(stages):
            self.tell(f"{count} repetitions: threshold {k + 1} of {len(stages)}")
            above = (sample.level >= stage.threshold).view(-1, self.size)
            shares[repetition, k] = above.double().mean(1)
            going = torch.nonzero(above.any(1)).squeeze(1)
            repetition = repetition[going]
            if not len(going):
                return Repetitions(shares, first, sample.take(going), repetition)
            lots = self._key("repetition, starts", k, count).take(repetition.tolist())
            starts = [
                r * self.size + _draw(torch.nonzero(above[r]).squeeze(1), self.size // CHAIN, lots.take([j]))
                for j, r in enumerate(going.tolist())
            ]
            sample, _ = self._chains(sample.take(torch.cat(starts)), stage, k, repetition)
        shares[repetition, -1] = (sample.level == torch.inf).view(-1, self.size).double().mean(1)
        return Repetitions(shares, first, sample, repetition.repeat_interleave(self.size))

    def _key(self, run: str, stage: int, count: int) -> Key:
        numbers = torch.arange(count)
        return Key(torch.full_like(numbers, self.seed), numbers, torch.full_like(numbers, stage), f"subset simulation, {run}")

    def _independent(self, count: int, run: str) -> Sample:
        seeds = (self._key(run, 0, count).uniform(self.size).flatten() * SEEDS).long()
        return Sample.independent(seeds, self._fly(seeds))

    def _fly(self, seeds: Tensor) -> TensorDict:
        flown = self.fly(seeds)
        self.tally.add(flown)
        return flown

    def _chains(self, starts: Sample, stage: Stage, number: int, repetition: Tensor | None) -> tuple[Sample, float]:
        """Return the states of chains from ``starts``, those of a repetition one after the other, and the last size of a step.

        ``repetition`` [r] are the numbers of the repetitions, with equally many starts; None for the first run, in which the size
        of the steps changes.
        """
        if repetition is None:
            key = self._key("first run, steps", number, 1)
        else:
            key = self._key("repetition, steps", number, 1 + int(repetition.max())).take(repetition.tolist())
        states, now, step = [starts], starts, stage.step
        for turn in range(1, CHAIN):
            lots = key.named(f"{key.name} {turn}").uniform(3 * len(starts.seeds) // len(key)).reshape(-1, 3)
            proposal = self._proposed(now, lots, step)
            accepted = proposal.level >= stage.threshold
            now = now.where(accepted, proposal)
            states.append(now)
            self.tally.proposed += len(accepted)
            self.tally.accepted += int(accepted.sum())
            if repetition is None:
                factor = torch.exp((accepted.double().mean() - ACCEPTED) / turn**0.5)
                step = float((step * factor).clamp(SMALLEST_STEP, 1.0))
        rows = torch.arange(CHAIN * len(starts.seeds)).view(CHAIN, len(key), -1).transpose(0, 1).flatten()
        return Sample.joined(*states).take(rows), step

    def _proposed(self, now: Sample, lots: Tensor, step: float) -> Sample:
        """Play proposals for the next states of chains, by ``lots`` [n, 3] in [0, 1)."""
        new, number = (lots[:, :2] * SEEDS).long().unbind(1)
        share = LEAST_SHARE ** lots[:, 2:]
        parts = torch.cat([now.parts, new.unsqueeze(1)], 1)
        steps = torch.cat([now.steps, torch.full_like(share, step)], 1)
        seeds = FIRST_BLENDED + number
        blend = Blend(seeds, *_packed(parts, steps, torch.cat([now.shares, share], 1)))
        order = torch.searchsorted(blend.seeds, seeds)
        with blended(blend):
            flown = self._fly(seeds)
        return Sample(seeds, blend.parts[order], blend.steps[order], blend.shares[order], flown)


def _draw(rows: Tensor, count: int, key: Key) -> Tensor:
    """Return ``count`` of ``rows`` [s] by systematic resampling in random order: each one count / s times on average."""
    lots = key.uniform(len(rows) + 1).squeeze(0)
    shuffled = rows[lots[1:].argsort(stable=True)]
    places = ((torch.arange(count) + lots[0]) * (len(rows) / count)).long().clamp(max=len(rows) - 1)
    return shuffled[places]
