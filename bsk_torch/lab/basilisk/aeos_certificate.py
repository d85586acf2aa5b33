"""Certificates of the suite ``aeosbench``: the assigned tasks of the first scenarios, flown again on Basilisk.

Attitudes of AEOS-Bench are chaotic: a change of 1e-14 at the start moves single successes within an hour, on Basilisk as here. A
flight here whose start is changed so much tells how long a satellite can be compared: as long as both flights agree.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from torch import Tensor

from bsk_torch.env import ConstellationTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.env.seeds import suite_episodes
from bsk_torch.lab.basilisk.flight import lacking
from bsk_torch.lab.suites.suite import Entrant, Task, enter
from bsk_torch.rand import Key
from bsk_torch.rl.evaluation.evaluate import start_episodes
from bsk_torch.tasks.aeos_bench import Cases
from bsk_torch.tasks.aeos_bench.annotations import AssignedTasks, assigned_tasks, replaying
from bsk_torch.tasks.aeos_bench.reward import task_measures
from bsk_torch.tasks.aeos_bench.rules import task_team
from bsk_torch.tasks.aeos_bench.writing import case_content

if TYPE_CHECKING:
    from bsk_torch.lab.basilisk.aeos_reference import Flight

BENCH = "AEOSBench-v1"
"""The preset."""

NUDGE = 1e-14
"""Change of the initial attitude (MRP) of the second flight."""

SAME_FLIGHT = 1e-9
"""Difference of attitudes (MRP) up to which the second flight agrees."""

CLOSE = 1e-4
"""Largest difference of attitudes (MRP) from Basilisk, as long as the second flight agrees, that certifies."""

HORIZON_MARGIN = 1e-3
"""Share of the Earth's radius below the horizon within which access is still asked of Basilisk."""

Array = np.ndarray


@dataclass(frozen=True)
class Flown:
    """A flight of a scenario with S satellites and T tasks for t seconds.

    Attributes:
        sigma: Attitudes (MRP) before the choices of each second, [t, S, 3].
        sights: Ongoing tasks that sensors see at that time, [t, S, T].
        success: The second at which each task has succeeded, [T]; -1 for none.
        best: Largest progress of each task, s, [T].
        energy: Energy of the sensors of satellites with a task, W s.
    """

    sigma: Array
    sights: Array
    success: Array
    best: Array
    energy: float

    def measures(self, tasks: Sequence[dict[str, object]]) -> dict[str, float]:
        """Return the benchmark's measures; see :func:`bsk_torch.tasks.aeos_bench.reward.task_measures`."""
        duration, release = (
            torch.tensor([[task[name] for task in tasks]], dtype=torch.float64) for name in ("duration", "release_time")
        )
        success, best = (torch.as_tensor(one, dtype=torch.float64).unsqueeze(0) for one in (self.success, self.best))
        energy = torch.tensor([self.energy], dtype=torch.float64)
        values = task_measures(duration=duration, release=release, success=success, best=best, energy=energy)
        return {name: float(value) for name, value in values.items()}


@dataclass(frozen=True)
class Comparison:
    """A scenario flown in bsk_torch and on Basilisk with the same tasks.

    Attributes:
        measures: Measures here and on Basilisk.
        successes: Number of tasks that succeeded here, on Basilisk, and in both at the same second.
        seconds: Satellite-seconds that were flown, and those in which the second flight agrees.
        difference: Largest difference of attitudes (MRP) from Basilisk in the latter.
        sights: Tasks seen by satellites, counted in each second of the latter, here, and those seen on one side only.
    """

    measures: tuple[dict[str, float], dict[str, float]]
    successes: tuple[int, int, int]
    seconds: tuple[int, int]
    difference: float
    sights: tuple[int, int]

    @property
    def agrees(self) -> bool:
        """Whether attitudes are close and sights equal as long as the second flight agrees."""
        return self.difference <= CLOSE and self.sights[1] == 0

    @property
    def same(self) -> bool:
        """Whether the same tasks succeeded at the same seconds."""
        successes, reference, shared = self.successes
        return successes == reference == shared


