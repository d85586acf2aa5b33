"""``bsk-torch bench``: policies from any library in the fixed episodes of a suite."""

from __future__ import annotations

import json
import logging
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bsk_torch.cli.declaration import MachineOptions, Trust, flag
from bsk_torch.cli.shared import check_writable
from bsk_torch.cli.terminal import Failure, fail, print_message, refusing, working
from bsk_torch.files import write_file
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.cli.run_folder import Measure
    from bsk_torch.lab.commands.results import Played
    from bsk_torch.lab.suites.suite import Score, Task

logger = logging.getLogger(__name__)

FORMAT = 1
"""Version of the layout of the JSON file."""


class Failures(dict[str, dict[str, str]]):
    """Errors of policies by name and task; all other policies and tasks are still played."""

    @contextmanager
    def of(self, name: str, task: Task) -> Iterator[None]:
        """Print and keep the error that ends the block, whatever a library raises; an interrupt ends the program."""
        from bsk_torch.cli.policies import message_of

        try:
            yield
        except (Exception, SystemExit) as error:
            logger.debug("%s failed", name, exc_info=error)
            message = message_of(error)
            if not isinstance(error, Failure):  # whose message has been printed
                print_message(f"{name} failed in {task.title}: {message}")
            self.setdefault(name, {})[task.title] = message


def bench(
    policies: Annotated[
        list[str],
        typer.Argument(
            help="'pretrained'; a baseline, perhaps with a view of the presets such as survey,actions=waypoints; a policy file "
            "of any library, or a run folder; a planner with options such as plan:rollout,base=hasty,horizon=240; or your own "
            "function as package.module:function, perhaps with text arguments after commas.",
            show_default=False,
        ),
    ],
    suite: Annotated[str, flag("NAME", "Suite of fixed episodes.")] = "v1",
    presets: Annotated[str | None, flag("NAMES", "Only these presets or other tasks of the suite, separated by commas.")] = None,
    folder: Annotated[Path | None, flag("FOLDER", "Cases of AEOS-Bench, as another task of the suite aeosbench.")] = None,
    episodes: Annotated[
        int | None, flag("N", "Play the first N episodes of each task; default: all.", min=1, show_default=False)
    ] = None,
    earlier: Annotated[
        list[Path] | None, flag("FILE", "JSON file of an earlier run, to show its policies as well; repeatable.", "--with")
    ] = None,
    out: Annotated[Path | None, flag("FILE", "JSON file for results and returns of all episodes.")] = None,
    certify: Annotated[int, flag("N", "Repeat the first N episodes of each task on Basilisk, if it is installed.", min=0)] = 0,
    trust: Trust = False,
    *,
    options: MachineOptions,
) -> None:
    """Compare policies from any library in the fixed episodes of a suite.

    Scores are returns, scaled to 0 for random actions and 1 for the best rule, policy or planner of the package when the suite
    was created. Policies have no score for presets to which they do not apply. With --certify, the last column shows how many of
    the episodes repeated on Basilisk have the same decisions and outcome, and the largest difference of their returns.

    Examples:
        bsk-torch bench pretrained hasty --presets AEOS-v1 --episodes 64
        bsk-torch bench plan:rollout,base=hasty,horizon=240 --out results.json
        bsk-torch bench my_package.policies:enter
        bsk-torch bench hasty commit --suite v3 --presets sites
        bsk-torch bench nearest_task soonest_task --suite aeosbench
    """
    from bsk_torch.codegen.inductor import BACKENDS
    from bsk_torch.env.assembly.devices import existing_device
    from bsk_torch.lab.commands.entrants import entrant_of
    from bsk_torch.lab.commands.results import PlayedResults
    from bsk_torch.lab.suites.suite import bench_folder, play, references, tasks_of

    check_writable(out)
    if folder is not None and suite != "aeosbench":
        fail(f"--folder {folder} has cases of AEOS-Bench, but the suite is {suite}; choose --suite aeosbench")
    with refusing(ValueError, FileNotFoundError):
        tasks = tasks_of(suite, presets) + (() if folder is None else (bench_folder(folder),))
        existing_device(options["device"])
    if options["backend"] not in BACKENDS:
        fail(f"backend={options['backend']!r} must be one of {', '.join(BACKENDS)}")
    most = max(task.episodes for task in tasks)
    if episodes is not None and episodes > most:
        fail(f"--episodes {episodes} must be at most {most}, the number of episodes of each task")
    counts = {task.title: min(episodes or most, task.episodes) for task in tasks}
    certifiers = certifiers_of(tasks, certify, min(counts.values()))
    entrants = {name: entrant_of(name, tasks, trust) for name in policies}
    results = read_earlier(earlier or [], suite, PlayedResults)
    for name, rows in results.items():
        for task in tasks:
            unknown = set(task.measures) - set(rows[task.title].get("measures", ())) if task.title in rows else set()
            if unknown:
                fail(f"the results of {name!r} in {task.title} lack the measures {', '.join(sorted(unknown))}")
    for name in entrants:
        if repeats := [task.title for task in tasks if task.title in results.get(name, {})]:
            fail(f"{name!r} is also in the results of `--with`, for {', '.join(repeats)}; a task has one row for each policy")
    scale, failed = references(suite), Failures()
    try:
        for name, entrant in entrants.items():
            for task in tasks:
                with working(f"{name}: {task.title}"), failed.of(name, task):
                    score = play(task, entrant, counts[task.title], **options)
                    if score is None:
                        continue
                    row = results.setdefault(name, {})[task.title] = result_of(score, scale.get(task.title))
                    fly = certifiers.get(task.preset)
                    flight = None if fly is None else fly(task, entrant, certify, **options)
                    row |= {"library": entrant.library, "training": entrant.training(task.preset)}
                    row |= {} if flight is None else {"basilisk": flight.summary()}
                if out is not None:  # after each task, so that nothing is lost if the run is killed
                    content = document(suite, tasks, max(counts.values()), results) | ({"failed": failed} if failed else {})
                    write_file(out, json.dumps(content, indent=1) + "\n")
    finally:
        print_suite(results, tasks, suite, counts, failed)
    if idle := [name for name in entrants if name not in failed and not results.get(name, {}).keys() & counts.keys()]:
        fail(f"no preset among {', '.join(task.title for task in tasks)} fits {', '.join(idle)}")
    if failed:
        fail("failed: " + "; ".join(f"{name} in {', '.join(errors)}" for name, errors in failed.items()))


