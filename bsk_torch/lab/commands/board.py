"""Scores of methods in the tasks of a suite, and their aggregates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from bsk_torch.cli.terminal import fail, print_message, refusing
from bsk_torch.lab.commands.results import Returns
from bsk_torch.lab.suites.aggregates import AGGREGATES, Interval, bootstrap, improvement, interval, profile, run_scores
from bsk_torch.lab.suites.suite import references
from bsk_torch.sim.names import nearest

THRESHOLDS, MARGIN = 201, 0.05
"""Number of scores at which performance profiles are computed, and how far these lie outside of all scores."""


@dataclass(frozen=True)
class Board:
    """Methods of a suite.

    Attributes:
        suite: Name of the suite.
        scores: Scores of each method, [R, T].
        replicates: Resampled scores of each method, [B, R, T].
        tasks: Names of the tasks.
        against: Method with which the others are compared.
        flights: Episodes repeated on Basilisk by method: those that are the same, and all.
        libraries: Libraries that made the policies of each method, with their versions.
    """

    suite: str
    scores: Mapping[str, Tensor]
    replicates: Mapping[str, Tensor]
    tasks: Sequence[str]
    against: str
    flights: Mapping[str, tuple[int, int]]
    libraries: Mapping[str, list[str]]

    def measures(self, method: str) -> dict[str, Interval]:
        """Return the aggregates of a method, and the probability that it is better than ``against``, with their intervals."""
        value, drawn = self.scores[method], self.replicates[method]
        values = {name: interval(measure(value), measure(drawn)) for name, measure in AGGREGATES.items()}
        if method != self.against:
            better = improvement(value, self.scores[self.against])
            values["better"] = interval(better, improvement(drawn, self.replicates[self.against]))
        return values

    def profiles(self) -> tuple[Tensor, dict[str, tuple[Tensor, Tensor, Tensor]]]:
        """Return thresholds [K], and for each method its performance profile with the ends of the interval, [K] each."""
        scores = torch.cat([one.flatten() for one in self.scores.values()])
        first, last = float(scores.min().clamp(max=0.0)), float(scores.max().clamp(min=1.0))
        thresholds = torch.linspace(first - MARGIN, last + MARGIN, THRESHOLDS, dtype=scores.dtype)
        ends = {
            name: profile(drawn, thresholds).quantile(scores.new_tensor([0.025, 0.975]), dim=0)
            for name, drawn in self.replicates.items()
        }
        return thresholds, {name: (profile(self.scores[name], thresholds), *band) for name, band in ends.items()}


def board_of(
    results: Mapping[str, Mapping[str, Returns]],
    methods: Mapping[str, Sequence[str]],
    suite: str,
    titles: Sequence[str],
    against: str | None,
) -> Board:
    """Return the methods in the tasks ``titles`` that all of them play; ends the program without one or for another ``against``.

    In each task, policies that played fewer episodes than another policy of a method, such as planners, are left out.
    """
    members = {policy for policies in methods.values() for policy in policies}
    rows = {task: {policy: results[policy][task] for policy in members if task in results[policy]} for task in titles}
    for task, entries in rows.items():
        most = max((len(row["returns"]) for row in entries.values()), default=0)
        for policy in [policy for policy, row in entries.items() if len(row["returns"]) < most]:
            print_message(f"{task}: {policy} played {len(entries.pop(policy)['returns'])} of {most} episodes, and is left out")
    tasks = [task for task in titles if all(any(policy in rows[task] for policy in group) for group in methods.values())]
    if not tasks:
        fail(f"no task is played by all of {', '.join(methods)}; combine policies of several presets with --method NAME=PATTERN")
    if excluded := [task for task in titles if rows[task] and task not in tasks]:
        print_message(f"left out, as not all methods play them: {', '.join(excluded)}")
    if against is not None and against not in methods:
        fail(f"--against {against!r} is not a method; {nearest(against, methods)}")
    runs = {name: {task: scores_of(rows[task], group, suite, task) for task in tasks} for name, group in methods.items()}
    with refusing():
        replicates = bootstrap(runs)
    scores = {name: run_scores(one) for name, one in runs.items()}
    best = max(scores, key=lambda name: float(AGGREGATES["IQM"](scores[name])))
    played = {name: [rows[task][one] for task in tasks for one in group if one in rows[task]] for name, group in methods.items()}
    flights = {name: flights_of(entries) for name, entries in played.items()}
    libraries = {name: sorted({row["library"] for row in entries if "library" in row}) for name, entries in played.items()}
    return Board(suite, scores, replicates, tasks, against or best, flights, libraries)


def scores_of(rows: Mapping[str, Mapping[str, object]], policies: Sequence[str], suite: str, task: str) -> Tensor:
    """Return the scores of the episodes of those ``policies`` that play a task, [R, E]."""
    low, high = (references(suite)[task][end]["return"] for end in ("low", "high"))
    returns = torch.tensor([rows[policy]["returns"] for policy in policies if policy in rows], dtype=torch.float64)
    return (returns - low) / (high - low)


def flights_of(rows: Sequence[Returns]) -> tuple[int, int]:
    """Return how many episodes are the same on Basilisk, and how many were repeated there."""
    certified = [row["basilisk"] for row in rows if "basilisk" in row]
    return sum(one["same"] for one in certified), sum(len(one["returns"]) for one in certified)
