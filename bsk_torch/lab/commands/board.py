"""Scores of methods in the tasks of a suite, and their aggregates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import torch
from torch import Tensor

from bsk_torch.cli.terminal import fail, print_message, refusing
from bsk_torch.lab.commands.results import Returns
from bsk_torch.lab.suites.aggregates import AGGREGATES, Interval, bootstrap, improvement, interval, profile, run_scores
from bsk_torch.lab.suites.suite import references
from bsk_torch.rl.policies.files import TRAINING
from bsk_torch.sim.names import nearest

THRESHOLDS, MARGIN = 201, 0.05
"""Number of scores at which performance profiles are computed, and how far these lie outside of all scores."""


TRACKS = {"250k": 250_000, "2.5M": 2_500_000}
"""Budget tracks by name: the most decisions from which a policy of a track is learned."""

WHOLE_BATCHES = 1.1
"""Factor by which a training may exceed its track, as it ends with a whole batch."""


@dataclass(frozen=True)
class Board:
    """Methods of a suite.

    Attributes:
        suite: Name of the suite.
        scores: Scores of each method, [R, T].
        replicates: Resampled scores of each method, [B, R, T].
        tasks: Names of the tasks.
        families: Columns of the tasks of each family; of all tasks under the name "" in suites without families.
        against: Method with which the others are compared.
        flights: Episodes repeated on Basilisk by method: those that are the same, and all.
        libraries: Libraries that made the policies of each method, with their versions.
        budgets: What the most expensive training of each method has cost, see :func:`budget_of`.
    """

    suite: str
    scores: Mapping[str, Tensor]
    replicates: Mapping[str, Tensor]
    tasks: Sequence[str]
    families: Mapping[str, list[int]]
    against: str
    flights: Mapping[str, tuple[int, int]]
    libraries: Mapping[str, list[str]]
    budgets: Mapping[str, dict[str, Any] | None]

    def measures(self, method: str) -> dict[str, Interval]:
        """Return the aggregates of a method, and the probability that it is better than ``against``, with their intervals.

        In suites with families, the aggregates are the interquartile means of these, such as ``IQM sites``.
        """
        values = {
            f"{name} {family}".rstrip(): self.over(method, name, columns)
            for family, columns in self.families.items()
            for name in (["IQM"] if family else AGGREGATES)
        }
        if method != self.against:
            better = improvement(self.scores[method], self.scores[self.against])
            values["better"] = interval(better, improvement(self.replicates[method], self.replicates[self.against]))
        return values

    def over(self, method: str, aggregate: str, columns: list[int]) -> Interval:
        """Return one of the :data:`~bsk_torch.lab.suites.aggregates.AGGREGATES` of a method over some tasks."""
        measure = AGGREGATES[aggregate]
        return interval(measure(self.scores[method][:, columns]), measure(self.replicates[method][..., columns]))

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
    titles: Mapping[str, str],
    against: str | None,
) -> Board:
    """Return the methods in the tasks that all of them play; ends the program without one or for another ``against``.

    ``titles`` has the families of tasks by name. In each task, policies that played fewer episodes than another policy of a
    method, such as planners, are left out.
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
        replicates = with_references(bootstrap(runs), [references(suite)[task] for task in tasks])
    scores = {name: run_scores(one) for name, one in runs.items()}
    families: dict[str, list[int]] = {}
    for column, task in enumerate(tasks):
        families.setdefault(titles[task], []).append(column)
    best = ranked(scores, families)[0]
    played = {name: [rows[task][one] for task in tasks for one in group if one in rows[task]] for name, group in methods.items()}
    flights = {name: flights_of(entries) for name, entries in played.items()}
    libraries = {name: sorted({row["library"] for row in entries if "library" in row}) for name, entries in played.items()}
    budgets = {name: budget_of(entries) for name, entries in played.items()}
    return Board(suite, scores, replicates, tasks, families, against or best, flights, libraries, budgets)


def ranked(scores: Mapping[str, Tensor], families: Mapping[str, list[int]]) -> list[str]:
    """Return the methods with ``scores`` [R, T] in descending order of the mean of their families' interquartile means."""
    middle = AGGREGATES["IQM"]
    return sorted(scores, key=lambda name: -sum(float(middle(scores[name][:, columns])) for columns in families.values()))


def with_references(replicates: Mapping[str, Tensor], scales: Sequence[Mapping[str, Any]]) -> dict[str, Tensor]:
    """Return resampled scores [B, R, T] as those of references that are uncertain, too, the same draws for all methods.

    Args:
        replicates: Resampled scores by method, with the references at their means.
        scales: References of each task, see :func:`~bsk_torch.lab.suites.suite.references`. An end with a ``half_width`` is drawn
            from the normal distribution of that 95 % interval; others count as exact.
    """
    generator, count = torch.Generator().manual_seed(0), len(next(iter(replicates.values())))
    normal = torch.randn(2, count, 1, len(scales), generator=generator, dtype=torch.float64)
    spread = [[scale[end].get("half_width", 0.0) / NormalDist().inv_cdf(0.975) for scale in scales] for end in ("low", "high")]
    size = torch.tensor([scale["high"]["return"] - scale["low"]["return"] for scale in scales], dtype=torch.float64)
    low, high = normal * torch.tensor(spread, dtype=torch.float64).view(2, 1, 1, -1) / size
    return {name: (drawn - low) / (1.0 + high - low) for name, drawn in replicates.items()}


def scores_of(rows: Mapping[str, Mapping[str, object]], policies: Sequence[str], suite: str, task: str) -> Tensor:
    """Return the scores of the episodes of those ``policies`` that play a task, [R, E]."""
    low, high = (references(suite)[task][end]["return"] for end in ("low", "high"))
    returns = torch.tensor([rows[policy]["returns"] for policy in policies if policy in rows], dtype=torch.float64)
    return (returns - low) / (high - low)


def budget_of(rows: Sequence[Returns]) -> dict[str, Any] | None:
    """Return the track of a method, and the most that one of its trainings has cost; None if one of them has no record.

    Entries are ``track``, one of :data:`TRACKS`, ``open`` beyond these or ``none`` without training, and
    :data:`~bsk_torch.rl.policies.files.TRAINING`, of which ``tuning_runs`` may be None, not recorded.
    """
    records: list[Mapping[str, Any]] = [dict(record) for row in rows if (record := row.get("training"))]
    if len(records) < len(rows):
        return None
    costs = {name: [record[name] for record in records] for name in TRAINING}
    most: dict[str, Any] = {name: None if None in every else max(every) for name, every in costs.items()}
    fitting = (track for track, limit in TRACKS.items() if most["decisions"] <= WHOLE_BATCHES * limit)
    return {"track": next(fitting, "open") if most["decisions"] else "none", **most}


def flights_of(rows: Sequence[Returns]) -> tuple[int, int]:
    """Return how many episodes are the same on Basilisk, and how many were repeated there."""
    certified = [row["basilisk"] for row in rows if "basilisk" in row]
    return sum(one["same"] for one in certified), sum(len(one["returns"]) for one in certified)
