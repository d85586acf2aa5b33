"""``bsk-torch leaderboard``: methods in all tasks of a suite, from files of ``bsk-torch bench``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bsk_torch.cli.declaration import JsonFile, flag
from bsk_torch.cli.shared import check_writable, drawing
from bsk_torch.cli.terminal import fail, print_message, refusing, working
from bsk_torch.files import write_file
from bsk_torch.lab.commands.bench import add_results, read_earlier, read_result
from bsk_torch.sim.names import nearest
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.lab.commands.board import Board
    from bsk_torch.lab.suites.aggregates import Interval

MATCHING = "*?["
"""Characters of patterns, which a policy may have in its name."""


def leaderboard(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FILE...",
            help="JSON files of bsk-torch bench. If a policy played a task repeatedly, the result of the most episodes counts; "
            "among equals, the result in the last file.",
            show_default=False,
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=PATTERN",
            help="Policies whose names match PATTERN are runs of the method NAME, which needs equally many in each task; "
            "repeatable, also for the same method. Default: each policy is a method.",
            show_default=False,
        ),
    ] = None,
    presets: Annotated[str | None, flag("NAMES", "Only these presets or other tasks of the suite, separated by commas.")] = None,
    against: Annotated[str | None, flag("NAME", "Method with which the others are compared; default: the best.")] = None,
    published_suite: Annotated[
        str | None, flag("SUITE", "Also compare with the methods published for the suite, such as v3.", "--published")
    ] = None,
    draw: Annotated[Path | None, flag("FILE", "Picture (.png, .svg, .pdf) of the performance profiles.")] = None,
    out: JsonFile = None,
) -> None:
    """Compare methods in all tasks of a suite, with the aggregates of Agarwal et al. (2021).

    The interquartile mean (IQM) is the mean of the middle half of the scores of all runs and tasks, where tasks have families of
    each family; the optimality gap is how far scores are below 1 on average. "better than" is the probability that a run scores
    higher than a run of the other method. Published methods that lack some of the tasks have a further table of those they play.

    Examples:
        bsk-torch leaderboard bench.json --draw profiles.png
        bsk-torch leaderboard bench.json --published v3
        bsk-torch leaderboard a.json b.json --method 'ppo=runs/ppo*/seed_*'
    """
    with working("starting"):
        from bsk_torch.lab.commands.board import board_of
        from bsk_torch.lab.commands.results import Results, Returns
        from bsk_torch.lab.suites.suite import published, references, tasks_of

    figure = drawing(draw, "bsk_torch.viz.figures.curves")
    check_writable(out)
    files = files or []
    if published_suite is None and not files:
        fail("no results: name a file of bsk-torch bench, or a suite with --published")
    suite = published_suite or read_result(files[0], Results)[0][1]
    with refusing():
        tasks = {task.title: task.family for task in tasks_of(suite, presets)}
        reference = published(suite) if published_suite else {"policies": {}, "methods": {}}
    if not references(suite):
        fail(f"the suite {suite} has no references, so that its results have no scores that could be aggregated")
    entries, results = read_earlier(files, suite, Results), dict[str, dict[str, Returns]]()
    if files and not entries:
        fail(f"{', '.join(map(str, files))} has no policies")
    add_results(results, reference["policies"])
    add_results(results, entries)
    methods = methods_of(results, method) if method else separate(entries)
    if duplicates := [name for name in methods if name in reference["methods"]]:
        fail(f"{duplicates[0]!r} is a method of the published results; use another name in --method NAME=PATTERN")
    (_, group), *fewer = groups_of(results, reference["methods"], methods, tasks).items()
    board = board_of(results, group, suite, tasks, against)
    parts = [board_of(results, some, suite, {task: tasks[task] for task in played}, against) for played, some in fewer]
    for one in (board, *parts):
        print_board(one)
    print_message(
        "Brackets are 95 % intervals of a stratified bootstrap of runs and episodes, and of the references where these have "
        "intervals; one run has those of its episodes. Decisions, core-seconds and tuning runs are the most of a training."
    )
    if draw is not None:
        figure.performance_profiles(*board.profiles(), draw, f"Performance profiles, suite {suite}, {len(board.tasks)} tasks")
    if out is not None:
        write_file(out, json.dumps(document(board) | {"parts": [document(one) for one in parts]}, indent=1) + "\n")


def separate(results: Mapping[str, Mapping[str, object]]) -> dict[str, list[str]]:
    """Return each policy that plays the most tasks as a method."""
    most = max((len(played) for played in results.values()), default=0)
    if fewer := [name for name, played in results.items() if len(played) < most]:
        print_message(f"left out, as others play more tasks: {', '.join(fewer)}; combine policies with --method NAME=PATTERN")
    return {name: [name] for name, played in results.items() if len(played) == most}


def methods_of(results: Mapping[str, Mapping[str, object]], texts: Sequence[str]) -> dict[str, list[str]]:
    """Return the policies of each method: those that match its patterns NAME=PATTERN.

    Ends the program for other texts, and for patterns of no policy.
    """
    methods: dict[str, list[str]] = {}
    for text in texts:
        name, sign, pattern = text.partition("=")
        if not sign or not name or not pattern:
            fail(f"--method {text!r} must be NAME=PATTERN, such as ppo='runs/ppo/seed_*'")
        matches = [policy for policy in results if policy == pattern or fnmatchcase(policy, pattern)]
        if not matches:
            fail(f"--method {text!r}: no policy has this name or matches it; {nearest(pattern.strip(MATCHING), results)}")
        methods[name] = list(dict.fromkeys((*methods.get(name, ()), *matches)))
    return methods


def groups_of(
    results: Mapping[str, Mapping[str, object]],
    published: Mapping[str, list[str]],
    methods: Mapping[str, list[str]],
    titles: Iterable[str],
) -> dict[tuple[str, ...], dict[str, list[str]]]:
    """Return the methods that play all of some tasks, by these tasks.

    The first tasks are those that all ``methods`` play, or without any, that the most versatile of the ``published`` ones plays.
    Fewer of them follow for published methods that lack some.
    """
    everyone = {**published, **methods}
    plays = {name: {task for policy in group for task in results[policy]} for name, group in everyone.items()}
    common = set.intersection(*(plays[name] for name in methods)) if methods else max(plays.values(), key=len)
    whole = tuple(task for task in titles if task in common)
    fewer = {tuple(task for task in whole if task in plays[name]) for name in published} - {()}
    return {
        tasks: {name: group for name, group in everyone.items() if plays[name].issuperset(tasks)}
        for tasks in dict.fromkeys((whole, *sorted(fewer, key=lambda tasks: (-len(tasks), tasks))))
    }


def print_board(board: Board) -> None:
    """Print a row for each method, the best interquartile mean first, or the best mean of those of families."""
    from bsk_torch.lab.commands.board import ranked

    table, better = [], f"better than {board.against}"
    for name in ranked(board.scores, board.families):
        equal, repeated = board.flights[name]
        cells = {measure: interval_text(value) for measure, value in board.measures(name).items()}
        compared = {better: cells.pop("better", "")}
        table.append(
            {"method": name, "runs": str(len(board.scores[name]))}
            | cells
            | compared
            | budget_cells(board.budgets[name])
            | {"same on Basilisk": f"{equal} of {repeated}" if repeated else "", "library": ", ".join(board.libraries[name])}
        )
    title = f"suite {board.suite}, {len(board.tasks)} task{'s' * (len(board.tasks) > 1)}: {', '.join(board.tasks)}"
    expendable = ("library", "tuning runs", "mean", "optimality gap", "same on Basilisk", "core-s", better, "decisions")
    print_table(table, title, expendable, left=("method", "library", "track"))


def budget_cells(budget: Mapping[str, Any] | None) -> dict[str, str]:
    """Return the cells of what the trainings of a method have cost; see :func:`~bsk_torch.lab.commands.board.budget_of`."""
    if budget is None:
        return {"track": "no record"}
    runs = budget["tuning_runs"]
    return {
        "track": budget["track"],
        "decisions": f"{budget['decisions']:,}",
        "core-s": f"{budget['core_seconds']:,.0f}",
        "tuning runs": "no record" if runs is None else f"{runs:,}",
    }


def interval_text(interval: Interval) -> str:
    """Return a value with its interval."""
    return f"{interval.value:.3f} [{interval.low:.3f}, {interval.high:.3f}]"


def document(board: Board) -> dict[str, object]:
    """Return the content of the JSON file."""
    methods: dict[str, dict[str, object]] = {}
    for name, scores in board.scores.items():
        measures: dict[str, Any] = {measure: interval._asdict() for measure, interval in board.measures(name).items()}
        if "" not in board.families:
            measures["families"] = {family: measures.pop(f"IQM {family}") for family in board.families}
            measures["tasks"] = {task: board.over(name, "mean", [k])._asdict() for k, task in enumerate(board.tasks)}
        methods[name] = {
            **measures,
            "library": board.libraries[name],
            "training": board.budgets[name],
            "scores": scores.tolist(),
            "basilisk": dict(zip(("same", "episodes"), board.flights[name], strict=True)),
        }
    return {"suite": board.suite, "tasks": list(board.tasks), "against": board.against, "methods": methods}
