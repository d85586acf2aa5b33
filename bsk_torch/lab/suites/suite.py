"""Suites of tasks with fixed episodes, for comparing policies from any library.

A suite is a table of tasks. A task is a preset with its options, the seeds of its episodes, and perhaps measures for a score.
Tasks never change: a suite with another task, or a preset with a changed decision process, gets a new name. The tasks of ``v1``
are presets; those of ``v3`` are variants of presets in which planners are well ahead of all rules, in families.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from bsk_torch._rooms import resolve
from bsk_torch.env import Tasking
from bsk_torch.env.rollout import Policy
from bsk_torch.env.seeds import SUITE_SEEDS, suite_episodes
from bsk_torch.presets import make
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.evaluation.statistics import Estimate, confidence
from bsk_torch.rl.policies.shared_policy import as_policy
from bsk_torch.sim.arguments.values import nearest

__all__ = [
    "EPISODES",
    "REMARKS",
    "SUITES",
    "VIEWS",
    "Entrant",
    "Score",
    "Task",
    "bench_folder",
    "enter",
    "normalised",
    "play",
    "ranking",
    "references",
    "tasks_of",
]

EPISODES = 1024
"""Number of episodes of each task, unless it has its own."""

VIEWS = ("as_set", "shielded", "actions")
"""Options of presets that change only the observations and actions of a policy; each policy may choose them."""


@dataclass(frozen=True)
class Task:
    """A preset and its fixed episodes.

    Attributes:
        preset: Name of the environment.
        first_seed: Seed of the first episode; the seeds of the others follow.
        at_once: Number of episodes played at once, limited by memory. Results do not depend on it.
        options: Arguments of the environment that differ from the preset's.
        name: Name of the task in its suite (default: the preset).
        episodes: Number of its episodes.
        measures: Measures of the rewarder in place of a score; none for tasks with a score.
        views: Options that each policy may choose.
        rules: Views of rules that are not those of the preset, by the name of the rule.
        drawn: Options of trainings that the task replaces: they tell which scenarios are drawn, and policies may differ in them.
        about: Which scenarios the episodes are.
        family: Tasks of a family are variants of one another, and their scores are aggregated apart from those of other families.
    """

    preset: str
    first_seed: int
    at_once: int
    options: Mapping[str, object] = field(default_factory=dict)
    name: str = ""
    episodes: int = EPISODES
    measures: tuple[str, ...] = ()
    views: tuple[str, ...] = VIEWS
    rules: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    drawn: tuple[str, ...] = ("time_limit",)
    about: str = ""
    family: str = ""

    @property
    def title(self) -> str:
        """Name of the task in its suite."""
        return self.name or self.preset

    def seeds(self, episodes: int | None = None) -> range:
        """Return the seeds of the first ``episodes`` (default: all); ValueError for a number out of range."""
        count = self.episodes if episodes is None else episodes
        if not 1 <= count <= self.episodes:
            raise ValueError(f"episodes={episodes} must lie in [1, {self.episodes}]")
        return range(self.first_seed, self.first_seed + count)

    def environment(self, episodes: int | None = None, **views: object) -> Tasking:
        """Return an environment for the episodes (default: all); ``views`` are changed options among those of the task.

        Raises:
            ValueError: For options that would change the task, and values rejected by the preset.
        """
        for name in views:
            if name not in (*self.views, "backend", "device"):
                raise ValueError(f"{name}={views[name]!r} would change the task {self.title}; policies choose among {self.views}")
        size = min(len(self.seeds(episodes)), self.at_once)
        return make(self.preset, num_envs=size, env_ids=[0] * size, **(dict(self.options) | views))


MANY, CLOSE = 512, 128
"""Number of episodes played at once, and the same for inspections, which need more memory."""

SUITES: dict[str, tuple[Task, ...]] = {
    "v1": tuple(
        Task(preset, SUITE_SEEDS[EPISODES * k], CLOSE if "Inspection" in preset else MANY)
        for k, preset in enumerate(
            (
                "NadirScan-v1",
                "AEOS-v1",
                "AEOSPower-v1",
                "AEOSCity-v1",
                "CloudyAEOS-v1",
                "Constellation-v1",
                "AEOSConstellation-v1",
                "RelayConstellation-v1",
                "RSOInspection-v1",
                "MultiInspection-v1",
            )
        )
    ),
}
"""Tasks by name of the suite."""

AEOS_BENCH = partial(
    Task,
    "AEOSBench-v1",
    at_once=32,
    measures=("CR", "WCR", "PCR", "WPCR", "TAT", "PC", "CS"),
    views=("sensor", "candidates", "as_set", "step_duration", "until_done"),
    rules={"nearest_task": {"sensor": "on"}, "soonest_task": {"candidates": True, "step_duration": 10.0}},
    drawn=("time_limit", "satellites", "tasks", "orbits", "folder", "order"),
)
"""What all tasks of the suite ``aeosbench`` share."""

BENCH_SIZES = {"satellites": (1, 50), "tasks": (50, 300)}

SUITES["aeosbench"] = (
    AEOS_BENCH(
        SUITE_SEEDS[EPISODES * 16],
        options=BENCH_SIZES,
        name="random_orbits",
        episodes=64,
        about="64 random scenarios with the distributions of the training and val_seen sets of AEOS-Bench: 1 to 50 satellites on "
        "random orbits, 50 to 300 tasks",
    ),
    AEOS_BENCH(
        SUITE_SEEDS[EPISODES * 17],
        options=BENCH_SIZES | {"orbits": "real"},
        name="real_orbits",
        episodes=64,
        about="64 random scenarios with the distributions of its test set: the same on orbits of real satellites, which its "
        "repository lists",
    ),
)

SITES = partial(Task, "Sites-v1", at_once=256, episodes=256, drawn=("time_limit", "gain", "risk"), family="sites")
AREAS = partial(
    Task, "Areas-v1", at_once=256, episodes=256, drawn=("time_limit", "revisit", "sat_args", "failure_penalty"), family="areas"
)
"""What the tasks of a family of the suite ``v3`` share."""

SUITES["v3"] = (  # seeds from EPISODES * 18 to 22 stay unused: they were those of the suite v2, which is withdrawn
    SITES(
        SUITE_SEEDS[EPISODES * 23],
        name="sites",
        about="Sites-v1: sites pay when they are complete, under weather with a forecast",
    ),
    SITES(
        SUITE_SEEDS[EPISODES * 24],
        options={"gain": "convex"},
        name="sites_convex",
        about="Sites-v1 in which parts of sites pay, too, under weather with a forecast",
    ),
    SITES(
        SUITE_SEEDS[EPISODES * 25],
        options={"gain": "convex", "risk": 0.0},
        name="sites_clear",
        about="Sites-v1 in which parts of sites pay, too, without weather",
    ),
    AREAS(SUITE_SEEDS[EPISODES * 26], name="areas", about="Areas-v1: cells pay once"),
    AREAS(
        SUITE_SEEDS[EPISODES * 27],
        options={"revisit": 5700.0},
        name="areas_revisit",
        about="Areas-v1 in which recorded cells pay again, in proportion to the time since, up to one revolution",
    ),
    AREAS(
        SUITE_SEEDS[EPISODES * 28],
        options={
            "revisit": 5700.0,
            "sat_args": {"panelArea": 0.15, "storageInit": 8e9, "transmitterBaudRate": -1.6e8},
        },
        name="areas_scarce",
        about="areas_revisit with a smaller panel, two thirds of the rate of downlinks, and a store that begins 40 % full",
    ),
)

REMARKS = {
    "aeosbench": "Satellites come from a pool of this package, selected by a filter like that of the benchmark; none of the "
    "random scenarios is in its data set. Rows of the same task can be compared with one another, but not with numbers of the "
    "paper: these are means over 64 scenarios of each split, on another Basilisk. Give its own scenarios with --folder.",
}
"""What results do not show, by name of the suite."""


def bench_folder(folder: str | Path) -> Task:
    """Return a task of all cases of AEOS-Bench in a folder, each flown once, for the suite ``aeosbench``.

    ``about`` has a checksum of what is read, by which results of the same cases are recognized. Errors as
    :func:`bsk_torch.tasks.aeos_bench.read_cases`.
    """
    cases, name = resolve("bsk_torch.tasks.aeos_bench:read_cases")(folder), Path(folder).name
    numbers = [*(cases.satellites[key] for key in sorted(cases.satellites)), *(cases.tasks[key] for key in sorted(cases.tasks))]
    content = hashlib.sha256(repr(cases.names).encode())
    for values in (*numbers, cases.places, cases.present, cases.sensors, cases.enabled):
        content.update(values.contiguous().numpy().tobytes())
    return AEOS_BENCH(
        0,
        options={"folder": cases, "order": "listed"},
        name=f"folder {name}",
        episodes=len(cases),
        about=f"all {len(cases)} scenarios of the folder {name}, with the SHA-256 {content.hexdigest()[:16]}",
    )


def tasks_of(suite: str, presets: str | None = None) -> tuple[Task, ...]:
    """Return the tasks of a suite, or only those named in ``presets``, a list separated by commas.

    Raises:
        ValueError: For an unknown suite or task; the message contains the nearest name.
    """
    if suite == "v2":
        raise ValueError("suite='v2' is withdrawn for the reasons in docs/studies/suite.md; use 'v3'")
    if suite not in SUITES:
        raise ValueError(f"suite={suite!r} is not a suite; {nearest(suite, SUITES)}")
    tasks = {task.title: task for task in SUITES[suite]}
    if presets is None:
        return tuple(tasks.values())
    names = [name.strip() for name in presets.split(",")]
    for name in names:
        if name not in tasks:
            raise ValueError(f"preset {name!r} is not in the suite {suite}; {nearest(name, tasks)}")
    return tuple(tasks[name] for name in dict.fromkeys(names))


Entrant = Callable[[str, Callable[..., Tasking]], tuple[Tasking, Policy] | None]
"""Enters a policy: a function of a preset's name and of a function that makes its environment, ``make(**views)``. It returns this
environment and a policy, which writes actions into the environment's tensordict; or None for presets without a policy."""