def certifiers_of(tasks: Sequence[Task], certify: int, episodes: int) -> dict[str, Callable[..., Any]]:
    """Return the functions that fly episodes again on Basilisk, by preset; none unless ``certify`` episodes are to be.

    Ends the program if that cannot be done, and names the presets for which it is not.
    """
    if not certify:
        return {}
    from bsk_torch.lab import basilisk
    from bsk_torch.lab.basilisk.aeos_certificate import BENCH, certify_bench

    certifiers = {**dict.fromkeys(basilisk.FLOWN, basilisk.certify), BENCH: certify_bench}
    candidates = [task for task in tasks if task.preset in certifiers]
    names = ", ".join(certifiers)
    if not candidates:
        fail(f"--certify {certify}: none of {', '.join(task.preset for task in tasks)} can be flown on Basilisk; {names} can")
    most = min(episodes, *(task.at_once for task in candidates))
    if certify > most:
        fail(f"--certify {certify} must be at most {most}, the number of episodes that are played side by side")
    if missing := basilisk.lacking():
        fail(f"--certify {certify}: {missing}")
    if warning := basilisk.absent_data(os.environ.get("BSK_SUPPORT_DATA_CACHE")):
        print_message(warning)
    if excluded := [task.preset for task in tasks if task not in candidates]:
        print_message(f"not flown on Basilisk, as only {names} can be: {', '.join(excluded)}")
    return certifiers


def result_of(score: Score, reference: Mapping[str, object] | None) -> dict[str, object]:
    """Return what a file says about a score; the score proper where the suite has a reference for the task."""
    from bsk_torch.lab.suites.suite import normalised

    evaluation = score.evaluation
    rated = {} if reference is None else {"score": asdict(normalised(evaluation, reference))}
    summary = {name: value for name, value in evaluation.summary().items() if name != "gain"}
    return rated | summary | {"seconds_per_decision": score.seconds, "returns": evaluation.returns.tolist()}


def read_earlier(files: Iterable[Path], suite: str, schema: object) -> dict[str, dict[str, Any]]:
    """Return the results of earlier runs, by policy and task; ends the program for those of another suite.

    Where a policy has played a task more than once, the result of the most episodes counts, and then that of the last file.
    """
    results: dict[str, dict[str, object]] = {}
    for path in files:
        header, policies = read_result(path, schema)
        if header != (FORMAT, suite):
            fail(f"{str(path)!r} has format and suite {header}; this run has {(FORMAT, suite)}")
        add_results(results, policies)
    return results


def add_results(results: dict[str, dict[str, Any]], policies: Mapping[str, Mapping[str, Any]]) -> None:
    """Add the results of ``policies`` by task to ``results``, in place, unless those there have more episodes."""
    for name, rows in policies.items():
        best = results.setdefault(name, {})
        best |= {task: row for task, row in rows.items() if task not in best or len(row["returns"]) >= len(best[task]["returns"])}


def read_result(path: Path, schema: Any) -> tuple[tuple[int, str], dict[str, dict[str, object]]]:
    """Return format and suite of a file of an earlier run, and its results by policy; ends the program for other files.

    The ``schema`` is one of :mod:`bsk_torch.lab.commands.results`.
    """
    from bsk_torch.untrusted import read_json

    with refusing(OSError, ValueError):
        content = read_json(path, schema, "is no result of bsk-torch bench")
    return (content["format"], content["suite"]), content["policies"]


