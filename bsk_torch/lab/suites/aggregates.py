"""Measures of methods over all tasks of a suite, with stratified bootstrap intervals.

A method has one or more runs in each task, such as training seeds. The score of a run is its mean over the episodes of the task.

Source of the interquartile mean, the optimality gap, the performance profile, the probability of improvement and the stratified
bootstrap: Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 2021.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = [
    "AGGREGATES",
    "Interval",
    "Runs",
    "bootstrap",
    "improvement",
    "interquartile_mean",
    "interval",
    "optimality_gap",
    "profile",
    "run_scores",
]

Runs = Mapping[str, Tensor]
"""Scores of the episodes of a method by task, [R, E] each: R runs, the same number in all tasks, and E episodes of the task."""


class Interval(NamedTuple):
    """A value with its 95 % bootstrap interval, between percentiles of the replicates."""

    value: float
    low: float
    high: float


def interquartile_mean(scores: Tensor) -> Tensor:
    """Return the mean of the middle half of scores [..., R, T] over runs and tasks, [...].

    A quarter of the scores, rounded down, is left out at either end.
    """
    ordered = scores.flatten(-2).sort(-1).values
    ends = ordered.shape[-1] // 4
    return ordered[..., ends : ordered.shape[-1] - ends].mean(-1)


def optimality_gap(scores: Tensor) -> Tensor:
    """Return how far scores [..., R, T] are below 1 on average over runs and tasks, [...]; those above 1 count as 1."""
    return 1.0 - scores.clamp(max=1.0).mean((-2, -1))


def profile(scores: Tensor, thresholds: Tensor) -> Tensor:
    """Return the fraction of the scores [..., R, T] above each of the ``thresholds`` [K], [..., K]."""
    return (scores.flatten(-2).unsqueeze(-2) > thresholds.unsqueeze(-1)).to(scores.dtype).mean(-1)


def improvement(scores: Tensor, rivals: Tensor) -> Tensor:
    """Return the probability that a run has a higher score than one of another method, on average over tasks, [...].

    Equal scores count as half.

    Args:
        scores: Scores of a method, [..., R, T].
        rivals: Scores of the other method in the same tasks, [..., Q, T].
    """
    difference = scores.unsqueeze(-2) - rivals.unsqueeze(-3)
    return ((difference.sign() + 1.0) / 2.0).mean((-3, -2, -1))


AGGREGATES: dict[str, Callable[[Tensor], Tensor]] = {
    "IQM": interquartile_mean,
    "mean": lambda scores: scores.mean((-2, -1)),
    "optimality gap": optimality_gap,
}
"""Measures of the scores [..., R, T] of a method, by name."""


def run_scores(runs: Runs) -> Tensor:
    """Return the mean scores of the runs of a method, [R, T] for T tasks in their order.

    Raises:
        ValueError: If the number of runs differs between tasks.
    """
    counts = {task: len(scores) for task, scores in runs.items()}
    if len(set(counts.values())) != 1:
        raise ValueError(f"a method must have as many runs in each task, and has {counts}")
    return torch.stack([scores.double().mean(1) for scores in runs.values()], -1)


def bootstrap(methods: Mapping[str, Runs], replicates: int = 2000, seed: int = 0) -> dict[str, Tensor]:
    """Return resampled scores of the runs of each method, [B, R, T].

    The bootstrap is stratified: runs are drawn with replacement within each method and task. Episodes are drawn with replacement
    within each task, the same for all methods, as all play the same episodes. A method with one run has the uncertainty of its
    episodes only.

    Args:
        methods: Runs of each method, in the same tasks with the same episodes.
        replicates: Number of replicates, B.
        seed: Seed of the draws. Those of a method do not depend on the other methods.

    Raises:
        ValueError: If the methods have no, other or differently many runs, tasks or episodes, or scores that are not finite.
    """
    _check(methods)
    tasks: list[str] = list(next(iter(methods.values())))
    resampled: dict[str, list[Tensor]] = {name: [] for name in methods}
    for k, task in enumerate(tasks):
        episodes = next(iter(methods.values()))[task].shape[1]
        draws = torch.Generator().manual_seed(seed * len(tasks) + k)
        picks = torch.randint(episodes, (replicates, episodes), generator=draws)
        weights = torch.zeros(replicates, episodes, dtype=torch.float64)
        weights.scatter_add_(1, picks, torch.full(picks.shape, 1.0 / episodes, dtype=torch.float64))
        state = draws.get_state()
        for name, runs in methods.items():
            draws.set_state(state)
            scores = weights @ runs[task].double().T
            picked = torch.randint(scores.shape[1], scores.shape, generator=draws)
            resampled[name].append(scores.gather(1, picked))
    return {name: torch.stack(scores, -1) for name, scores in resampled.items()}


def interval(value: Tensor, replicates: Tensor) -> Interval:
    """Return a value [] with the 95 % interval between percentiles of its ``replicates`` [B]."""
    low, high = replicates.quantile(torch.tensor([0.025, 0.975], dtype=replicates.dtype)).tolist()
    return Interval(float(value), low, high)


def _check(methods: Mapping[str, Runs]) -> None:
    if not methods:
        raise ValueError("methods={} must have at least one method")
    first = next(iter(methods))
    episodes = {task: scores.shape[1] for task, scores in methods[first].items()}
    for name, runs in methods.items():
        counts = {task: scores.shape[1] for task, scores in runs.items()}
        if counts != episodes or list(counts) != list(episodes):
            raise ValueError(f"{name} has tasks and episodes {counts}, {first} has {episodes}; they must be the same")
        if not torch.isfinite(run_scores(runs)).all():
            raise ValueError(f"the scores of {name} must be finite")
