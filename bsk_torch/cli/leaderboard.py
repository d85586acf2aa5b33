"""``bsk-torch leaderboard``: methods in all tasks of a suite, from files of ``bsk-torch bench``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bsk_torch.cli.bench import add_results, read_earlier, read_result
from bsk_torch.cli.results import Results
from bsk_torch.cli.shared import check_picture, check_writable, extra
from bsk_torch.cli.terminal import fail, print_message
from bsk_torch.files import write_file
from bsk_torch.lab.suites.aggregates import AGGREGATES, Interval, bootstrap, improvement, interval, profile, run_scores
from bsk_torch.lab.suites.suite import published, references, tasks_of
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.tables import print_table

MATCHING = "*?["
"""Characters of patterns, which a policy may have in its name."""


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
    """

    suite: str
    scores: Mapping[str, Tensor]
    replicates: Mapping[str, Tensor]
    tasks: Sequence[str]
    against: str
    flights: Mapping[str, tuple[int, int]]

    def measures(self, method: str) -> dict[str, Interval]:
        """Return the aggregates of a method, and the probability that it is better than ``against``, with their intervals."""
        value, drawn = self.scores[method], self.replicates[method]
        found = {name: interval(measure(value), measure(drawn)) for name, measure in AGGREGATES.items()}
        if method != self.against:
            better = improvement(value, self.scores[self.against])
            found["better"] = interval(better, improvement(drawn, self.replicates[self.against]))
        return found

    def profiles(self) -> tuple[Tensor, dict[str, tuple[Tensor, Tensor, Tensor]]]:
        """Return thresholds [K], and for each method its performance profile with the ends of the interval, [K] each."""
        every = torch.cat([one.flatten() for one in self.scores.values()])
        first, last = float(every.min().clamp(max=0.0)), float(every.max().clamp(min=1.0))
        thresholds = torch.linspace(first - MARGIN, last + MARGIN, THRESHOLDS, dtype=every.dtype)
        ends = {
            name: profile(drawn, thresholds).quantile(every.new_tensor([0.025, 0.975]), dim=0)
            for name, drawn in self.replicates.items()
        }
        return thresholds, {name: (profile(self.scores[name], thresholds), *both) for name, both in ends.items()}


def leaderboard(
    files: Sequence[Path] | None,
    method: Sequence[str] | None,
    presets: str | None,
    against: str | None,
    published_suite: str | None,
    draw: Path | None,
    out: Path | None,
) -> None:
    """Aggregate the scores of methods over tasks; see :mod:`bsk_torch.cli.main`."""
    for path in (draw, out):
        check_writable(path)
    if draw is not None:
        check_picture("--draw", draw)
        extra("bsk_torch.viz.figures.profiles")
    files = files or []
    if published_suite is None and not files:
        fail("no results: name a file of bsk-torch bench, or a suite with --published")
    suite = published_suite or read_result(files[0], Results)[0][1]
    try:
        tasks = [task.title for task in tasks_of(suite, presets)]
        known = published(suite) if published_suite else {"policies": {}, "methods": {}}
    except ValueError as error:
        fail(str(error))
    if not references(suite):
        fail(f"the tasks of the suite {suite} have measures, not scores, and cannot be aggregated")
    mine, results = read_earlier(files, suite, Results), dict[str, dict[str, Any]]()
    if files and not mine:
        fail(f"{', '.join(map(str, files))} has no policies")
    add_results(results, known["policies"])
    add_results(results, mine)
    methods = methods_of(results, method) if method else separate(mine)
    if taken := [name for name in methods if name in known["methods"]]:
        fail(f"{taken[0]!r} is a method of the published results; use another name in --method NAME=PATTERN")
    board = board_of(results, known["methods"] | methods, suite, tasks, against)
    print_board(board)
    if draw is not None:
        figure = extra("bsk_torch.viz.figures.profiles").performance_profiles
        figure(*board.profiles(), draw, f"Performance profiles, suite {suite}, {len(board.tasks)} tasks")
    if out is not None:
        write_file(out, json.dumps(document(board), indent=1) + "\n")


def separate(results: Mapping[str, Mapping[str, object]]) -> dict[str, list[str]]:
    """Return each policy that plays the most tasks as a method."""
    most = max((len(played) for played in results.values()), default=0)
    if left := [name for name, played in results.items() if len(played) < most]:
        print_message(f"left out, as others play more tasks: {', '.join(left)}; combine policies with --method NAME=PATTERN")
    return {name: [name] for name, played in results.items() if len(played) == most}