@dataclass(frozen=True)
class BenchCertificate:
    """Scenarios of a task flown again on Basilisk."""

    seeds: tuple[int, ...]
    flights: tuple[Comparison, ...]

    def summary(self) -> dict[str, object]:
        """Plain values for a file."""
        rates = [[flight.measures[side]["CR"] for flight in self.flights] for side in (0, 1)]
        return {
            "agrees": all(flight.agrees for flight in self.flights),
            "decided": "in bsk_torch",
            "same": sum(flight.same for flight in self.flights),
            "largest_difference": max(abs(a - b) for a, b in zip(*rates, strict=True)),
            "returns": rates[0],
            "returns_basilisk": rates[1],
            "measures": [flight.measures[0] for flight in self.flights],
            "measures_basilisk": [flight.measures[1] for flight in self.flights],
            "successes": [flight.successes[0] for flight in self.flights],
            "successes_basilisk": [flight.successes[1] for flight in self.flights],
            "successes_agreed": [flight.successes[2] for flight in self.flights],
            "satellite_seconds": [flight.seconds[0] for flight in self.flights],
            "satellite_seconds_compared": [flight.seconds[1] for flight in self.flights],
            "attitude_difference": [flight.difference for flight in self.flights],
            "sights": [flight.sights[0] for flight in self.flights],
            "sights_different": [flight.sights[1] for flight in self.flights],
        }


@suite_episodes()
def certify_bench(task: Task, entrant: Entrant, episodes: int, **options: object) -> BenchCertificate | None:
    """Fly the first ``episodes`` of a task with the policy that ``entrant`` enters, and its tasks on Basilisk; None without one.

    Raises:
        ImportError: Without Basilisk; the message lists what to install.
        ValueError: For a policy that chooses when sensors are on, and as :func:`~bsk_torch.lab.suites.suite.enter`.
    """
    if missing := lacking():
        raise ImportError(missing)
    entered = enter(task, entrant, episodes, **options)
    if entered is None:
        return None
    env, policy = cast(ConstellationTasking, entered[0]), entered[1]
    seeds = task.seeds(episodes)
    start, team = start_episodes(env, seeds), task_team(env)
    rows = torch.arange(env.batch_size[0], device=env.device) < len(seeds)
    key = Key(env.state.seed.cpu(), env.env_ids.cpu(), env.episode.cpu())
    cases = team.scenario.cases_of(key)
    table = assigned_tasks(policy, env, start, rows)
    compared = []
    for k in range(len(seeds)):
        case = cases.take(torch.tensor([k]))
        crew = int(case.present.sum())
        content = case_content(case, 0)
        flight, twin = flown_here(env, replace(case, names=("0",)), table[k], content)
        assigned = partial(_assigned, table[k, :, :crew].cpu().numpy())
        reference = flown_there(content, assigned, table.shape[1], team.entry.sensor == "on")
        compared.append(comparison(flight, twin, reference, content["taskset"]))
    return BenchCertificate(tuple(seeds), tuple(compared))


def comparison(flight: Flown, twin: Flown, reference: Flown, tasks: Sequence[dict[str, object]]) -> Comparison:
    """Compare a flight here with that on Basilisk, as long as the second flight here, ``twin``, agrees."""
    agrees = np.maximum.accumulate(np.abs(flight.sigma - twin.sigma).max(2), axis=0) <= SAME_FLIGHT
    difference = np.where(agrees, np.abs(flight.sigma - reference.sigma).max(2), 0.0)
    sights = flight.sights & agrees[:, :, None]
    matches = (flight.success == reference.success) & (flight.success >= 0)
    # sights are compared until the task succeeds on one side, perhaps by a satellite that is no longer compared
    second = np.arange(len(agrees))[:, None]
    ongoing = np.logical_and.reduce([(one.success < 0) | (second < one.success) for one in (flight, reference)])
    different = (flight.sights != reference.sights) & agrees[:, :, None] & ongoing[:, None, :]
    return Comparison(
        measures=(flight.measures(tasks), reference.measures(tasks)),
        successes=(int((flight.success >= 0).sum()), int((reference.success >= 0).sum()), int(matches.sum())),
        seconds=(agrees.size, int(agrees.sum())),
        difference=float(difference.max()),
        sights=(int(sights.sum()), int(different.sum())),
    )


