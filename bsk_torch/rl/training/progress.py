"""Progress of a training: its budget, a progress bar, and interruption by Ctrl-C."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import rich.progress
from rich.console import Console, RenderableType
from rich.progress import BarColumn, TaskProgressColumn, TextColumn
from rich.text import Text

from bsk_torch.rl.training.config import PPOConfig

logger = logging.getLogger(__name__)


class Progress:
    """Used part of a training's budget; the clock starts with :meth:`start`."""

    def __init__(self, config: PPOConfig) -> None:
        """Count toward the limits of ``config``."""
        self.config, self.frames, self.before, self.begin = config, 0, 0.0, time.perf_counter()
        self.cpu_before, self.cpu_begin = 0.0, time.process_time()

    def start(self) -> None:
        """Start the clocks."""
        self.begin, self.cpu_begin = time.perf_counter(), time.process_time()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Let the clocks stand still."""
        begin, cpu_begin = time.perf_counter(), time.process_time()
        yield
        self.begin += time.perf_counter() - begin
        self.cpu_begin += time.process_time() - cpu_begin

    @property
    def seconds(self) -> float:
        """Training time, s, with that of the part before an interruption."""
        return self.before + time.perf_counter() - self.begin

    @property
    def cpu_seconds(self) -> float:
        """CPU time of this process, s, likewise."""
        return self.cpu_before + time.process_time() - self.cpu_begin

    @property
    def record(self) -> dict[str, int | float]:
        """What the training has cost so far, for the file of its policy.

        ``core_seconds`` are the CPU time of this process, with evaluations; each other process counts as busy all the time.
        """
        others = self.config.processes * self.seconds if self.config.collector != "single" else 0.0
        return {
            "decisions": self.frames,
            "core_seconds": round(self.cpu_seconds + others, 1),
            "tuning_runs": self.config.tuning_runs,
        }

    @property
    def fraction(self) -> float:
        """Used part of the budget, 1 at the end."""
        budgets = (self.seconds, self.config.clock), (self.frames, self.config.frames)
        return min(1.0, max(amount / limit for amount, limit in budgets if limit is not None))

    @property
    def remaining(self) -> float:
        """Expected time to the end, s; infinite before the first iteration."""
        fraction = self.fraction
        return self.seconds * (1.0 - fraction) / fraction if fraction else float("inf")


class TrainingBar(rich.progress.Progress):
    """A bar of the used budget, and below it the means over the episodes that ended last.

    Where the standard error is neither a terminal nor a notebook, the same is logged after each tenth of the budget.
    """

    def __init__(self, shown: bool = True) -> None:
        """Show nothing unless ``shown``."""
        columns = TextColumn("training"), BarColumn(None), TaskProgressColumn(), TextColumn("{task.fields[speed]}")
        self.means, self.tenths = Text("waiting for the first episodes to end"), 0
        console = Console(stderr=True)
        self.is_seen = console.is_terminal or console.is_jupyter
        super().__init__(*columns, console=console, expand=True, disable=not (shown and self.is_seen))
        self.task = self.add_task("", total=1.0, speed="")

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yield the lines that are shown."""
        yield self.make_tasks_table(self.tasks)
        yield self.means

    def show(self, progress: Progress, row: Mapping[str, float], count: int) -> None:
        """Show the figures of a row of the log, whose means are over ``count`` episodes."""
        speed = f"{duration(progress.remaining)} left, {row['frames'] / row['seconds']:,.0f} decisions/s"
        self.update(self.task, completed=progress.fraction, speed=speed)
        if count:
            self.means = Text(f"last {count:,} episodes: return {row['return']:.3f}, survival {row['survival']:.0%}")
        if not self.is_seen and int(10.0 * progress.fraction) > self.tenths:
            self.tenths = int(10.0 * progress.fraction)
            logger.info("training %.0f%%, %s; %s", 100.0 * progress.fraction, speed, self.means)


def duration(seconds: float) -> str:
    """Return a time as people write it, such as 2:05 or 1:00:00."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


@contextmanager
def unbroken() -> Iterator[None]:
    """Leave out what TorchRL logs at level INFO, such as the sizes of its buffers: it would break the bar."""
    torchrl = logging.getLogger("torchrl")
    before = torchrl.level
    torchrl.setLevel(logging.WARNING)
    try:
        yield
    finally:
        torchrl.setLevel(before)


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """An event that Ctrl-C sets, so that an iteration is finished and kept; a second Ctrl-C stops at once."""
    stop = threading.Event()

    def ask(number: int, frame: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        logger.info("finishing this iteration to keep it; Ctrl-C again stops at once")

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = signal.signal(signal.SIGINT, ask)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
