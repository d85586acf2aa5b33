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
from typing import Any

import torch

from bsk_torch.cli.functions import entrant_of_user, message_of
from bsk_torch.cli.names import PREFIX, PRETRAINED
from bsk_torch.cli.planned import named_planner
from bsk_torch.cli.policies import NamedFunction, NamedPolicy, named_policy
from bsk_torch.cli.results import PlayedResults
from bsk_torch.cli.shared import check_writable, preset_options
from bsk_torch.cli.terminal import Failure, fail, print_message, working
from bsk_torch.codegen.inductor import BACKENDS
from bsk_torch.env import Tasking
from bsk_torch.env.assembly.devices import existing_device
from bsk_torch.env.rollout import Policy
from bsk_torch.files import write_file
from bsk_torch.lab.basilisk import FLOWN, absent_data, lacking
from bsk_torch.lab.basilisk import certify as certified
from bsk_torch.lab.basilisk.aeos_certificate import BENCH, certify_bench
from bsk_torch.lab.suites.suite import (
    REMARKS,
    VIEWS,
    Entrant,
    Score,
    Task,
    bench_folder,
    normalised,
    play,
    ranking,
    references,
    tasks_of,
)
from bsk_torch.rl.policies.pretrained import makings
from bsk_torch.rl.policies.shared_policy import RULES, baseline, shared
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.tables import print_table
from bsk_torch.untrusted import read_json

logger = logging.getLogger(__name__)

CERTIFIERS = {**dict.fromkeys(FLOWN, certified), BENCH: certify_bench}
"""Functions that fly episodes again on Basilisk, by preset."""


FORMAT = 1
"""Version of the layout of the JSON file."""


class Failures(dict[str, dict[str, str]]):
    """Errors of policies by name and task; all other policies and tasks are still played."""

    @contextmanager
    def of(self, name: str, task: Task) -> Iterator[None]:
        """Print and keep the error that ends the block, whatever a library raises; an interrupt ends the program."""
        try:
            yield
        except (Exception, SystemExit) as error:
            logger.debug("%s failed", name, exc_info=error)
            message = message_of(error)
            if not isinstance(error, Failure):  # whose message has been printed
                print_message(f"{name} failed in {task.title}: {message}")
            self.setdefault(name, {})[task.title] = message