def document(suite: str, tasks: Sequence[Task], episodes: int, results: Mapping[str, object]) -> dict[str, object]:
    """Return the content of the JSON file."""
    import torch

    from bsk_torch.lab.suites.suite import REMARKS

    about = {task.title: task.about for task in tasks if task.about}
    remarks = {"tasks": about, "remarks": REMARKS[suite]} if suite in REMARKS else {}
    return {
        "format": FORMAT,
        "suite": suite,
        "episodes": episodes,
        "bsk_torch": version("bsk_torch"),
        "torch": str(torch.__version__),
        "machine": platform.processor() or platform.machine(),
        "date": datetime.now(timezone.utc).date().isoformat(),
        **remarks,
        "policies": results,
    }


def print_suite(
    results: Mapping[str, Mapping[str, Played]],
    tasks: Sequence[Task],
    suite: str,
    counts: Mapping[str, int],
    failed: Mapping[str, Mapping[str, str]],
) -> None:
    """Print a table for each task: policies, the paired gain of the best over each, survival or measures, and computation."""
    from bsk_torch.lab.suites.suite import REMARKS

    for task in tasks:
        rows = {name: result[task.title] for name, result in results.items() if task.title in result}
        first = task.measures[0] if task.measures else "score"
        failures = [
            {"policy": name, first: "failed"} for name, errors in failed.items() if task.title in errors and name not in rows
        ]
        table = rows_of(rows, task) + failures
        if not table:
            continue
        gain = [name for name in table[0] if name.startswith("gain of ")]
        least = (*task.measures[1:], *gain) if task.measures else ("survival", "return")
        expendable = ("simulated s / decision", "ms / decision", *least, "same on Basilisk")
        title = f"{task.title}, suite {suite}, {counts[task.title]} of {task.episodes} episodes of each task"
        print_table(table, title, expendable, left=("policy",))
        if task.about:
            print_message(f"{task.title}: {task.about}.")
    if suite in REMARKS:
        print_message(REMARKS[suite])


def rows_of(rows: Mapping[str, Played], task: Task) -> list[dict[str, str]]:
    """Return the cells of the policies that have played a task by column, the best policy last but for planners ahead of it."""
    from bsk_torch.lab.suites.suite import ranking

    if not rows:
        return []
    best, gains = ranking({name: row["returns"] for name, row in rows.items()})
    most, table = len(rows[best]["returns"]), []
    for name, gain in gains.items():
        row, n = rows[name], len(rows[name]["returns"])
        label = name if n == most else f"{name} ({n} episodes)"
        behind = {f"gain of {best}": "" if name == best else f"{gain.mean:+.3f} ± {gain.half_width:.3f}"}
        figures = measure_cells(row, task, behind) if task.measures else score_cells(row, behind)
        table.append({"policy": label} | figures | {"same on Basilisk": on_basilisk(row)})
    return table


def measure_cells(row: Played, task: Task, behind: Mapping[str, str]) -> dict[str, str]:
    """Return the cells of a policy by column, with the measures of the task."""
    cells = {name: amount(row["measures"][name]) for name in task.measures}
    return cells | dict(behind) | {"ms / decision": f"{1e3 * row['seconds_per_decision']:.3f}"}


def amount(estimate: Measure) -> str:
    """Return a measure with its interval, in the digits that its size asks for."""
    size = abs(estimate["mean"])
    digits = 0 if size >= 100.0 else 2 if size >= 1.0 else 3
    return f"{estimate['mean']:,.{digits}f} ± {estimate['half_width']:,.{digits}f}"


def score_cells(row: Played, behind: Mapping[str, str]) -> dict[str, str]:
    """Return the cells of a policy by column, with its score."""
    simulated = row.get("simulated_per_decision")
    return {
        "score": "" if "score" not in row else "{mean:.3f} ± {half_width:.3f}".format(**row["score"]),
        "return": "{mean:.3f} ± {half_width:.3f}".format(**row["return"]),
        **behind,
        "survival": f"{row['survival']:.1%}",
        "ms / decision": f"{1e3 * row['seconds_per_decision']:.3f}",
        "simulated s / decision": "" if simulated is None else f"{simulated:,.0f}",
    }


def on_basilisk(row: Played) -> str:
    """Return how many episodes are the same on Basilisk, and the largest difference of their returns."""
    if "basilisk" not in row:
        return ""
    entry = row["basilisk"]
    mode = ", replayed" if entry["decided"] == "in bsk_torch" else ""
    return f"{entry['same']} of {len(entry['returns'])}{mode}, {entry['largest_difference']:.1g}"