def methods_of(results: Mapping[str, Mapping[str, object]], given: Sequence[str]) -> dict[str, list[str]]:
    """Return the policies of each method: those that match its patterns NAME=PATTERN.

    Ends the program for other texts, and for patterns of no policy.
    """
    methods: dict[str, list[str]] = {}
    for text in given:
        name, sign, pattern = text.partition("=")
        if not sign or not name or not pattern:
            fail(f"--method {text!r} must be NAME=PATTERN, such as ppo='runs/ppo/seed_*'")
        found = [policy for policy in results if policy == pattern or fnmatchcase(policy, pattern)]
        if not found:
            fail(f"--method {text!r}: no policy has this name or matches it; {nearest(pattern.strip(MATCHING), results)}")
        methods[name] = list(dict.fromkeys((*methods.get(name, ()), *found)))
    return methods


def board_of(
    results: Mapping[str, Mapping[str, Any]],
    methods: Mapping[str, Sequence[str]],
    suite: str,
    wanted: Sequence[str],
    against: str | None,
) -> Board:
    """Return the methods in the ``wanted`` tasks that all of them play; ends the program without one, or for another ``against``.

    In each task, policies that played fewer episodes than another policy of a method, such as planners, are left out.
    """
    known = {policy for policies in methods.values() for policy in policies}
    rows = {task: {policy: results[policy][task] for policy in known if task in results[policy]} for task in wanted}
    for task, played in rows.items():
        most = max((len(row["returns"]) for row in played.values()), default=0)
        for policy in [policy for policy, row in played.items() if len(row["returns"]) < most]:
            print_message(f"{task}: {policy} played {len(played.pop(policy)['returns'])} of {most} episodes, and is left out")
    tasks = [task for task in wanted if all(any(policy in rows[task] for policy in mine) for mine in methods.values())]
    if not tasks:
        fail(f"no task is played by all of {', '.join(methods)}; combine policies of several presets with --method NAME=PATTERN")
    if left := [task for task in wanted if rows[task] and task not in tasks]:
        print_message(f"left out, as not all methods play them: {', '.join(left)}")
    if against is not None and against not in methods:
        fail(f"--against {against!r} is not a method; {nearest(against, methods)}")
    runs = {name: {task: scored(rows[task], mine, suite, task) for task in tasks} for name, mine in methods.items()}
    try:
        replicates = bootstrap(runs)
    except ValueError as error:
        fail(str(error))
    scores = {name: run_scores(one) for name, one in runs.items()}
    best = max(scores, key=lambda name: float(AGGREGATES["IQM"](scores[name])))
    flights = {
        name: flown([rows[task][one] for task in tasks for one in mine if one in rows[task]]) for name, mine in methods.items()
    }
    return Board(suite, scores, replicates, tasks, against or best, flights)


def scored(rows: Mapping[str, Mapping[str, Any]], policies: Sequence[str], suite: str, task: str) -> Tensor:
    """Return the scores of the episodes of those ``policies`` that play a task, [R, E]."""
    low, high = (references(suite)[task][end]["return"] for end in ("low", "high"))
    returns = torch.tensor([rows[policy]["returns"] for policy in policies if policy in rows], dtype=torch.float64)
    return (returns - low) / (high - low)


def flown(rows: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """Return how many episodes are the same on Basilisk, and how many were repeated there."""
    certified = [row["basilisk"] for row in rows if "basilisk" in row]
    return sum(one["same"] for one in certified), sum(len(one["returns"]) for one in certified)


def print_board(board: Board) -> None:
    """Print a row for each method, the best interquartile mean first."""
    measures = {name: board.measures(name) for name in board.scores}
    table, better = [], f"better than {board.against}"
    for name in sorted(measures, key=lambda name: -measures[name]["IQM"].value):
        same, repeated = board.flights[name]
        found = measures[name]
        table.append(
            {"method": name, "runs": str(len(board.scores[name]))}
            | {measure: told(found[measure]) for measure in AGGREGATES}
            | {better: told(found["better"]) if "better" in found else ""}
            | {"same on Basilisk": f"{same} of {repeated}" if repeated else ""}
        )
    title = f"suite {board.suite}, {len(board.tasks)} tasks: {', '.join(board.tasks)}"
    print_table(table, title, ("mean", "optimality gap", "same on Basilisk", better), left=("method",))
    print_message(
        "Brackets are 95 % intervals of a stratified bootstrap of runs and episodes; one run has those of its episodes."
    )


def told(found: Interval) -> str:
    """Return a value with its interval."""
    return f"{found.value:.3f} [{found.low:.3f}, {found.high:.3f}]"


def document(board: Board) -> dict[str, Any]:
    """Return the content of the JSON file."""
    methods = {
        name: {measure: found._asdict() for measure, found in board.measures(name).items()}
        | {"scores": scores.tolist(), "basilisk": dict(zip(("same", "episodes"), board.flights[name], strict=True))}
        for name, scores in board.scores.items()
    }
    return {"suite": board.suite, "tasks": list(board.tasks), "against": board.against, "methods": methods}