def bench(
    policies: list[str],
    suite: str,
    presets: str | None,
    folder: Path | None,
    episodes: int | None,
    earlier: list[Path] | None,
    out: Path | None,
    threads: int,
    backend: str,
    device: str,
    certify: int,
) -> None:
    """Compare policies in the fixed episodes of a suite; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    check_writable(out)
    try:
        tasks = chosen_tasks(suite, presets, folder)
        existing_device(device)
    except (ValueError, FileNotFoundError) as error:
        fail(str(error))
    if backend not in BACKENDS:
        fail(f"backend={backend!r} must be one of {', '.join(BACKENDS)}")
    most = max(task.episodes for task in tasks)
    if episodes is not None and episodes > most:
        fail(f"--episodes {episodes} must be at most {most}, the number of episodes of each task")
    counts = {task.title: min(episodes or most, task.episodes) for task in tasks}
    check_certifiable(tasks, certify, min(counts.values()))
    entrants = {name: entrant_of(name, tasks) for name in policies}
    results = read_earlier(earlier or [], suite, PlayedResults)
    for name, rows in results.items():
        for task in tasks:
            unknown = set(task.measures) - set(rows[task.title].get("measures", ())) if task.title in rows else set()
            if unknown:
                fail(f"the results of {name!r} in {task.title} lack the measures {', '.join(sorted(unknown))}")
    for name in entrants:
        if again := [task.title for task in tasks if task.title in results.get(name, {})]:
            fail(f"{name!r} is also in the results of `--with`, for {', '.join(again)}; a task has one row for each policy")
    known, failed = references(suite), Failures()
    try:
        for name, entrant in entrants.items():
            for task in tasks:
                with working(f"{name}: {task.title}"), failed.of(name, task):
                    score = play(task, entrant, counts[task.title], backend=backend, device=device)
                    if score is None:
                        continue
                    row = results.setdefault(name, {})[task.title] = told(score, known.get(task.title))
                    fly = CERTIFIERS.get(task.preset) if certify else None
                    flown = None if fly is None else fly(task, entrant, certify, backend=backend, device=device)
                    row |= {} if flown is None else {"basilisk": flown.summary()}
                if out is not None:  # after each task, so that nothing is lost if the run is killed
                    content = document(suite, tasks, max(counts.values()), results) | ({"failed": failed} if failed else {})
                    write_file(out, json.dumps(content, indent=1) + "\n")
    finally:
        print_suite(results, tasks, suite, counts, failed)
    if idle := [name for name in entrants if name not in failed and not results.get(name, {}).keys() & counts.keys()]:
        fail(f"no preset among {', '.join(task.title for task in tasks)} fits {', '.join(idle)}")
    if failed:
        fail("failed: " + "; ".join(f"{name} in {', '.join(errors)}" for name, errors in failed.items()))


def chosen_tasks(suite: str, presets: str | None, folder: Path | None) -> tuple[Task, ...]:
    """Return the tasks of a suite that are played, and that of a folder; ValueError where the suite has no folders."""
    tasks = tasks_of(suite, presets)
    if folder is None:
        return tasks
    if suite != "aeosbench":
        raise ValueError(f"--folder {folder} has cases of AEOS-Bench, but the suite is {suite}; choose --suite aeosbench")
    return (*tasks, bench_folder(folder))


def check_certifiable(tasks: Sequence[Task], certify: int, episodes: int) -> None:
    """End the program if episodes cannot be flown on Basilisk; name the presets that will not be."""
    if not certify:
        return
    flown = [task for task in tasks if task.preset in CERTIFIERS]
    names = ", ".join(CERTIFIERS)
    if not flown:
        fail(f"--certify {certify}: none of {', '.join(task.preset for task in tasks)} can be flown on Basilisk; {names} can")
    most = min(episodes, *(task.at_once for task in flown))
    if certify > most:
        fail(f"--certify {certify} must be at most {most}, the number of episodes that are played side by side")
    if missing := lacking():
        fail(f"--certify {certify}: {missing}")
    if warning := absent_data(os.environ.get("BSK_SUPPORT_DATA_CACHE")):
        print_message(warning)
    if left := [task.preset for task in tasks if task not in flown]:
        print_message(f"not flown on Basilisk, as only {names} can be: {', '.join(left)}")


def entrant_of(name: str, tasks: Sequence[Task] = ()) -> Entrant:
    """Return what enters the policy that the command line names in ``tasks``; ends the program if there is none."""
    allowed = tuple(dict.fromkeys(view for task in tasks for view in task.views)) or VIEWS
    drawn = tuple(dict.fromkeys(option for task in tasks for option in task.drawn)) or ("time_limit",)
    if name == PRETRAINED:
        return lambda preset, make: entered(named_policy(name, preset), make, drawn) if preset in makings() else None
    plain, *views = name.split(",")
    if plain.startswith(PREFIX):
        seen = [text for text in views if text.partition("=")[0] in allowed]
        options = [text for text in views if text not in seen]
        named_planner(plain, None, options)  # unknown names and options end the program before anything runs
        chosen = dict(view_of(text, allowed) for text in seen)
        return lambda preset, make: planned(plain, options, chosen, preset, make)
    if plain in RULES:
        usual = {view: value for task in tasks for view, value in task.rules.get(plain, {}).items()}
        given = usual | dict(view_of(view, allowed) for view in views)
        return lambda preset, make: rule(plain, given, make)
    if ":" in plain and not Path(name).exists():
        return entrant_of_user(plain, views)
    policy = named_policy(name, None)
    return lambda preset, make: entered(policy, make, drawn) if preset == policy.preset else None


def entered(policy: NamedPolicy | NamedFunction, make: Callable[..., Tasking], drawn: Sequence[str]) -> tuple[Tasking, Policy]:
    """Enter a policy of a file, in an environment with the views that it was trained with; see :func:`views_of`.

    The program ends in tasks with other observations or actions than those of its training.
    """
    env = make(**views_of(policy, drawn))
    return env, policy.actor(env, str(env.device))


def views_of(policy: NamedPolicy | NamedFunction, drawn: Sequence[str] = ("time_limit",)) -> dict[str, Any]:
    """Return the options of a policy's training, without those named in ``drawn``, such as the length of its episodes."""
    return {name: value for name, value in policy.card.get("options", {}).items() if name not in drawn}


def rule(name: str, views: Mapping[str, object], make: Callable[..., Tasking]) -> tuple[Tasking, Policy] | None:
    """Enter a baseline; None where the preset has no such view, or the baseline is for other observations or actions."""
    try:
        env = make(**views)
    except TypeError:  # no such option
        return None
    try:
        return env, shared(baseline(name, env), env)
    except (KeyError, ValueError):
        return None


def planned(
    name: str, options: list[str], views: Mapping[str, object], preset: str, make: Callable[..., Tasking]
) -> tuple[Tasking, Policy]:
    """Enter a planner, in an environment with ``views`` and those of its base; ends the program where it does not fit."""
    chosen = named_planner(name, preset, options)
    of_base = {} if chosen.base is None else views_of(chosen.base)
    env = make(**(of_base | dict(views)))
    return env, chosen.actor(env, str(env.device))


def view_of(text: str, allowed: Sequence[str]) -> tuple[str, Any]:
    """Return name and value of ``NAME=VALUE``; ends the program for other texts and names."""
    name, sign, _ = text.partition("=")
    if not sign or name not in allowed:
        fail(f"{text!r} must be NAME=VALUE with a NAME among {', '.join(allowed)}; {nearest(name, allowed)}")
    return name, preset_options([text])[name]


