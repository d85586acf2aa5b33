"""Search over the thresholds of a rule, with many settings in one batch of episodes."""

from __future__ import annotations

import inspect
import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.quasirandom import SobolEngine

from bsk_torch._checks import whole
from bsk_torch.env import ConstellationTasking, Tasking
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.policies.shared_policy import member_view, member_views, shared
from bsk_torch.rl.rules.baselines import THRESHOLDS, ScanRule
from bsk_torch.sim.names import nearest
from bsk_torch.wrappers.policies import FunctionPolicy, positional

__all__ = ["Tuned", "tune"]

Range = tuple[float, float] | Sequence[float]
"""A tuple of minimum and maximum, or a list of the values to try."""

FIRST, SPAN = 2**40, 2**24
"""First seed of the episodes of tunings, and the number of seeds of each."""

MOST = 4096
"""Episodes at once."""

KEPT = 4
"""Part of the settings that a round of successive halving keeps: one of so many."""

NARROWING = 0.5
"""Width of the ranges of a search, as a part of the widths in the search before."""

THRESHOLD = "thresholds"
"""Key of the thresholds of each row."""


@dataclass(frozen=True)
class Tuned:
    """The result of :func:`tune`.

    Attributes:
        thresholds: The best thresholds, by name.
        rule: The rule with these thresholds: a function of the observation, or a rule of the package.
        evaluation: Results of this rule in episodes that the search has not seen.
        settings: All settings [K] by name of the threshold, of all searches; the first are the rule's defaults, if they lie
            within the ranges.
        returns: Mean return of each setting in the episodes that it has flown, [K].
        flown: Number of these episodes, [K].
        episodes: Number of episodes of the search and the evaluation.
        core_seconds: CPU time of both.
    """

    thresholds: dict[str, float]
    rule: Callable[..., Tensor]
    evaluation: Evaluation
    settings: dict[str, Tensor]
    returns: Tensor
    flown: Tensor
    episodes: int
    core_seconds: float

    def __str__(self) -> str:
        values = ", ".join(f"{name}={value:.4g}" for name, value in self.thresholds.items())
        return (
            f"{values}: return {self.evaluation.mean_return} in {len(self.evaluation.returns)} unseen episodes; tuned in "
            f"{self.episodes:,} episodes, {len(self.returns)} settings, {self.core_seconds:.1f} core-seconds"
        )


