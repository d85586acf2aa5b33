"""Where the CPU time of a training goes, by phase.

Usage:
    python benchmarks/training_profile.py [--cases NadirScan-v1:mlp AEOS-v1:attention] [--seconds 20] [--out FILE.json]

Each case is a preset and a network, trained by its recipe in one process and one thread. A timer of CPU time interrupts it about
every millisecond, as in breakdown.py; the time counts for the first of ``PHASES`` that any running function belongs to. The first
batches, in which episodes begin and kernels are loaded, are not counted; neither are evaluations and checkpoints.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from types import FrameType
from typing import Any

import harness
import torch
from breakdown import sampling

from bsk_torch.rl.training import configure
from bsk_torch.rl.training.collect import Batches, make_collector
from bsk_torch.rl.training.trainer import Training

PHASES: list[tuple[str, tuple[str, ...]]] = [
    ("learning: gradients", ("torch._tensor:backward",)),
    ("learning: networks and loss", ("bsk_torch.rl.training.loss", "bsk_torch.rl.training.imitation")),
    ("learning: clipping and Adam", ("torch.optim", "torch.nn.utils.clip_grad")),
    ("learning: values and advantages", ("bsk_torch.rl.training.advantages",)),
    ("learning: samples", ("bsk_torch.rl.training.ppo:_samples",)),
    ("learning: the rest", ("bsk_torch.rl.training.ppo:learn", "bsk_torch.rl.marl.mappo:learn")),
    ("collecting: resets of episodes", ("bsk_torch.env.base:_reset",)),
    ("collecting: simulation, observations, rewards", ("bsk_torch.env",)),
    ("collecting: networks", ("bsk_torch.rl.networks", "bsk_torch.rl.policies", "torchrl.modules", "tensordict.nn")),
    ("collecting: TorchRL", ("torchrl", "tensordict", "bsk_torch.rl.training.collect")),
]
"""Phases, each with modules, or functions of modules; the first that is found in the stack counts."""

OTHER = "the rest"

WARM_UP = 2
"""Batches before anything is counted."""

COLUMNS = {"case": "{case}", "phase": "{phase}", "us per decision": "{us:,.2f}", "%": "{percent:.1f}"}


def belongs(frame: FrameType, place: str) -> bool:
    """Whether a function is that of a ``place``, or of its module or package."""
    package, _, function = place.partition(":")
    module = frame.f_globals.get("__name__", "")
    inside = module == package or module.startswith(f"{package}.")
    return inside and function in ("", frame.f_code.co_name)


def phase_of(frame: FrameType | None) -> str:
    """Return the phase of what runs in ``frame``."""
    stack = []
    while frame is not None:
        stack.append(frame)
        frame = frame.f_back
    for phase, places in PHASES:
        if any(belongs(each, place) for each in stack for place in places):
            return phase
    return OTHER


def profile(case: str, seconds: float, num_envs: int) -> list[dict[str, Any]]:
    """Rows of a case: every phase, and their sum."""
    preset, _, network = case.partition(":")
    changes = {"num_envs": num_envs} if num_envs else {}
    with tempfile.TemporaryDirectory() as folder:
        config = configure(preset, network or None, seconds=None, frames=10**9, evaluate_every=0, **changes)  # type: ignore[arg-type]
        training = Training(config, Path(folder) / "run")
        collector = make_collector(config, training.env, training.actor, None)
        batches = Batches(collector, config.ahead, lambda: None)
        training.learner.anneal(0.5)  # after imitation, if there is any
        for _ in range(WARM_UP):
            training.learner.learn(batches.take())
        count, end = 0, time.thread_time() + seconds
        with sampling(phase_of) as spent:
            while time.thread_time() < end:
                training.learner.learn(batches.take())
                count += config.batch
        batches.close()
        training.lock.release()
    total = sum(spent.values())
    parts = sorted(spent.items(), key=lambda item: -item[1])
    return [
        {"case": case, "phase": phase, "us": 1e6 * cost / count, "percent": 100.0 * cost / total}
        for phase, cost in [*parts, ("all", total)]
    ]


def main() -> None:
    """Measure and print a table."""
    cases = ["NadirScan-v1:mlp", "AEOS-v1:attention"]
    parsed = harness.parser(__doc__, cases=cases, seconds=20.0, num_envs=0)
    options, described = harness.begin(parsed)
    torch.manual_seed(0)
    rows = [row for case in options.cases for row in profile(case, options.seconds, options.num_envs)]
    print(harness.table(COLUMNS, rows))
    harness.write(options, described, rows=rows)


if __name__ == "__main__":
    main()
