"""Assignments of AEOS-Bench in its files: trajectories for its own evaluator, and flights of such files.

A trajectory is two files, ``trajectories.E/SPLIT/AA/BBBBB.pth`` and ``.json``, of the case BBBBB, its thousands AA and the round
E: tensors at every second, and measures. ``annotations/SPLIT.json`` lists the numbers of cases, and their rounds.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import torch
from annotated_types import Interval
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.constants import RPM
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.base import Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.files import write_file
from bsk_torch.rl.evaluation.evaluate import start_episodes, with_lots
from bsk_torch.rl.rules.baselines import TeamPolicy
from bsk_torch.tasks.aeos_bench.files import Cases
from bsk_torch.tasks.aeos_bench.preset import aeos_bench
from bsk_torch.tasks.aeos_bench.rules import TaskTeam, task_team
from bsk_torch.tasks.aeos_bench.scene import NO_TASK
from bsk_torch.untrusted import MOST_JSON, parse_json, read_bytes, read_tensors

__all__ = [
    "AssignedTasks",
    "Trajectory",
    "assigned_tasks",
    "export_annotations",
    "fly_cases",
    "read_assignments",
    "replaying",
]

TASK_ID, ENABLED, DATA, PROGRESS, VISIBLE = (
    "actions.task_id",
    "constellation.sensor_enabled",
    "constellation.data",
    "taskset.progress",
    "is_visible",
)
"""Tensors of a trajectory at t seconds: assigned tasks, -1 for none, and sensors that are on, [t, S]; charge as a fraction,
speeds of wheels, rpm, true anomaly, degrees, and attitude (MRP), [t, S, 8]; progress, [t, T]; visible tasks, [t, S, T], also
in the second of their success."""

RUNS = "assignment_runs.json"
"""File of runs ``[task, seconds]`` of each satellite, in a folder with the name of the case."""

LARGEST = 100_000
"""Numbers of cases are below."""

LONGEST = 1_000_000
"""Longest assignments in a file of runs, s."""


class Trajectory(NamedTuple):
    """A flight of a case.

    Attributes:
        name: Name of the case.
        tensors: See :data:`TASK_ID`.
        measures: See :func:`bsk_torch.tasks.aeos_bench.reward.task_measures`.
    """

    name: str
    tensors: Mapping[str, Tensor]
    measures: Mapping[str, float]


# -- export ---------------------------------------------------------------------------------------------------------------------


def cases_of(env: Tasking) -> tuple[TaskTeam, Cases]:
    """Return the team of an environment and its cases; ValueError unless it flies listed cases."""
    view = task_team(env)
    cases = view.scenario.cases
    if not isinstance(cases, Cases) or view.scenario.order != "listed":
        raise ValueError("annotations are of listed cases; make AEOSBench-v1 with folder=... and order='listed'")
    return view, cases


def check_names(cases: Cases) -> None:
    """ValueError unless the names of all cases are numbers below 100,000, by which the benchmark names its files."""
    for name in cases.names:
        _number(name)


def assigned_tasks(policy: TensorDictModuleBase, env: ConstellationTasking, start: TensorDictBase, rows: Tensor) -> Tensor:
    """Play the episodes ``rows`` [N] from ``start`` to their ends, and return the assigned tasks in each second, [N, t, S].

    Choices may hold for any number of seconds, and be among candidates.
    """
    player = with_lots(policy, env)
    scenario, before = task_team(env).scenario, env.fleet.ticks.clone()
    tick = torch.arange(int(env.time_limit.max() / env.fleet.h), device=env.device)
    table = torch.full((*env.batch_size, len(tick), env.fleet.shape[1]), NO_TASK, device=env.device)
    for playing, _ in play_episodes(env, player, start, rows):
        after, span = env.fleet.ticks, slice(int(before[playing].min()), int(env.fleet.ticks[playing].max()))
        ran = (tick[span] >= before.unsqueeze(1)) & (tick[span] < after.unsqueeze(1))
        table[:, span] = torch.where(ran.unsqueeze(2), scenario.held_task.unsqueeze(1), table[:, span])
        before = after.clone()
    return table


def replaying(env: ConstellationTasking, cases: Cases, num_envs: int) -> ConstellationTasking:
    """Return an environment of ``cases`` with a choice in every second, and sensors and length of episodes as in ``env``.

    ValueError where sensors do not follow from the tasks, so that a replay would be another flight.
    """
    sensor = task_team(env).entry.sensor
    if sensor == "chosen":
        raise ValueError("flights with sensor='chosen' are not told by their tasks; choose 'assigned' or 'on'")
    (limit,) = env.time_limit.unique().tolist()
    like: dict[str, Any] = {name: getattr(env.options, name) for name in ("backend", "device", "dtype")}
    one = dict(num_envs=num_envs, env_ids=[0] * num_envs, time_limit=limit)
    return aeos_bench(cases, order="listed", sensor=sensor, **like, **one)


def fly_cases(policy: TensorDictModuleBase, env: ConstellationTasking) -> Iterator[Trajectory]:
    """Fly every case of an environment once by a policy of all its satellites, and yield the trajectories, in the order of cases.

    Flights whose choices hold for longer than a second, or are among candidates, are flown again with the tasks of each second.
    ValueError for an environment without listed cases, and for such flights with ``sensor="chosen"``.
    """
    view, cases = cases_of(env)
    if view.entry.duration is not None or view.entry.n_candidates is not None:
        parts, size = [], env.batch_size[0]
        for first in range(0, len(cases), size):
            seeds = range(first, min(first + size, len(cases)))
            flying = torch.arange(size, device=env.device) < len(seeds)
            parts.append(assigned_tasks(policy, env, start_episodes(env, seeds), flying)[flying])
        twin = replaying(env, cases, size)
        yield from fly_cases(AssignedTasks(twin, torch.cat(parts)).module(), twin)
        return
    scenario, n = view.scenario, env.batch_size[0]
    for first in range(0, len(cases), n):
        seeds = range(first, min(first + n, len(cases)))
        start = start_episodes(env, seeds)
        rows: list[dict[str, Tensor]] = []
        sights: list[Tensor] = []
        present, visible = _present_of(view), scenario.task_visible(scenario.task_offered)
        for _ in play_episodes(env, policy, start, torch.arange(n, device=env.device) < len(seeds)):
            sights.append(torch.stack([torch.full_like(visible[0], len(rows)), *visible]))
            rows.append(present | {TASK_ID: scenario.held_task.clone()})
            present, visible = _present_of(view), scenario.task_visible(scenario.task_offered)
        tables = {name: torch.stack([row[name] for row in rows], 1) for name in rows[0]}
        second, episode, satellite, task = torch.cat(sights, 1)
        measures = env.rewarder.measures()
        for k, case in enumerate(seeds):
            crew, jobs = int(cases.present[case].sum()), int((cases.tasks["duration"][case] > 0.0).sum())
            tensors = {name: table[k, :, : jobs if name == PROGRESS else crew].clone() for name, table in tables.items()}
            mask = episode == k
            tensors[VISIBLE] = torch.zeros(len(rows), crew, jobs, dtype=torch.bool)
            tensors[VISIBLE][second[mask], satellite[mask], task[mask]] = True
            yield Trajectory(cases.names[case], tensors, {name: float(value[k]) for name, value in measures.items()})


def _present_of(view: TaskTeam) -> dict[str, Tensor]:
    scenario, shape, dynamics = view.scenario, view.scenario.fleet.shape, view.satellite.dynamics
    numbers = (
        dynamics.battery_charge_fraction.unsqueeze(-1),
        dynamics.wheel_speeds / RPM,
        torch.rad2deg(dynamics.true_anomaly).unsqueeze(-1),
        dynamics.sigma_BN,
    )
    return {
        ENABLED: scenario.sensor_on,
        DATA: torch.cat(numbers, -1).view(*shape, -1).float(),
        PROGRESS: scenario.memory["task_progress"].to(torch.uint8),
    }


def export_annotations(flown: Sequence[Trajectory], folder: Path, split: str = "test", turn: int = 0) -> list[Path]:
    """Write trajectories and the list of them.

    Args:
        flown: The trajectories.
        folder: Folder of the data set, which is made if needed.
        split: Part of the data set.
        turn: Round E that the files are named after.

    Returns:
        The files.

    Raises:
        ValueError: For a case whose name is not a number below 100,000.
    """
    numbers = [_number(one.name) for one in flown]
    paths = []
    for number, one in zip(numbers, flown, strict=True):
        stem = folder / f"trajectories.{turn}" / split / f"{number // 1000:02d}" / f"{number:05d}"
        stem.parent.mkdir(parents=True, exist_ok=True)
        buffer = io.BytesIO()
        torch.save(dict(one.tensors), buffer)
        write_file(stem.with_suffix(".pth"), buffer.getvalue())
        measures = {name: None if math.isnan(value) else value for name, value in one.measures.items()}
        write_file(stem.with_suffix(".json"), json.dumps(measures, indent=1) + "\n")
        paths += [stem.with_suffix(".pth"), stem.with_suffix(".json")]
    index = folder / "annotations" / f"{split}.json"
    index.parent.mkdir(parents=True, exist_ok=True)
    write_file(index, json.dumps({"ids": numbers, "epochs": [turn] * len(numbers)}) + "\n")
    return [*paths, index]


def _number(name: str) -> int:
    if not name.isdecimal() or int(name) >= LARGEST:
        raise ValueError(f"case {name!r}: the benchmark names cases by numbers below {LARGEST:,}, such as '00006'")
    return int(name)


# -- import ---------------------------------------------------------------------------------------------------------------------


def read_assignments(folder: str | Path, cases: Cases) -> Tensor:
    """Return the assigned tasks of all cases at every second, [C, t, S] int64; -1 for none, and where there are no satellites.

    Args:
        folder: Folder with a trajectory (``.pth``) or runs (``NAME/assignment_runs.json``) of each case, in subfolders.
        cases: The cases.

    Raises:
        FileNotFoundError: For a case without assignments.
        ValueError: For assignments that do not fit the case: other satellites, or tasks that it does not have.
    """
    files = {path.stem: path for path in sorted(Path(folder).rglob("*.pth"))}
    files |= {path.parent.name: path for path in sorted(Path(folder).rglob(RUNS))}
    tables = []
    for k, name in enumerate(cases.names):
        if name not in files:
            raise FileNotFoundError(f"{folder}: no {name}.pth and no {name}/{RUNS}")
        crew, jobs = int(cases.present[k].sum()), int((cases.tasks["duration"][k] > 0.0).sum())
        runs = [] if files[name].suffix == ".pth" else _runs(files[name])
        table = torch.empty(0, len(runs), dtype=torch.float64) if runs else _trajectory(files[name])
        if table.shape[1] != crew:
            raise ValueError(f"{files[name]}: assignments of {table.shape[1]} satellites, but case {name!r} has {crew}")
        if runs:
            table = torch.stack([tasks.repeat_interleave(seconds) for tasks, seconds in (run.unbind(1) for run in runs)], 1)
        if bool(((table < NO_TASK) | (table >= jobs)).any()):
            raise ValueError(f"{files[name]}: tasks from {int(table.min())} to {int(table.max())}, but case {name!r} has {jobs}")
        tables.append(table)
    longest = max(len(table) for table in tables)
    assignments = torch.full((len(tables), longest, cases.n_satellites), NO_TASK)
    for k, table in enumerate(tables):
        assignments[k, : len(table), : table.shape[1]] = table
    return assignments


def _trajectory(path: Path) -> Tensor:
    try:
        values, _ = read_tensors(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path}: no trajectory: {error}") from None
    table = values.get(TASK_ID) if isinstance(values, dict) else None
    if not isinstance(table, Tensor) or table.ndim != 2 or table.is_floating_point() or table.is_complex() or not len(table):
        raise ValueError(f"{path}: a trajectory needs whole numbers {TASK_ID!r}, [t, S]")
    return table.long()


Runs = dict[str, list[tuple[Annotated[int, Interval(ge=NO_TASK, lt=2**31)], Annotated[int, Interval(ge=1, le=LONGEST)]]]]
"""Content of :data:`RUNS`: runs ``[task, seconds]`` by the number of the satellite."""


def _runs(path: Path) -> list[Tensor]:
    """Return the runs of each satellite of a file, [runs, 2]: tasks and their seconds."""
    try:
        content = parse_json(read_bytes(path, MOST_JSON), Runs)
        rows = [torch.tensor(content[str(k)]).view(-1, 2) for k in range(len(content))]
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path}: runs are lists of [task, seconds] by the number of the satellite: {error}") from None
    seconds = sorted({int(row[:, 1].sum()) for row in rows})
    if len(seconds) != 1 or not 0 < seconds[0] <= LONGEST:
        raise ValueError(f"{path}: runs of {seconds} s; all satellites need the same, at most {LONGEST:,} s")
    return rows


class AssignedTasks:
    """Points satellites at given tasks, second by second: the benchmark's replay of an annotation."""

    def __init__(self, env: Tasking, assignments: Tensor) -> None:
        """Replay ``assignments`` [C, t, S] of the cases of ``env``; ValueError for other shapes, or another environment."""
        self.view, cases = cases_of(env)
        if self.view.entry.duration is not None or self.view.entry.n_candidates is not None:
            raise ValueError("annotations have a task in every second; make AEOSBench-v1 without step_duration and candidates")
        if assignments.ndim != 3 or len(assignments) != len(cases) or assignments.shape[2] != cases.n_satellites:
            raise ValueError(
                f"assignments={list(assignments.shape)} must be [C, t, S] of C={len(cases)} cases with S={cases.n_satellites} "
                "satellites, those that pad included"
            )
        end = torch.full_like(assignments[:, :1], NO_TASK)
        self.env, self.assignments = env, torch.cat([assignments, end], 1).to(env.device)

    def module(self) -> TeamPolicy:
        """Return the replay as a policy of the environment."""
        group = next(iter(self.env.group_map))
        return TeamPolicy(self, [(group, "action_mask")], [(group, "action")])

    def __call__(self, action_mask: Tensor) -> Tensor:
        """Return actions [N, S] for legal actions [N, S, n + 1]."""
        scenario, stay = self.view.scenario, action_mask.shape[-1] - 1
        now = scenario.fleet.ticks.clamp(max=self.assignments.shape[1] - 1)
        task = self.assignments[scenario.drawn("case").long().flatten(), now]
        if self.view.entry.sensor == "chosen":
            return torch.where(action_mask[..., :stay].any(-1), task + 1 + (task >= 0) * (scenario.n_tasks + 1), stay)
        return torch.where(action_mask[..., :stay].any(-1), task + 1, stay)
