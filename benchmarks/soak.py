"""Long random rollouts: whether memory, speed, clocks and numbers stay as they are.

Usage:
    python benchmarks/soak.py [--cases NadirScan-v1 ...] [--scale 1.0] [--out FILE.json]

The cases are ten million steps of NadirScan-v1, one million of AEOS-v1 and of Constellation-v1 (decisions of satellites are
counted there), and episodes of 10^7 simulated seconds; ``--scale`` multiplies steps and seconds. Each runs in a process of its
own, and a row is written for each tenth of it: memory of the process, CPU time per step of the batch, numbers that are not
finite, and the largest difference between the clock of an episode and the sum of the durations of its steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import harness
import torch
from tensordict import TensorDictBase
from torch import Tensor

import bsk_torch
from bsk_torch import rand
from bsk_torch.presets.nadir_scan import scanning_args

POINTS = 10

IMMORTAL = {
    "batteryStorageCapacity": 1e12,
    "storedCharge_Init": 1e12,
    "disturbance_vector": [0.0, 0.0, 0.0],
    "wheelSpeeds": [0.0, 0.0, 0.0],
    "storageInit": rand.Uniform(0.0, 1e9),
}
"""Arguments of a satellite that neither its battery nor its wheels end."""


class Case(NamedTuple):
    """A preset, its options, and the steps (of the batch times the satellites) or simulated seconds to be played."""

    preset: str
    batch: int
    steps: int = 0
    seconds: float = 0.0


CASES = {
    "NadirScan-v1": Case("NadirScan-v1", 4096, steps=10_000_000),
    "AEOS-v1": Case("AEOS-v1", 1024, steps=1_000_000),
    "Constellation-v1": Case("Constellation-v1", 64, steps=1_000_000),
    "long episodes": Case("NadirScan-v1", 4, seconds=1e7),
}

COLUMNS = {
    "case": "{case}",
    "steps": "{steps:,}",
    "simulated s": "{simulated:,.0f}",
    "episodes ended": "{ended:,}",
    "memory of the process, MB": "{megabytes:,.1f}",
    "CPU ms per step of the batch": "{cpu:.2f}",
    "not finite": "{not_finite}",
    "clock less durations, s": "{drift:.1e}",
}


def make_env(case: Case) -> Any:
    """Return the environment of a case, with float64 outputs."""
    options: dict[str, Any] = dict(num_envs=case.batch, seed=0, dtype=torch.float64)
    if case.seconds:
        options |= dict(sat_args=scanning_args() | IMMORTAL, time_limit=case.seconds)
    return bsk_torch.make(case.preset, **options)


def random_actions(td: TensorDictBase, env: Any) -> TensorDictBase:
    """Add random legal actions; those of all agents of a constellation."""
    for name in getattr(env, "group_map", None) or [None]:
        where = (name,) if name else ()
        mask = td[(*where, "action_mask")] if where else td["action_mask"]
        choice = torch.multinomial(mask.reshape(-1, mask.shape[-1]).double(), 1).view(mask.shape[:-1])
        td[(*where, "action") if where else "action"] = choice
    return td


def not_finite(td: TensorDictBase) -> int:
    """Return the number of floating-point numbers that are not finite."""
    floats: list[Tensor] = [leaf for leaf in td.values(True, True) if leaf.dtype.is_floating_point]
    return sum(int((~torch.isfinite(leaf)).sum()) for leaf in floats)


class Soak:
    """A rollout, with what has been counted so far."""

    def __init__(self, case: Case) -> None:
        """Build the environment and begin its episodes."""
        self.env = make_env(case)
        self.td = self.env.reset()
        self.satellites = self.env.fleet.size
        self.elapsed = torch.zeros(case.batch, dtype=torch.float64)
        self.batches = self.steps = self.ended = self.not_finite = 0
        self.simulated = self.drift = 0.0

    def step(self) -> None:
        """Play one step of the batch."""
        td = self.env.step(random_actions(self.td, self.env))
        seen = td["next"]
        duration, done = seen["duration"].flatten(), seen["done"].flatten()
        self.elapsed = self.elapsed + duration
        self.drift = max(self.drift, float((self.elapsed - self.env.fleet.sim_time).abs().max()))
        self.elapsed = torch.where(done, 0.0, self.elapsed)
        self.batches, self.steps = self.batches + 1, self.steps + len(done) * self.satellites
        self.ended, self.not_finite = self.ended + int(done.sum()), self.not_finite + not_finite(seen)
        self.simulated += float(duration.sum())
        self.td = self.env.step_mdp(td) if not bool(done.any()) else self.env.maybe_reset(self.env.step_mdp(td))

    def row(self, since: tuple[int, float]) -> dict[str, Any]:
        """Return what has been counted; ``since`` are the batches and the CPU time at the last row."""
        cpu = (time.process_time() - since[1]) / max(1, self.batches - since[0]) * 1e3
        counted = {name: getattr(self, name) for name in ("steps", "simulated", "ended", "not_finite", "drift")}
        return counted | {"megabytes": harness.resident() / 1e6, "cpu": cpu}


def measure(_: int, name: str, scale: float) -> list[dict[str, Any]]:
    """Return the rows of a case."""
    torch.set_num_threads(1)
    case = CASES[name]
    case = case._replace(steps=round(case.steps * scale), seconds=case.seconds * scale)
    soak, rows = Soak(case), []
    done: Callable[[], float] = lambda: soak.simulated / case.batch if case.seconds else soak.steps  # noqa: E731
    for point in range(1, POINTS + 1):
        since = soak.batches, time.process_time()
        while done() < (case.seconds or case.steps) * point / POINTS:
            soak.step()
        rows.append({"case": name, **soak.row(since)})
        print(harness.table(COLUMNS, rows[-1:]).splitlines()[-1], flush=True)
    return rows


def main() -> None:
    """Play the cases and print a table."""
    arguments = harness.parser(__doc__, cases=list(CASES), scale=1.0)
    options, described = harness.begin(arguments)
    rows = harness.Rows(
        options, described, (row for name in options.cases for row in harness.in_processes(1, measure, name, options.scale)[0])
    )
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