@dataclass(frozen=True)
class Score:
    """Result of a policy in a task.

    Attributes:
        evaluation: Results of the episodes.
        seconds: Computation time of the policy per decision of one satellite, s, in batches of the task's size.
    """

    evaluation: Evaluation
    seconds: float


class Timed(TensorDictModuleBase):
    """A policy with a measurement of its computation time."""

    def __init__(self, policy: Policy) -> None:
        """Time ``policy``, which need not be a tensordict module."""
        super().__init__()
        self.policy, self.seconds = policy, 0.0
        self.in_keys = list(getattr(policy, "in_keys", []))
        self.out_keys = list(getattr(policy, "out_keys", []))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Apply the policy."""
        start = time.perf_counter()
        tensordict = self.policy(tensordict)
        self.seconds += time.perf_counter() - start
        return tensordict


def enter(task: Task, entrant: Entrant, episodes: int | None = None, **options: object) -> tuple[Tasking, Policy] | None:
    """Return the environment for the first ``episodes`` of a task and the policy of ``entrant``; None without a policy.

    Args:
        task: The task.
        entrant: See :data:`Entrant`.
        episodes: Number of episodes (default: all).
        **options: ``backend`` and ``device`` of the environment.

    Raises:
        TypeError, ValueError: If the entrant returns anything else, or an environment of another task.
    """
    environments: list[Tasking] = []

    def environment(**views: object) -> Tasking:
        environments.append(task.environment(episodes, **(options | views)))
        return environments[-1]

    entered = entrant(task.preset, environment)
    if entered is None:
        return None
    if not isinstance(entered, tuple) or len(entered) != 2 or not callable(entered[1]):
        raise TypeError(f"for {task.preset}, the entrant returned {entered!r}; it must return (env, policy), or None")
    env, policy = entered
    if not any(env is one for one in environments):
        raise ValueError(f"for {task.preset}, the entrant returned an environment that make() has not returned to it")
    return env, as_policy(policy, env)


@suite_episodes()
def play(task: Task, entrant: Entrant, episodes: int | None = None, **options: object) -> Score | None:
    """Play the first ``episodes`` of a task with the policy of ``entrant``; see :func:`enter` for arguments and errors."""
    entered = enter(task, entrant, episodes, **options)
    if entered is None:
        return None
    env, policy = entered
    timed = Timed(policy)
    with torch.no_grad():
        evaluation = evaluate(timed, env, seeds=task.seeds(episodes))
    return Score(evaluation, timed.seconds / max(int(evaluation.decisions.sum()), 1))


@cache
def references(suite: str) -> dict[str, dict[str, Any]]:
    """Return the reference returns of a suite by task: ``low`` and ``high``, each with its mean and its source.

    ``low`` is the random policy, and ``high`` the best of the package's rules, policies and, in ``v3``, planners when the suite
    was created. They are means over all episodes, of planners estimated from their gains in the first ones, and are as fixed as
    the episodes; such an estimate may have the ``half_width`` of its 95 % interval. Suites whose tasks have measures have no
    references, nor have those whose references are not computed yet.
    """
    file = Path(__file__).with_name(f"{suite}.json")
    return json.loads(file.read_text()) if file.exists() else {}


PUBLISHED = Path(__file__).with_name("published")
"""Folder with the results of policies in all tasks of a suite, a file for each suite that has such results."""


@cache
def published(suite: str) -> dict[str, Any]:
    """Return published results of a suite: ``policies`` as in a file of ``bsk-torch bench``, and ``methods``, lists of these.

    The results of the runs of a method, such as its training seeds, have the same names in all tasks.

    Raises:
        ValueError: If the suite has no published results.
    """
    file = PUBLISHED / f"{suite}.json"
    if not file.exists():
        raise ValueError(f"suite={suite!r} has no published results")
    return json.loads(file.read_text())


def normalised(evaluation: Evaluation, reference: Mapping[str, Any]) -> Estimate:
    """Return the score, 0 for random actions and 1 for the reference, with its 95 % interval; the references count as exact."""
    low, high = reference["low"]["return"], reference["high"]["return"]
    return confidence((evaluation.returns - low) / (high - low))


def ranking(returns: Mapping[str, Sequence[float]]) -> tuple[str, dict[str, Estimate]]:
    """Return the best policy, and its mean paired gain over each policy with the 95 % confidence interval, in ascending order.

    *Best* is the policy with the highest mean among those that played the most episodes of a task. A policy that played fewer
    episodes, the first ones, is compared in these, and can rank before the best.

    Args:
        returns: Returns of the first episodes of a task by policy, in the order of the seeds.
    """
    played = {name: torch.as_tensor(values, dtype=torch.float64) for name, values in returns.items()}
    most = max(len(values) for values in played.values())
    best = max((name for name in played if len(played[name]) == most), key=lambda name: float(played[name].mean()))
    gains = {name: confidence(played[best][: len(values)] - values) for name, values in played.items()}
    return best, dict(sorted(gains.items(), key=lambda item: item[1].mean))