def flown_here(env: ConstellationTasking, case: Cases, table: Tensor, content: dict[str, Any]) -> tuple[Flown, Flown]:
    """Fly the assigned tasks [t, S] of a case in every second here, from its start and from one that is :data:`NUDGE` away."""
    twice = case.take(torch.zeros(2, dtype=torch.int64))
    sigma = twice.satellites["sigma_init"].clone()
    sigma[1] += NUDGE
    twice = replace(twice, names=("0", "1"), satellites={**twice.satellites, "sigma_init": sigma})
    twins = replaying(env, twice, 2)
    team, crew, jobs = task_team(twins), len(content["constellation"]["satellites"]), len(content["taskset"])
    seconds = len(table)
    attitude = torch.zeros(seconds, 2, crew, 3, dtype=torch.float64)
    sights = torch.zeros(seconds, 2, crew, jobs, dtype=torch.bool)
    replay, start = AssignedTasks(twins, table.expand(2, -1, -1)).module(), start_episodes(twins, range(2))

    def note(second: int) -> None:
        attitude[second] = team.satellite.dynamics.sigma_BN.view(*team.scenario.fleet.shape, 3)[:, :crew].cpu()
        row, satellite, task = (part.cpu() for part in team.scenario.task_visible())
        sights[second, row, satellite, task] = True

    note(0)
    for second, _ in enumerate(play_episodes(twins, replay, start), 1):
        if second < seconds:
            note(second)
    memory = team.scenario.memory
    success, best, energy = (memory[name].cpu() for name in ("task_success", "task_best", "sensor_energy"))
    flights = (
        Flown(
            sigma=attitude[:, k].numpy(),
            sights=sights[:, k].numpy(),
            success=success[k, :jobs].long().numpy(),
            best=best[k, :jobs].long().numpy(),
            energy=float(energy[k]),
        )
        for k in range(2)
    )
    return next(flights), next(flights)


def _assigned(table: Array, flight: Flight, is_open: Array) -> Array:
    return table[flight.tick]


def flown_there(content: dict[str, Any], choose: Callable[[Flight, Array], Array], seconds: int, always_on: bool) -> Flown:
    """Fly a scenario on Basilisk; sensors are on always, or while a task is assigned.

    Args:
        content: Contents of the files of the scenario.
        choose: Returns the task of each satellite in the next second, -1 for none, [S], given which tasks are open, [T].
        seconds: Length of the flight.
        always_on: Whether sensors are on without a task.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from bsk_torch.lab.basilisk.aeos_reference import Flight, Progress
    flight, progress = Flight(content), Progress(content)
    power = np.array([one["sensor"]["power"] for one in content["constellation"]["satellites"]])
    sigma, sights, energy = [], [], 0.0
    for second in range(seconds):
        flight.run_to(second)
        is_open = progress.open(second)
        access = flight.access_of(flight.above(HORIZON_MARGIN) & is_open)
        sigma.append([craft.body.scStateOutMsg.read().sigma_BN for craft in flight.crafts])
        sights.append(access & progress.matches & flight.sensors_on[:, None])
        # the benchmark decides before it counts
        choice = choose(flight, is_open)
        progress.add(flight, access)
        energy += float(power @ (choice >= 0))
        on = np.ones(len(choice), dtype=bool) if always_on else choice >= 0
        flight.act(choice, on != flight.sensors_on)
    return Flown(np.array(sigma), np.array(sights), progress.success, progress.most, energy)
