"""Progress of a training: its budget, a progress bar, and interruption by Ctrl-C."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from bsk_torch.rl.training.config import PPOConfig

logger = logging.getLogger(__name__)


def check_progress_bar() -> None:
    """Raise ModuleNotFoundError, naming the command that installs it, if tqdm is missing."""
    if find_spec("tqdm") is None:
        raise ModuleNotFoundError("training shows a progress bar of tqdm; pip install 'bsk_torch[train]'", name="tqdm")


class Progress:
    """Used part of a training's budget; the clock starts with :meth:`start`."""

    def __init__(self, config: PPOConfig) -> None:
        """Count towards the limits of ``config``."""
        self.config, self.frames, self.before, self.begin = config, 0, 0.0, time.perf_counter()

    def start(self) -> None:
        """Start the clock."""
        self.begin = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Training time, s, with that of the part before an interruption."""
        return self.before + time.perf_counter() - self.begin

    @property
    def fraction(self) -> float:
        """Used part of the budget, 1 at the end."""
        used = (self.seconds, self.config.seconds), (self.frames, self.config.frames)
        return min(1.0, max(amount / limit for amount, limit in used if limit is not None))

    @property
    def left(self) -> float:
        """Expected time to the end, s; infinite before the first iteration."""
        used = self.fraction
        return self.seconds * (1.0 - used) / used if used else float("inf")


def progress_bar() -> Any:
    """Return a bar of tqdm that :func:`show` moves."""
    from tqdm import tqdm

    return tqdm(total=100, desc="training", unit="%", bar_format="{desc} {percentage:3.0f}% |{bar}| {elapsed}{postfix}")


def show(bar: Any, progress: Progress, row: Mapping[str, float]) -> None:
    """Move the bar, and show the figures of a row of the log."""
    bar.n = round(100.0 * progress.fraction, 1)
    bar.set_postfix_str(
        f"{bar.format_interval(progress.left)} left, {row['frames'] / row['seconds']:,.0f} frames/s, "
        f"{row['simulated_days'] / row['seconds']:.1f} simulated days/s, "
        f"return {row['return']:.3f}, survival {row['survival']:.0%}"
    )


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