class RowThresholds(FunctionPolicy):
    """A rule whose thresholds differ between rows."""

    def __init__(self, rule: Callable[..., object], satellite: SatelliteGroup, names: Sequence[str]) -> None:
        """Call ``rule`` for ``satellite`` with the thresholds ``names`` of the rows."""
        super().__init__(partial(rule, **dict.fromkeys(names, 0.0)), satellite, len(positional(rule)) == 2)
        self.function, self.names = rule, names
        self.in_keys = [*self.in_keys, THRESHOLD]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` by the thresholds of each row."""
        self.thresholds = {name: tensordict[THRESHOLD, name] for name in self.names}
        return super().forward(tensordict)

    def _result(self, inputs: object, *mask: Tensor) -> object:
        return self.function(inputs, *mask, **self.thresholds)


def tune(
    rule: str | ScanRule | Callable[..., object],
    env: Tasking,
    ranges: Mapping[str, Range],
    *,
    settings: int = 64,
    episodes: int = 16,
    rounds: int = 3,
    zooms: int = 2,
    fresh: int = 256,
    seed: int = 0,
) -> Tuned:
    """Search for the best thresholds of a rule, with all settings in one batch: each row of it has its own thresholds.

    Successive halving (K. Jamieson and A. Talwalkar, "Non-stochastic best arm identification and hyperparameter optimization",
    AISTATS 2016): each round flies the remaining settings in new episodes, the same for all of them, and keeps the best quarter,
    which the next round flies in four times as many. With ``rounds=1``, all settings fly equally many episodes. A search in the
    whole ranges is followed by ``zooms`` searches in ranges of half the width around the best setting, which flies again, too:
    random settings of many thresholds are rarely near the best one.

    Args:
        rule: A function of the observation, which may take the action mask second, with thresholds as keyword arguments, such as
            ``def rule(observation, *, low=0.2)``; they are numbers, or tensors [N] here. It returns what
            :func:`~bsk_torch.wrappers.policies.policy_of_one` describes. Or the name of a rule of the package with thresholds,
            ``"rule"``, ``"cautious"`` or ``"science"``, or a :class:`~bsk_torch.rl.rules.baselines.ScanRule`.
        env: An environment with one satellite, or with equal ones; episodes are flown in others like it.
        ranges: For each threshold to tune, a tuple of its minimum and maximum, or a list of values. With lists only, all
            combinations are tried, once; otherwise ``settings`` of them are drawn (a scrambled Sobol sequence).
        settings: Number of settings of each search.
        episodes: Episodes of each in the first round.
        rounds: Number of rounds of each search.
        zooms: Number of searches in narrower ranges.
        fresh: Episodes of the final evaluation, which the search has not seen.
        seed: Seed of settings and episodes.

    Raises:
        TypeError: For an object that is not a rule or an environment.
        ValueError: For a threshold that the rule does not have, with the nearest name, or a wrong range or number.
    """
    begin = time.process_time()
    if not isinstance(env, Tasking):
        raise TypeError(f"env={env!r:.80} must be an environment of bsk_torch")
    numbers = {"settings": settings, "episodes": episodes, "rounds": rounds, "zooms": zooms, "fresh": fresh}
    for name, value in numbers.items():
        whole(name, value, {"zooms": 0, "fresh": 2}.get(name, 1))
    satellite = member_view(env).satellite
    function, defaults = _tunable(rule, satellite)
    table = _settings(ranges, defaults, settings, whole("seed", seed, 0))
    count = len(next(iter(table.values())))
    flights = _Flights(env, RowThresholds(function, satellite, list(table)), min(MOST, episodes * count))
    if not any(isinstance(values, tuple) for values in ranges.values()):
        zooms = 0
    first, best = FIRST + seed * SPAN, dict[str, float]()
    searches: list[tuple[dict[str, Tensor], Tensor, Tensor]] = []
    for k in range(zooms + 1):
        if k:
            narrow = {name: _around(best[name], values, NARROWING**k) for name, values in ranges.items()}
            table = _settings(narrow, best, settings, seed + k)
        returns, flown, winner = _halving(flights, table, episodes, rounds, first)
        searches.append((table, returns, flown))
        first += int(flown[winner])
        best = {name: float(values[winner]) for name, values in table.items()}
    chosen = partial(function, **best)
    judge = env.like(min(fresh, MOST), env_ids=[0] * min(fresh, MOST))
    evaluation = evaluate(chosen, judge, seeds=range(first, first + fresh))
    every = {name: torch.cat([table[name] for table, _, _ in searches]) for name in ranges}
    returns, flown = torch.cat([search[1] for search in searches]), torch.cat([search[2] for search in searches])
    return Tuned(best, chosen, evaluation, every, returns, flown, int(flown.sum()) + fresh, time.process_time() - begin)


def _halving(
    flights: _Flights, table: Mapping[str, Tensor], episodes: int, rounds: int, first: int
) -> tuple[Tensor, Tensor, int]:
    """Return mean returns [K] and numbers of episodes [K] of settings, and which is the best, by successive halving."""
    alive = torch.arange(len(next(iter(table.values()))))
    total, flown = torch.zeros(len(alive), dtype=torch.float64), torch.zeros(len(alive), dtype=torch.int64)
    for k in range(rounds):
        number = episodes * KEPT**k
        remaining = {name: values[alive] for name, values in table.items()}
        total[alive] += flights.returns(remaining, range(first, first + number)).sum(1)
        flown[alive] += number
        first += number
        ranked = alive[(total[alive] / flown[alive]).argsort(descending=True, stable=True)]
        alive = ranked[: -(-len(ranked) // KEPT)]
    return total / flown, flown, int(ranked[0])


def _around(center: float, values: Range, part: float) -> Range:
    """Return the part of a range around a value in it; lists stay."""
    if not isinstance(values, tuple):
        return values
    half = 0.5 * part * (values[1] - values[0])
    return max(values[0], center - half), min(values[1], center + half)


class _Flights:
    """Flies settings of a rule, each row with its own."""

    def __init__(self, env: Tasking, policy: RowThresholds, rows: int) -> None:
        """Fly ``rows`` episodes at once."""
        self.env = env.like(rows, env_ids=[0] * rows)
        self.group = next(iter(member_views(env))) if isinstance(env, ConstellationTasking) else None
        self.policy = shared(policy, self.env)
        self.now: dict[str, Tensor] = {}

    def returns(self, table: Mapping[str, Tensor], seeds: range) -> Tensor:
        """Return the returns of the settings in ``table``, [K] by name, in the episodes of E ``seeds``, [K, E]."""
        rows, count = self.env.num_envs, len(next(iter(table.values())))
        setting, seed = torch.arange(count).repeat_interleave(len(seeds)), list(seeds) * count
        parts = []
        for part in torch.arange(len(seed)).split(rows):
            padded = torch.nn.functional.pad(setting[part], (0, rows - len(part)), value=int(setting[part[-1]]))
            self.now = {name: values[padded].to(self.env.device) for name, values in table.items()}
            parts.append(evaluate(self._act, self.env, seeds=[seed[k] for k in part.tolist()]).returns)
        return torch.cat(parts).view(count, len(seeds)).cpu()

    def _act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the actions by the thresholds of the rows."""
        if self.group is None:
            tensordict[THRESHOLD] = TensorDict(self.now, tensordict.batch_size)
        else:
            agents = tensordict[self.group]
            of_rows = TensorDict(self.now, tensordict.batch_size)
            agents[THRESHOLD] = of_rows.unsqueeze(-1).expand(agents.batch_size)
        return self.policy(tensordict)


def _tunable(rule: object, satellite: SatelliteGroup) -> tuple[Callable[..., Tensor], dict[str, float | None]]:
    """Return a rule as a function with thresholds, and their defaults; None for one without a default."""
    if isinstance(rule, str):
        if rule not in THRESHOLDS:
            advice = f"{nearest(rule, THRESHOLDS)}; or write a function of the observation with thresholds as keyword arguments"
            raise ValueError(f"rule={rule!r} is not a rule with thresholds; {advice}")
        rule = THRESHOLDS[rule]
    if isinstance(rule, ScanRule):
        return partial(_decided, rule, satellite), asdict(rule)
    if isinstance(rule, type) or not callable(rule):
        raise TypeError(f"rule={rule!r:.80} must be the name of a rule, or a function of the observation with thresholds")
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    parameters = [p for p in inspect.signature(rule).parameters.values() if p.kind in kinds and p.name not in positional(rule)]
    return rule, {p.name: None if p.default is p.empty else p.default for p in parameters}


def _decided(rule: ScanRule, satellite: SatelliteGroup, observation: Tensor, **thresholds: Any) -> Tensor:
    """Return the actions of a rule of the package with other thresholds, numbers or [N]."""
    return replace(rule, **thresholds).decide(observation, satellite.observation_description, satellite.action_description)


def _settings(ranges: Mapping[str, Range], defaults: Mapping[str, float | None], number: int, seed: int) -> dict[str, Tensor]:
    """Return the settings to try, [K] by name, in numbers of float32, with which rules compare observations."""
    if not isinstance(ranges, Mapping) or not ranges:
        raise TypeError(f"ranges={ranges!r:.80} must be a dictionary of at least one threshold, such as {{'low': (0.1, 0.5)}}")
    for name, values in ranges.items():
        if name not in defaults:
            raise ValueError(f"ranges: the rule has no threshold {name!r}; {nearest(name, defaults)}")
        numbers = torch.as_tensor(values, dtype=torch.float64)
        if numbers.ndim != 1 or not len(numbers) or not bool(numbers.isfinite().all()):
            raise ValueError(f"ranges[{name!r}]={values!r} must be a tuple (minimum, maximum) or a list of numbers")
        if isinstance(values, tuple) and (len(values) != 2 or values[0] >= values[1]):
            raise ValueError(f"ranges[{name!r}]={values!r} must be a tuple (minimum, maximum), or a list of the values to try")
    if not any(isinstance(values, tuple) for values in ranges.values()):
        columns = list(zip(*itertools.product(*ranges.values()), strict=True))
        return {name: torch.tensor(column, dtype=torch.float32) for name, column in zip(ranges, columns, strict=True)}
    lots = SobolEngine(len(ranges), scramble=True, seed=seed).draw(number, dtype=torch.float64)
    table = {name: _spread(values, lots[:, k]) for k, (name, values) in enumerate(ranges.items())}
    if all(_lies_in(defaults[name], values) for name, values in ranges.items()):
        for name, column in table.items():
            column[0] = float(defaults[name] or 0.0)
    return table


def _spread(values: Range, lots: Tensor) -> Tensor:
    """Return values of a range for uniform numbers ``lots`` [K]."""
    if isinstance(values, tuple):
        return (values[0] + (values[1] - values[0]) * lots).float()
    return torch.tensor(values, dtype=torch.float32)[(lots * len(values)).long().clamp(max=len(values) - 1)]


def _lies_in(default: float | None, values: Range) -> bool:
    if not isinstance(default, int | float):
        return False
    if isinstance(values, tuple):
        return values[0] <= default <= values[1]
    return bool((torch.tensor(values, dtype=torch.float32) == torch.tensor(default, dtype=torch.float32)).any())
