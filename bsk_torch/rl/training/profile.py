"""Where the CPU time of a training goes, by phase, and what other cores could change about it.

A timer of CPU time interrupts a training in one process and one thread about every millisecond. The time since the last
interrupt counts for the first of :data:`PHASES` that any running function belongs to. The first batches, in which episodes begin
and kernels are loaded, are not counted; neither are evaluations and checkpoints.
"""

from __future__ import annotations

import dataclasses
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from bsk_torch.rl.training.collect import Batches, make_collector
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.trainer import Training, one_thread, shut_down

LEARNING, COLLECTING = "learning: ", "collecting: "

PHASES: dict[str, tuple[str, ...]] = {
    LEARNING + "gradients": ("torch._tensor:backward",),
    LEARNING + "networks and loss": ("bsk_torch.rl.training.loss", "bsk_torch.rl.training.imitation"),
    LEARNING + "clipping and Adam": ("torch.optim", "torch.nn.utils.clip_grad"),
    LEARNING + "values and advantages": ("bsk_torch.rl.training.advantages", "bsk_torch.rl.durations"),
    LEARNING + "samples": ("bsk_torch.rl.training.ppo:_samples",),
    LEARNING + "the rest": ("bsk_torch.rl.training.ppo:learn", "bsk_torch.rl.marl.mappo:learn"),
    COLLECTING + "resets of episodes": ("bsk_torch.env.base:_reset",),
    COLLECTING + "simulation, observations, rewards": ("bsk_torch.env",),
    COLLECTING + "networks": ("bsk_torch.rl.networks", "bsk_torch.rl.policies", "torchrl.modules", "tensordict.nn"),
    COLLECTING + "TorchRL": ("torchrl", "tensordict", "bsk_torch.rl.training.collect"),
}
"""Phases, each with modules, or functions of modules; the first found in the stack counts."""

OTHER = "the rest"
"""Phase of what belongs to none."""

INTERVAL = 1e-3
"""Seconds of CPU time between samples."""

WARM_UP = 2
"""Batches before anything is counted."""

ADVICE = {
    LEARNING: "fewer passes over a batch (epochs), larger minibatches (minibatch) or narrower networks (hidden)",
    COLLECTING + "resets": "fewer targets, or longer episodes",
    COLLECTING + "networks": "narrower networks (hidden), or fewer targets in observations",
    COLLECTING: "more episodes at once (num_envs), because a large part of it is per step",
}
"""What makes phases of a kind cheaper; the first that fits counts."""


def belongs(frame: FrameType, place: str) -> bool:
    """Return whether a function is that of a ``place``, or of its module or package."""
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
    for phase, places in PHASES.items():
        if any(belongs(each, place) for each in stack for place in places):
            return phase
    return OTHER


@contextmanager
def sampling(part_of: Callable[[FrameType | None], str] = phase_of) -> Iterator[dict[str, float]]:
    """CPU seconds of this thread by part, while the context lasts; only the main thread can be sampled."""
    spent: dict[str, float] = {}
    clock = time.thread_time()

    def sample(_: int, frame: FrameType | None) -> None:
        nonlocal clock
        part, now = part_of(frame), time.thread_time()
        spent[part] = spent.get(part, 0.0) + now - clock
        clock = time.thread_time()  # without the time of this function

    previous = signal.signal(signal.SIGPROF, sample)
    signal.setitimer(signal.ITIMER_PROF, INTERVAL, INTERVAL)
    try:
        yield spent
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, previous)


@dataclass(frozen=True)
class Profile:
    """Result of :func:`measure`.

    Attributes:
        spent: CPU time by phase, us for each decision, the largest first.
    """

    spent: dict[str, float]

    @property
    def total(self) -> float:
        """CPU time of a decision, us."""
        return sum(self.spent.values())

    def part(self, kind: str) -> float:
        """CPU time of a decision in phases of a ``kind``, :data:`LEARNING` or :data:`COLLECTING`, us."""
        return sum(cost for phase, cost in self.spent.items() if phase.startswith(kind))


def _spent(training: Training, batches: Batches, seconds: float) -> tuple[dict[str, float], int]:
    """Return the CPU seconds of each phase in so many ``seconds`` of training after the first batches, and its decisions."""
    training.learner.anneal(max(0.5, training.config.imitation))  # after imitation, if there is any
    try:
        for _ in range(WARM_UP):
            training.learner.learn(batches.take())
        count, end = 0, time.thread_time() + seconds
        with sampling() as spent:
            while time.thread_time() < end:
                training.learner.learn(batches.take())
                count += training.config.batch
    finally:
        batches.close()
        shut_down(batches.collector)
    return spent, count


def measure(config: PPOConfig, seconds: float, training_of: Callable[[PPOConfig, Path], Training] = Training) -> Profile:
    """Train for so many ``seconds`` of CPU time in a temporary folder, without imitation; see above.

    Args:
        config: What to train and how; where to collect, and evaluations, are left out.
        seconds: CPU time, without that of the first batches.
        training_of: Returns the training of a configuration in a folder; for constellations,
            :func:`bsk_torch.rl.marl.runs.training_of`.

    Raises:
        ValueError: If the environment does not fit the networks.
    """
    settings = dict(collector="single", workers=1, ahead=False, evaluate_every=0, patience=None, loggers=("csv",))
    config = dataclasses.replace(config, seconds=None, frames=10**12, **settings)  # type: ignore[arg-type]
    with one_thread(), tempfile.TemporaryDirectory() as folder:
        training = training_of(config, Path(folder) / "run")
        try:
            collector = make_collector(config, training.env, training.actor, None)
            spent, count = _spent(training, Batches(collector, False, lambda: None), seconds)
        finally:
            training.lock.release()
    ordered = sorted(spent.items(), key=lambda item: -item[1])
    return Profile({phase: 1e6 * cost / count for phase, cost in ordered})


def advice(profile: Profile) -> list[str]:
    """Return what to change: the largest phase, and what other cores can bring at most."""
    largest = next(iter(profile.spent))
    cheaper = next((setting for kind, setting in ADVICE.items() if largest.startswith(kind)), "")
    collecting, learning = profile.part(COLLECTING), profile.total - profile.part(COLLECTING)
    gains = [profile.total / (learning + collecting / workers) for workers in (2, 8)]
    return [
        f"largest part: {largest}" + (f"; less with {cheaper}" if cheaper else ""),
        f"learning, in one process: {learning / profile.total:.0%}; so workers=2 is at most {gains[0]:.1f} times as fast, "
        f"workers=8 {gains[1]:.1f} times, any number {profile.total / learning:.1f} times",
        "collector=multi workers=1 ahead=true, on two cores: at most "
        f"{profile.total / max(learning, collecting):.1f} times as fast",
    ]
