"""Processes that collect experience: how many there should be, and which of them was killed."""

from __future__ import annotations

import dataclasses
import logging
import os
import signal
from multiprocessing.connection import wait
from typing import NamedTuple

from torchrl.collectors import BaseCollector

from bsk_torch.rl.training.cluster import cluster_cores, connected
from bsk_torch.rl.training.config import AUTO, Config, PPOConfig

logger = logging.getLogger(__name__)

SMALLEST_SHARE = 32
"""Least number of episodes of a process that ``workers="auto"`` chooses: with fewer, a step takes nearly as long."""

DYING = 0.5
"""Time to wait for the end of a process whose connection is broken, s."""

HINTS: dict[int, str] = {
    signal.SIGKILL: "memory is full",
    signal.SIGBUS: "the shared memory in /dev/shm is full",
}
"""Usual causes of signals."""


class Cores(NamedTuple):
    """Number of cores that can be used, and what they are."""

    number: int
    description: str


def available_cores() -> Cores:
    """Return the cores that this process may use: those of its affinity, or all where the system knows no affinity."""
    number = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Cores(number, f"{number} available core{'s' * (number > 1)}")


def with_workers(config: Config) -> Config:
    """Return a configuration with a number of processes in place of ``workers="auto"``, and tell which and why.

    As many processes as there are cores, without the learner's if it works at the same time (``ahead``), but a divisor of
    ``num_envs`` and at least :data:`SMALLEST_SHARE` episodes each. One process is none in addition to the learner, unless the
    configuration names a collector. ConnectionError if the Ray cluster that the configuration asks for cannot be reached.
    """
    if config.workers != AUTO:
        return config
    cores = _cores(config)
    most = min(max(1, cores.number - config.ahead), max(1, config.num_envs // SMALLEST_SHARE))
    workers = next(count for count in range(most, 0, -1) if config.num_envs % count == 0)
    collector = config.collector
    if collector == "single" and (workers > 1 or config.ahead):
        collector = "multi"
    logger.info(
        "workers=auto: collector=%s workers=%d, for %s%s and num_envs=%d in processes of at least %d%s",
        collector,
        workers,
        cores.description,
        ", of which the learner takes one" if config.ahead else "",
        config.num_envs,
        SMALLEST_SHARE,
        "" if config.ahead or workers == 1 else "; with ahead=true they would also collect while the learner learns",
    )
    return dataclasses.replace(config, collector=collector, workers=workers)


def _cores(config: PPOConfig) -> Cores:
    if config.collector != "ray":
        return available_cores()
    with connected():
        number = sum(cluster_cores())
    return Cores(number, f"{number} cores of the Ray cluster")


def warn_of_few_cores(config: PPOConfig) -> None:
    """Log a warning if more processes of this machine collect than there are cores."""
    if config.collector == "multi" and config.processes > (cores := available_cores()).number:
        logger.warning(
            "workers=%d is more than %s: the processes share them; workers=%d is as fast and needs less memory",
            config.processes,
            cores.description,
            max(count for count in range(1, cores.number + 1) if config.num_envs % count == 0),
        )


def lost_process(collector: BaseCollector | None) -> str | None:
    """Return which process of this machine was killed and by what, None if none was.

    Args:
        collector: Of several processes or not; None if it could not start.
    """
    processes = getattr(collector, "procs", ())
    running = {k: process for k, process in enumerate(processes) if not process._closed}  # TorchRL closes those that it ended
    wait([process.sentinel for process in running.values()], DYING)
    codes = {k: process.exitcode for k, process in running.items() if (process.exitcode or 0) < 0}
    if not codes:
        return None
    k = min(codes, key=lambda k: codes[k] == -signal.SIGTERM)  # by which TorchRL ends the others
    by = signal.Signals(-codes[k])
    hint = f" (usually: {HINTS[by]})" if by in HINTS else ""
    return f"process {k} of {len(processes)} was ended by {by.name}{hint}"
