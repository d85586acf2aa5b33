"""Probabilities of losses and other rare events under a policy, the ways that lead to them, and episodes to fly again.

Everything random in an episode is drawn from keys (:mod:`bsk_torch.rand`): initial states, scenarios, faults, noise, and random
numbers of policies. So an episode is a function of these numbers. Subset simulation (:mod:`bsk_torch.lab.risk.subset`) walks in
their space, and screened sampling (:mod:`bsk_torch.lab.risk.screened`) flies the seeds whose draws at reset make the event
likely. Nothing needs to be known of the environment except a level that grows toward the event.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch._checks import number, whole
from bsk_torch.env import Tasking
from bsk_torch.files import finite
from bsk_torch.lab.planners.agent_table import AgentTable
from bsk_torch.lab.planners.base_policies import Base, base_of
from bsk_torch.lab.planners.branches import check_copyable
from bsk_torch.lab.planners.planner import check_no_planner
from bsk_torch.lab.risk.rare_events import DEATH, Function, rare_event
from bsk_torch.lab.risk.rare_flights import DRAWN, FAILED, TIME, Flights
from bsk_torch.lab.risk.screened import Screen, Screened, ScreenedSampling
from bsk_torch.lab.risk.subset import CHAIN, HAPPENS, STUCK, Repetitions, Sample, SubsetSimulation, Tally
from bsk_torch.rand import blended
from bsk_torch.rl.evaluation.statistics import confidence, wilson
from bsk_torch.sim.names import one_of

SUBSET, SCREEN = METHODS = ("subset", "screen")
"""Names of the methods: subset simulation and screened sampling."""

LEARNED, MOST_LEARNED = 0.5, 4000
"""Episodes from which screened sampling learns, over those of all repetitions, and the largest number of them."""

LEAST_REPETITIONS = 4
"""Smallest number of repetitions, for an interval of any use."""

QUANTILES = (0.05, 0.5, 0.95)
"""Quantiles that describe the distribution of a drawn number."""


class Interval(NamedTuple):
    """An estimate of a probability with its 95 % confidence interval; of an event that was not seen, 0 with an upper limit."""

    mean: float
    low: float
    high: float


class Shift(NamedTuple):
    """A drawn number in the episodes with the event, compared with all episodes.

    Attributes:
        name: Name of the argument, with the component.
        larger: Probability that the number of an episode with the event is larger than that of another episode.
        event: Its :data:`QUANTILES` in episodes with the event.
        all: Its quantiles in all episodes.
    """

    name: str
    larger: float
    event: tuple[float, ...]
    all: tuple[float, ...]


@dataclass(frozen=True)
class Way:
    """A way to the event: the episodes in which the same aliveness checks failed, or none.

    Attributes:
        cause: Names of the checks that failed at the end; empty without a death.
        share: Share of the probability of the event.
        time: :data:`QUANTILES` of the time of the event, s since reset.
        row: Row of :attr:`Risk.sample` with its most typical episode.
    """

    cause: tuple[str, ...]
    share: float
    time: tuple[float, ...]
    row: int


@dataclass(frozen=True)
class Screening:
    """How an estimate by screened sampling came about.

    Attributes:
        pool: Number of seeds of which a repetition flew the most dangerous ones.
        learned: Number of episodes from which the surrogate was learned.
        seen: Number of these with the event.
        explained: Share of the variance of the levels of independent episodes that the surrogate explains.
        largest: Largest share of an episode in the estimate; NaN if none had the event.
    """

    pool: int
    learned: int
    seen: int
    explained: float
    largest: float


@dataclass(frozen=True)
class Risk:
    """Estimated probability of an event.

    Attributes:
        event: Description of the event.
        probability: The estimate.
        estimates: Estimates of the independent repetitions, [R].
        thresholds: Levels of the stages of subset simulation, K.
        steps: Sizes of the steps of their chains, K.
        shares: Share of the episodes that reach each threshold, and of those with the event, [R, K + 1].
        why: Why there are no further thresholds; see :class:`~bsk_torch.lab.risk.subset.Climb`.
        highest: Largest finite level of the last stage, or of the episodes learned from.
        tally: Flown episodes and simulated time, those of the first run or of learning included.
        seconds: Mean simulated time of an episode, s.
        sample: Episodes with the event.
        weight: Their weights, which sum to 1.
        ways: Ways to the event, the most likely one first.
        actions: Actions of all agents in the most typical episode of each way; see :meth:`Flights.actions`.
        shifts: Drawn numbers, the most different one first.
        checks: Names of the aliveness checks, in the columns of the note ``failed`` of ``sample``.
        columns: Names of the drawn numbers, in the columns of its note ``drawn``.
        screening: How screened sampling went; None for subset simulation.
    """

    event: str
    probability: Interval
    estimates: Tensor
    thresholds: list[float]
    steps: list[float]
    shares: Tensor
    why: str
    highest: float
    tally: Tally
    seconds: float
    sample: Sample = field(repr=False)
    weight: Tensor = field(repr=False)
    ways: list[Way] = field(repr=False)
    actions: list[list[object]] = field(repr=False)
    shifts: list[Shift] = field(repr=False)
    checks: list[str] = field(repr=False)
    columns: list[str] = field(repr=False)
    screening: Screening | None = None

    def paths(self) -> Sample:
        """Return the most typical episode of each way, the most likely way first."""
        return self.sample.take(torch.tensor([way.row for way in self.ways], dtype=torch.int64))

    @property
    def error(self) -> float:
        """Relative standard error of the estimate; infinite for one repetition or an event that was not seen."""
        mean, n = float(self.estimates.mean()), len(self.estimates)
        return float(self.estimates.std()) / n**0.5 / mean if n > 1 and mean > 0.0 else float("inf")

    @property
    def saved(self) -> float:
        """Simulated time of independent episodes with the same relative error, over that of the estimate; NaN if unknown.

        With n episodes, the relative error of the share of those with an event of probability p is ``sqrt((1 - p) / (p n))``.
        """
        p, error = float(self.estimates.mean()), self.error
        if not 0.0 < error < float("inf"):
            return float("nan")
        return (1.0 - p) / (p * error**2) * self.seconds / self.tally.seconds

    def to_dict(self) -> dict[str, object]:
        """Return everything but the episodes, for JSON."""
        error, highest, saved = finite([self.error, self.highest, self.saved])
        return {
            "event": self.event,
            "probability": self.probability._asdict(),
            "estimates": self.estimates.tolist(),
            "relative_error": error,
            "thresholds": self.thresholds,
            "steps": self.steps,
            "shares": self.shares.mean(0).tolist(),
            "why": self.why,
            "highest_level": highest,
            "screening": self.screening and asdict(self.screening) | {"largest": finite([self.screening.largest])[0]},
            **asdict(self.tally),
            "seconds_per_episode": self.seconds,
            "saved": saved,
            "ways": [asdict(way) | {"seed": int(self.sample.seeds[way.row])} for way in self.ways],
            "shifts": [{"name": s.name, "larger": s.larger, "event": finite(s.event), "all": finite(s.all)} for s in self.shifts],
        }


def learned_from(episodes: int, repetitions: int) -> int:
    """Return the number of episodes from which screened sampling learns, given those of a repetition, and the repetitions."""
    return min(int(LEARNED * episodes * repetitions), MOST_LEARNED)


def risk(
    env: Tasking,
    policy: Base = None,
    *,
    event: str | Function = DEATH,
    level: str | Sequence[str] | Function | None = None,
    method: str = SUBSET,
    episodes: int = 1000,
    repetitions: int = 8,
    smallest: float = 1e-9,
    pool: int = 1_000_000,
    seed: int = 0,
    tell: Callable[[str], object] = lambda words: None,
) -> Risk:
    """Estimate the probability of an event in an episode, down to 1e-6 and below.

    Subset simulation follows everything random in small steps. Screened sampling needs far fewer simulated seconds where what is
    drawn at reset decides about the event, and about as many as independent episodes where it does not.

    Args:
        env: The environment; copies of it play ``num_envs`` episodes at a time, which does not affect results.
        policy: The policy; see :func:`bsk_torch.lab.planners.base_of`. It takes its most probable actions.
        event: The event; see :func:`~bsk_torch.lab.risk.rare_events.rare_event`.
        level: Level that grows toward it; likewise.
        method: ``"subset"`` for subset simulation, ``"screen"`` for screened sampling.
        episodes: Independent episodes of each repetition, a multiple of 10, of which later stages of subset simulation need 9 new
            ones for 10; for screened sampling, the flown episodes of each repetition. Half as many, but no more than 4000 in
            all, are flown before for learning.
        repetitions: Independent repetitions R, at least 4, from which the interval follows.
        smallest: Probability at which the search of subset simulation for the event ends.
        pool: Number of seeds of which screened sampling chooses the flown ones, in each repetition, at least twice the
            episodes. With a probability p, ``pool * repetitions * p`` of them have the event.
        seed: Seed of the estimate.
        tell: Called with a description of each stage.

    Raises:
        TypeError: If ``env`` is not an environment, or ``policy`` is not a policy.
        ValueError: For other invalid arguments, and environments that do not repeat the episode of a seed.
    """
    if not isinstance(env, Tasking):
        raise TypeError(f"env={env!r} must be an environment of bsk_torch; of a transformed one give base_env")
    one_of("method", method, METHODS)
    if whole("episodes", episodes, 2 * CHAIN) % CHAIN:
        raise ValueError(f"episodes={episodes} must be a multiple of {CHAIN}, the number of states of a chain")
    whole("repetitions", repetitions, LEAST_REPETITIONS)
    number("smallest", smallest, 1e-15, 1.0)
    whole("pool", pool, 2 * episodes, 2**31)
    check_no_planner(policy)
    check_copyable(env, AgentTable(env))
    rows = env.num_envs
    twin = env.like(rows, env_ids=[0] * rows)
    twin.reset()
    flights = Flights(twin, base_of(policy, twin), rare_event(twin, event, level))
    whole("seed", seed, 0)
    if method == SUBSET:
        return _by_subsets(flights, SubsetSimulation(flights, episodes, seed, tell=tell), smallest, repetitions)
    learned = learned_from(episodes, repetitions)
    sampling = ScreenedSampling(flights, flights.draws, episodes, pool, learned, flights.event.threshold, seed, tell=tell)
    screen = sampling.learn()
    return _by_screening(flights, screen, sampling.repeat(screen, repetitions), sampling)


def interval(estimates: Tensor) -> Interval:
    """Return the mean of independent, unbiased estimates [R] with its 95 % confidence interval.

    The interval is symmetric on a logarithmic scale, with the relative half width of Student's interval.
    """
    estimate = confidence(estimates)
    if estimate.mean == 0.0:
        return Interval(0.0, 0.0, 1.0)
    factor = float(torch.tensor(estimate.half_width / estimate.mean, dtype=torch.float64).exp())
    return Interval(estimate.mean, estimate.mean / factor, min(1.0, estimate.mean * factor))


def _probability(repeated: Repetitions) -> Interval:
    """Return the estimate with its interval.

    The upper limit for an event that was not seen is the smaller one of two, each with a confidence of 97.5 %, so that both hold
    with 95 %: that of reaching the last threshold, and that of Clopper and Pearson for the n independent episodes,
    ``1 - 0.025^(1/n)``.
    """
    estimates, n = repeated.estimates, len(repeated.first.seeds)
    if repeated.shares.shape[1] == 1:  # independent episodes only
        count = int((repeated.first.level == torch.inf).sum())
        low, high = wilson(count, n)
        return Interval(count / n, low, high) if count else Interval(0.0, 0.0, 1.0 - 0.05 ** (1.0 / n))
    if bool((estimates > 0.0).any()):
        return interval(estimates)
    return Interval(0.0, 0.0, min(1.0 - 0.025 ** (1.0 / n), interval(repeated.reached).high))


def _by_subsets(flights: Flights, simulation: SubsetSimulation, smallest: float, repetitions: int) -> Risk:
    climb = simulation.climb(smallest)
    if climb.why == STUCK:
        simulation.tell(f"the level does not rise above {float(climb.last.level.max()):.4g}")
    repeated = simulation.repeat(climb.stages, repetitions)
    last = repeated.last
    rows = torch.nonzero(last.level == torch.inf).squeeze(1)
    levels = climb.last.level[climb.last.level < torch.inf]
    return Risk(
        event=flights.event.title,
        probability=_probability(repeated),
        estimates=repeated.estimates,
        thresholds=[stage.threshold for stage in climb.stages],
        steps=[stage.step for stage in climb.stages],
        shares=repeated.shares,
        why=climb.why,
        highest=float(levels.max()) if len(levels) else float("inf"),
        tally=simulation.tally,
        **_described(flights, last.take(rows), repeated.reached[repeated.repetition[rows]], repeated.first),
    )


def _by_screening(flights: Flights, screen: Screen, screened: Screened, sampling: ScreenedSampling) -> Risk:
    # the upper limit for an event that was not seen is Clopper and Pearson's for the flights that the surrogate did not choose
    weight, happened = screened.weight, bool(len(screened.weight))
    unseen = Interval(0.0, 0.0, 1.0 - 0.05 ** (1.0 / screened.blind))
    return Risk(
        event=flights.event.title,
        probability=interval(screened.estimates) if happened else unseen,
        estimates=screened.estimates,
        thresholds=[],
        steps=[],
        shares=screened.estimates.unsqueeze(1),
        why=HAPPENS if happened else STUCK,
        highest=screen.highest,
        tally=sampling.tally,
        screening=Screening(
            pool=sampling.pool,
            learned=sampling.learned,
            seen=screen.events,
            explained=screen.explained,
            largest=float(weight.max() / weight.sum()) if happened else float("nan"),
        ),
        **_described(flights, screened.sample, weight, screen.first),
    )


def _described(flights: Flights, sample: Sample, weight: Tensor, first: Sample) -> dict[str, Any]:
    """Return the parts of a result that describe the ways to the event.

    ``sample`` [n] are the episodes with the event, ``weight`` [n] their weights up to a factor, ``first`` independent episodes.
    """
    weight = weight / weight.sum().clamp(min=torch.finfo(torch.float64).tiny)
    everywhere = first.flown[DRAWN]
    shifts = [] if not len(weight) else _shifts(flights.columns, sample.flown[DRAWN], weight, everywhere)
    ways = _ways(flights, sample, weight, everywhere, shifts)
    typical = sample.take(torch.tensor([way.row for way in ways], dtype=torch.int64))
    with blended(typical.blend()) if ways else nullcontext():
        actions = flights.actions(typical.seeds) if ways else []
    return dict(
        seconds=float(first.flown["seconds"].mean()),
        sample=sample,
        weight=weight,
        ways=ways,
        actions=actions,
        shifts=shifts,
        checks=flights.checks,
        columns=flights.columns,
    )


def _shifts(names: Sequence[str], drawn: Tensor, weight: Tensor, everywhere: Tensor) -> list[Shift]:
    """Return how numbers [n, D] with weights [n] differ from those of all episodes [P, D], the most different one first."""
    even = torch.full_like(everywhere[:, 0], 1.0 / max(len(everywhere), 1)) if everywhere.shape[1] else weight
    shifts = []
    for name, values, reference in zip(names, drawn.T, everywhere.T, strict=True):
        larger = float((weight * _rank(values, reference)).sum())
        shifts.append(Shift(name, larger, _quantiles(values, weight), _quantiles(reference, even)))
    return sorted(shifts, key=lambda shift: -abs(shift.larger - 0.5))


def _rank(values: Tensor, reference: Tensor) -> Tensor:
    """Return the share of ``reference`` [P] below each of ``values`` [n], where equal ones count one half."""
    ordered = reference.sort().values
    below, upto = (torch.searchsorted(ordered, values.contiguous(), right=right) for right in (False, True))
    return 0.5 * (below + upto).double() / len(reference)


def _quantiles(values: Tensor, weight: Tensor) -> tuple[float, ...]:
    """Return the :data:`QUANTILES` of ``values`` [n] with weights [n] that sum to 1; values may be infinite."""
    order = values.argsort()
    cumulative = weight[order].cumsum(0)
    places = [int(torch.searchsorted(cumulative, q).clamp(max=len(values) - 1)) for q in QUANTILES]
    return tuple(float(values[order[place]]) for place in places)


def _ways(flights: Flights, sample: Sample, weight: Tensor, everywhere: Tensor, shifts: Sequence[Shift]) -> list[Way]:
    """Return the ways to the event, the most likely one first.

    The most typical episode of a way has the least sum of differences from the way's median ranks of drawn numbers, each weighted
    by how much the number differs from all episodes.
    """
    if not len(sample.seeds):
        return []
    failed, importance = sample.flown[FAILED], {shift.name: abs(shift.larger - 0.5) for shift in shifts}
    ranks = [
        _rank(values, reference) * importance[name]
        for name, values, reference in zip(flights.columns, sample.flown[DRAWN].T, everywhere.T, strict=True)
    ]
    place = torch.stack(ranks, 1) if ranks else torch.zeros(len(weight), 1, dtype=torch.float64)
    ways = []
    for kind in failed.unique(dim=0):
        rows = torch.nonzero((failed == kind).all(1)).squeeze(1)
        off = (place[rows] - place[rows].median(0).values).abs().sum(1)
        time, share = sample.flown[TIME][rows], weight[rows]
        cause = tuple(name for name, wrong in zip(flights.checks, kind.tolist(), strict=True) if wrong)
        ways.append(Way(cause, float(share.sum()), _quantiles(time, share / share.sum()), int(rows[off.argmin()])))
    return sorted(ways, key=lambda way: -way.share)
