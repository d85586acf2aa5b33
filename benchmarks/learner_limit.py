"""How many collecting cores a learner can use: a simulation from measured rates.

Usage:
    python benchmarks/learner_limit.py [--cases NadirScan-v1:mlp AEOS-v1:attention] [--workers 1 2 8 32 128] [--seconds 10]
        [--profile benchmarks/results/training_profile.json] [--out FILE.json]

CPU times of a decision in learning and collecting are those of training_profile.py. Measured here, relative to them:

- collecting with the share of each number of processes: a step of few episodes costs more for each of them;
- for every batch, what the learner spends on sending weights and receiving a batch, and a process on receiving and sending;
- how much batches differ: the learner waits for the slowest process.

A batch then takes the slowest of as many drawn collections as there are processes, the transfer, and the learning; with
``ahead``, the longer of learning and collecting, and the transfer. Every process has a core, the learner too. The last rows are
real trainings on this machine, by the wall clock, and the simulation of the same: they need two idle cores.
"""

from __future__ import annotations

import copy
import json
import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import harness
import torch

from bsk_torch.rl.marl.runs import configure, training_of
from bsk_torch.rl.training import PPOConfig, Training
from bsk_torch.rl.training.collect import Batches, make_collector
from bsk_torch.rl.training.profile import COLLECTING
from bsk_torch.rl.training.trainer import shut_down

PROFILE = Path(__file__).with_name("results") / "training_profile.json"

WARM_UP, LEAST = 2, 3
"""Batches before anything is measured, and the least number of measured ones."""

DRAWN = 4096
"""Simulated batches."""

COLUMNS = {
    "case": "{case}",
    "collecting processes": "{workers}",
    "ahead": "{ahead}",
    "simulated decisions/s": "{simulated:,.0f}",
    "learner busy": "{busy:.0%}",
    "measured decisions/s": "{measured:,.0f}",
}


class Costs(NamedTuple):
    """Seconds for a batch: learning, the two sides of its transfer, and collections by number of processes."""

    learn: float
    receive: float
    send: float
    collect: dict[int, list[float]]


@contextmanager
def begun(config: PPOConfig) -> Iterator[tuple[Training, Batches]]:
    """A training after its first batches, and what it learns from."""
    with tempfile.TemporaryDirectory() as folder:
        training = training_of(replace(config, seconds=None, frames=10**12, evaluate_every=0), Path(folder) / "run")
        actor = copy.deepcopy(training.actor) if config.ahead else training.actor
        collector = make_collector(config, training.env, actor, None)
        batches = Batches(collector, config.ahead, lambda: actor.load_state_dict(training.actor.state_dict()))
        training.learner.anneal(max(0.5, config.imitation))  # after imitation, if there is any
        try:
            for _ in range(WARM_UP):
                training.learner.learn(batches.take())
            yield training, batches
        finally:
            batches.close()
            shut_down(collector)
            training.lock.release()


def collections(config: PPOConfig, seconds: float) -> list[float]:
    """CPU seconds of the collection of batches, in one process."""
    spent: list[float] = []
    with begun(config) as (_, batches):
        while sum(spent) < seconds or len(spent) < LEAST:
            clock = time.thread_time()
            batches.take()
            spent.append(time.thread_time() - clock)
    return spent


def cpu_of(batches: Batches) -> float:
    """CPU seconds that the processes of a collector have used."""
    stats = [Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split() for process in batches.collector.procs]
    return sum(int(stat[11]) + int(stat[12]) for stat in stats) / os.sysconf("SC_CLK_TCK")


def transfers(config: PPOConfig, seconds: float) -> tuple[float, float]:
    """CPU seconds of each batch that the learner spends on a transfer, and that a process spends in all."""
    spent: list[float] = []
    with begun(config) as (_, batches):
        begin = cpu_of(batches)
        while cpu_of(batches) - begin < seconds or len(spent) < LEAST:
            clock = time.thread_time()
            batches.take()
            spent.append(time.thread_time() - clock)
        return statistics.fmean(spent), (cpu_of(batches) - begin) / len(spent) / config.processes


