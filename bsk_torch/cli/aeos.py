"""``bsk-torch export-aeosbench`` and ``import-aeosbench``: flights of cases of AEOS-Bench in the files of the benchmark."""

from __future__ import annotations

from pathlib import Path

import torch

from bsk_torch.cli.policies import named_policy
from bsk_torch.cli.shared import check_writable, environment, environment_options, preset_options
from bsk_torch.cli.terminal import activity, echo, fail, working
from bsk_torch.env import ConstellationTasking
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.evaluation.results import print_results, save_episodes, save_results
from bsk_torch.tasks.aeos_bench import Cases, read_cases
from bsk_torch.tasks.aeos_bench.annotations import AssignedTasks, check_names, export_annotations, fly_cases, read_assignments

PRESET = "AEOSBench-v1"

AT_ONCE = 16
"""Cases in flight at once."""


def cases_of(folder: Path) -> Cases:
    """Return the cases of a folder; ends the program if it has none, or one that is wrong."""
    try:
        return read_cases(folder)
    except ValueError as error:
        fail(str(error))


def bench(cases: Cases, sensor: str, options: dict[str, object]) -> ConstellationTasking:
    """Return an environment for the cases in their order; ends the program for a wrong option."""
    size = min(len(cases), AT_ONCE)
    given = {"folder": cases, "order": "listed", "sensor": sensor, "env_ids": [0] * size} | options
    env = environment(PRESET, size, given)
    assert isinstance(env, ConstellationTasking)
    return env


def export_aeosbench(
    policy: str,
    cases: Path,
    out: Path,
    split: str,
    turn: int,
    sensor: str,
    option: list[str] | None,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Fly cases by a policy, and write the files; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    named, given = named_policy(policy, PRESET), cases_of(cases)
    try:
        check_names(given)  # before hours are spent
    except ValueError as error:
        fail(str(error))
    options = preset_options(option) | environment_options(backend, device, time_limit)
    env = bench(given, sensor, named.options(options))
    actor = named.actor(env, device)
    with working(f"flying {policy}"):
        try:
            flown = list(fly_cases(actor, env))
        except ValueError as error:
            fail(str(error))
        written = export_annotations(flown, out, split, turn)
    activity.report()
    echo(f"{written[-1]}: {(len(written) - 1) // 2} cases")


def import_aeosbench(
    assignments: Path,
    cases: Path,
    sensor: str,
    out: Path | None,
    episodes_out: Path | None,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Fly assigned tasks, and print measures; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    for path in (out, episodes_out):
        check_writable(path)
    given = cases_of(cases)
    try:
        table = read_assignments(assignments, given)
    except ValueError as error:
        fail(str(error))
    env, name = bench(given, sensor, environment_options(backend, device, time_limit)), assignments.as_posix()
    seeds = range(len(given))
    with working(f"flying {name}"):
        results = {name: evaluate(AssignedTasks(env, table).module(), env, seeds=seeds)}
    activity.report()
    print_results(results, f"{PRESET}, {len(given)} cases of {cases}")
    if out is not None:
        save_results(results, out, name)
    if episodes_out is not None:
        save_episodes(results, seeds, episodes_out)