def told(score: Score, reference: Mapping[str, object] | None) -> dict[str, Any]:
    """Return what a file says about a score; the score proper where the suite has a reference for the task."""
    evaluation = score.evaluation
    rated = {} if reference is None else {"score": asdict(normalised(evaluation, reference))}
    summary = {name: value for name, value in evaluation.summary().items() if name != "gain"}
    return rated | summary | {"seconds_per_decision": score.seconds, "returns": evaluation.returns.tolist()}


def read_earlier(files: Iterable[Path], suite: str, schema: Any) -> dict[str, dict[str, Any]]:
    """Return the results of earlier runs, by policy and task; ends the program for those of another suite.

    Where a policy has played a task more than once, the result of the most episodes counts, and then that of the last file.
    """
    results: dict[str, dict[str, Any]] = {}
    for path in files:
        made, policies = read_result(path, schema)
        if made != (FORMAT, suite):
            fail(f"{str(path)!r} has format and suite {made}; this run has {(FORMAT, suite)}")
        add_results(results, policies)
    return results


def add_results(results: dict[str, dict[str, Any]], policies: Mapping[str, Mapping[str, Any]]) -> None:
    """Add the results of ``policies`` by task to ``results``, in place, unless those there have more episodes."""
    for name, rows in policies.items():
        known = results.setdefault(name, {})
        known |= {
            task: row for task, row in rows.items() if task not in known or len(row["returns"]) >= len(known[task]["returns"])
        }


def read_result(path: Path, schema: Any) -> tuple[tuple[int, str], dict[str, dict[str, Any]]]:
    """Return format and suite of a file of an earlier run, and its results by policy; ends the program for other files.

    The ``schema`` is one of :mod:`bsk_torch.cli.results`.
    """
    try:
        kept = read_json(path, schema, "is no result of bsk-torch bench")
    except (OSError, ValueError) as error:
        fail(str(error))
    return (kept["format"], kept["suite"]), kept["policies"]


def document(suite: str, tasks: Sequence[Task], episodes: int, results: Mapping[str, object]) -> dict[str, Any]:
    """Return the content of the JSON file."""
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
    results: Mapping[str, Mapping[str, Any]],
    tasks: Sequence[Task],
    suite: str,
    counts: Mapping[str, int],
    failed: Mapping[str, Mapping[str, str]],
) -> None:
    """Print a table for each task: policies, the paired gain of the best over each, survival or measures, and computation."""
    for task in tasks:
        rows = {name: result[task.title] for name, result in results.items() if task.title in result}
        first = task.measures[0] if task.measures else "score"
        lost = [{"policy": name, first: "failed"} for name, errors in failed.items() if task.title in errors and name not in rows]
        table = played(rows, task) + lost
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


def played(rows: Mapping[str, Mapping[str, Any]], task: Task) -> list[dict[str, str]]:
    """Return the cells of the policies that have played a task by column, the best policy last but for planners ahead of it."""
    if not rows:
        return []
    best, gains = ranking({name: row["returns"] for name, row in rows.items()})
    most, table = len(rows[best]["returns"]), []
    for name, gain in gains.items():
        row, n = rows[name], len(rows[name]["returns"])
        label = name if n == most else f"{name} ({n} episodes)"
        behind = {f"gain of {best}": "" if name == best else f"{gain.mean:+.3f} ± {gain.half_width:.3f}"}
        scored = measured(row, task, behind) if task.measures else cells(row, behind)
        table.append({"policy": label} | scored | {"same on Basilisk": on_basilisk(row)})
    return table


def measured(row: Mapping[str, Any], task: Task, behind: Mapping[str, str]) -> dict[str, str]:
    """Return the cells of a policy by column, with the measures of the task."""
    cells = {name: amount(row["measures"][name]) for name in task.measures}
    return cells | dict(behind) | {"ms / decision": f"{1e3 * row['seconds_per_decision']:.3f}"}


def amount(estimate: Mapping[str, float]) -> str:
    """Return a measure with its interval, in the digits that its size asks for."""
    size = abs(estimate["mean"])
    digits = 0 if size >= 100.0 else 2 if size >= 1.0 else 3
    return f"{estimate['mean']:,.{digits}f} ± {estimate['half_width']:,.{digits}f}"


def cells(row: Mapping[str, Any], behind: Mapping[str, str]) -> dict[str, str]:
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


def on_basilisk(row: Mapping[str, Any]) -> str:
    """Return how many episodes are the same on Basilisk, and the largest difference of their returns."""
    if "basilisk" not in row:
        return ""
    flown = row["basilisk"]
    how = ", replayed" if flown["decided"] == "in bsk_torch" else ""
    return f"{flown['same']} of {len(flown['returns'])}{how}, {flown['largest_difference']:.1g}"