def costs_of(case: str, config: PPOConfig, workers: list[int], options: Any) -> Costs:
    """Measure the costs of a case, in the units of its profile."""
    rows = json.loads((options.profile or PROFILE).read_text())["rows"]
    phases = [row for row in rows if row["case"] == case and row["phase"] != "all"]
    if not phases:
        raise SystemExit(f"{options.profile or PROFILE} has no case {case}: run benchmarks/training_profile.py --cases {case}")
    batch = 1e-6 * config.batch
    collecting = batch * sum(row["us"] for row in phases if row["phase"].startswith(COLLECTING))
    shares = {
        count: collections(replace(config, num_envs=config.num_envs // count), options.seconds) for count in {1, 2, *workers}
    }
    receive, process = transfers(replace(config, collector="multi", workers=2), options.seconds)
    unit = collecting / statistics.fmean(shares[1])
    return Costs(
        batch * sum(row["us"] for row in phases) - collecting,
        unit * receive,
        unit * max(0.0, process - statistics.fmean(shares[2])),
        {count: [unit * cost for cost in drawn] for count, drawn in shares.items()},
    )


def seconds_of_batch(costs: Costs, workers: int, ahead: bool) -> float:
    """Mean time of a batch with so many processes; 0 for the learner's own."""
    drawn = torch.tensor(costs.collect[max(1, workers)], dtype=torch.float64)
    if not workers:
        return costs.learn + float(drawn.mean())
    generator = torch.Generator().manual_seed(0)
    slowest = drawn[torch.randint(len(drawn), (DRAWN, workers), generator=generator)].amax(-1) + costs.send
    return costs.receive + float((slowest.clamp(min=costs.learn) if ahead else slowest + costs.learn).mean())


def measured(config: PPOConfig, seconds: float) -> float:
    """Decisions per second of the wall clock in a training."""
    count, begin = 0, 0.0
    with begun(config) as (training, batches):
        begin = time.perf_counter()
        while time.perf_counter() - begin < seconds or count < LEAST:
            training.learner.learn(batches.take())
            count += 1
        return count * config.batch / (time.perf_counter() - begin)


def rows_of(case: str, options: Any) -> list[dict[str, Any]]:
    """Rows of a case: simulated trainings, and then real ones."""
    preset, _, network = case.partition(":")
    num_envs = json.loads((options.profile or PROFILE).read_text())["options"].get("num_envs")
    config = configure(preset, network or None, **({"num_envs": num_envs} if num_envs else {}))
    workers = [count for count in options.workers if config.num_envs % count == 0]
    costs = costs_of(case, config, workers, options)

    def row(count: int, ahead: bool) -> dict[str, Any]:
        seconds = seconds_of_batch(costs, count, ahead)
        simulated, busy = config.batch / seconds, (costs.learn + costs.receive * (count > 0)) / seconds
        return {"case": case, "workers": count, "ahead": ahead, "simulated": simulated, "busy": busy}

    rows = [row(count, ahead) for ahead in (False, True) for count in workers]
    for count, ahead in ((0, False), (2, False), (1, True)):
        real = replace(config, ahead=ahead, **(dict(collector="multi", workers=count) if count else {}))
        rows.append(row(count, ahead) | {"measured": measured(real, options.seconds)})
    return rows


def main() -> None:
    """Measure, simulate and print a table."""
    cases = ["NadirScan-v1:mlp", "AEOS-v1:attention"]
    parsed = harness.parser(__doc__, cases=cases, workers=[1, 2, 8, 32, 128], seconds=10.0)
    parsed.add_argument("--profile", type=Path, metavar="FILE.json", help=f"default {PROFILE.name} of the results")
    options, described = harness.begin(parsed)
    torch.manual_seed(0)
    rows = harness.Rows(options, described, (row for case in options.cases for row in rows_of(case, options)))
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":  # processes import this file
    main()
