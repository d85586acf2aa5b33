"""``bsk-torch export-aeosbench`` and ``import-aeosbench``: flights of cases of AEOS-Bench in the files of the benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bsk_torch.cli.declaration import EnvironmentOptions, JsonFile, Options, Policy, Trust, flag
from bsk_torch.cli.shared import check_writable, environment, preset_options
from bsk_torch.cli.terminal import activity, echo, refusing, working

if TYPE_CHECKING:
    from bsk_torch.env import ConstellationTasking
    from bsk_torch.tasks.aeos_bench.files import Cases

CasesFolder = Annotated[Path, flag("FOLDER", "Folder of the cases: constellations and tasks.")]
Sensor = Annotated[str, flag("NAME", "When sensors are on: 'assigned', while a task is assigned, or 'on', always.")]

PRESET = "AEOSBench-v1"

AT_ONCE = 16
"""Cases in flight at once."""


def bench(cases: Cases, sensor: str, options: dict[str, object]) -> ConstellationTasking:
    """Return an environment for the cases in their order; ends the program for a wrong option."""
    from bsk_torch.env import ConstellationTasking

    size = min(len(cases), AT_ONCE)
    settings = {"folder": cases, "order": "listed", "sensor": sensor, "env_ids": [0] * size} | options
    env = environment(PRESET, size, settings)
    assert isinstance(env, ConstellationTasking)
    return env


def export_aeosbench(
    policy: Policy,
    cases: CasesFolder,
    out: Annotated[Path, flag("FOLDER", "Folder for the files.")],
    split: Annotated[str, flag("NAME", "Part of the data set, for the names of the files.")] = "test",
    turn: Annotated[int, flag("E", "Round of annotation, for the names of the files.", "--round", min=0)] = 0,
    sensor: Sensor = "assigned",
    option: Options = None,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Fly cases of AEOS-Bench, and write trajectories and annotations for its own evaluator.

    Examples:
        bsk-torch export-aeosbench runs/bench --cases cases --out data
        bsk-torch export-aeosbench nearest_task --cases cases --out o --sensor on
    """
    from bsk_torch.cli.policies import named_policy
    from bsk_torch.tasks.aeos_bench.annotations import check_names, export_annotations, fly_cases
    from bsk_torch.tasks.aeos_bench.files import read_cases

    named = named_policy(policy, PRESET, trust)
    with refusing():
        scenarios = read_cases(cases)
        check_names(scenarios)  # before hours are spent
    env = bench(scenarios, sensor, named.options(preset_options(option) | options))
    actor = named.actor(env)
    with working(f"flying {policy}"):
        with refusing():
            flights = list(fly_cases(actor, env))
        written = export_annotations(flights, out, split, turn)
    activity.report()
    echo(f"{written[-1]}: {(len(written) - 1) // 2} cases")


def import_aeosbench(
    assignments: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder of trajectories (.pth) or assignment_runs.json of all cases.", show_default=False
        ),
    ],
    cases: CasesFolder,
    sensor: Sensor = "assigned",
    out: JsonFile = None,
    episodes_out: Annotated[Path | None, flag("FILE", "CSV file with a row for each case.")] = None,
    *,
    options: EnvironmentOptions,
) -> None:
    """Fly the assigned tasks in files of AEOS-Bench, and show the measures of the benchmark.

    Examples:
        bsk-torch import-aeosbench data --cases cases
        bsk-torch import-aeosbench flown --cases flown --sensor on
    """
    from bsk_torch.rl.evaluation.evaluate import evaluate
    from bsk_torch.rl.evaluation.results import print_results, save_episodes, save_results
    from bsk_torch.tasks.aeos_bench.annotations import AssignedTasks, read_assignments
    from bsk_torch.tasks.aeos_bench.files import read_cases

    check_writable(out, episodes_out)
    with refusing():
        scenarios = read_cases(cases)
        table = read_assignments(assignments, scenarios)
    env, name = bench(scenarios, sensor, options), assignments.as_posix()
    seeds = range(len(scenarios))
    with working(f"flying {name}"):
        results = {name: evaluate(AssignedTasks(env, table).module(), env, seeds=seeds)}
    activity.report()
    print_results(results, f"{PRESET}, {len(scenarios)} cases of {cases}")
    if out is not None:
        save_results(results, out, name)
    if episodes_out is not None:
        save_episodes(results, seeds, episodes_out)
