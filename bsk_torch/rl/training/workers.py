"""Processes that collect experience: how many there should be, and which of them were lost."""

from __future__ import annotations

import dataclasses
import logging
import math
import os
import signal
from collections.abc import Iterator
from multiprocessing.connection import wait
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from torchrl.collectors import BaseCollector

from bsk_torch.rl.training.cluster import cluster_cores, connected, lost_actor
from bsk_torch.rl.training.config import AUTO, Config, PPOConfig

logger = logging.getLogger(__name__)

SMALLEST_SHARE = 32
"""Least number of episodes of a process that ``workers="auto"`` chooses: with fewer, a step takes nearly as long."""

QUOTAS = (("", "cpu.max"), ("cpu", "cpu.cfs_quota_us"), ("cpu,cpuacct", "cpu.cfs_quota_us"))
"""Folders in ``/sys/fs/cgroup`` and files with the CPU quota: control groups of version 2, then of version 1."""

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
    told: str


def available_cores(root: Path = Path("/")) -> Cores:
    """Return the cores that this process may use: those of its affinity, fewer with a CPU quota of its control groups.

    Args:
        root: Folder with ``proc`` and ``sys``.
    """
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = min(_quotas(root), default=math.inf)
    if quota < allowed:
        return Cores(max(1, int(quota)), f"a CPU quota of {quota:g} cores (control group)")
    return Cores(allowed, f"{allowed} available core{'s' * (allowed > 1)}")


def _quotas(root: Path) -> Iterator[float]:
    """Yield the quotas, in cores, of the control groups of this process and of those that contain them."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:  # not Linux
        return
    groups = {name: group for _, names, group in (line.split(":", 2) for line in lines) for name in {names, *names.split(",")}}
    for controller, file in QUOTAS:
        group = PurePosixPath(groups.get(controller, "/").lstrip("/"))
        for folder in (group, *group.parents):
            yield from _quota(root / "sys/fs/cgroup" / controller / folder / file)


def _quota(path: Path) -> Iterator[float]:
    """Yield the quota in a file, in cores, if there is one."""
    try:
        words = path.read_text().split()
        period = words[1] if len(words) > 1 else path.with_name("cpu.cfs_period_us").read_text()
    except OSError:
        return
    if words[0] not in ("max", "-1"):
        yield int(words[0]) / int(period)


def with_workers(config: Config) -> Config:
    """Return a configuration with a number of processes in place of ``workers="auto"``, and tell which and why.

    As many processes as there are cores, without the learner's if it works at the same time (``ahead``), but a divisor of
    ``num_envs`` and at least :data:`SMALLEST_SHARE` episodes each. One process is none in addition to the learner, unless the
    configuration names a collector.

    Raises:
        ConnectionError: If the Ray cluster that the configuration asks for cannot be reached.
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
        cores.told,
        ", of which the learner takes one" if config.ahead else "",
        config.num_envs,
        SMALLEST_SHARE,
        "" if config.ahead or workers == 1 else "; with ahead=true they would also collect while the learner learns",
    )
    return dataclasses.replace(config, collector=collector, workers=workers)


def _cores(config: PPOConfig) -> Cores:
    """Return the cores of the machine or the cluster that collects."""
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
            cores.told,
            max(count for count in range(1, cores.number + 1) if config.num_envs % count == 0),
        )


class WorkerLostError(RuntimeError):
    """A process that collects was killed, or its machine is gone; the code in it did not fail."""


def lost_worker(collector: BaseCollector | None, error: Exception) -> str | None:
    """Return which process was lost and why; None if an ``error`` has another cause, such as code that failed.

    Without a collector, because it could not start, only the processes of a Ray cluster are known.
    """
    processes = getattr(collector, "procs", None)
    if processes is None:
        return lost_actor(error)
    left = {k: process for k, process in enumerate(processes) if not process._closed}  # TorchRL closes those that it ended
    wait([process.sentinel for process in left.values()], DYING)
    codes = {k: process.exitcode or 0 for k, process in left.items()}
    killed = [k for k, code in codes.items() if code < 0]
    if not killed:
        return None
    k = min(killed, key=lambda k: codes[k] == -signal.SIGTERM)  # by which TorchRL ends the others
    by = signal.Signals(-codes[k])
    hint = f" (usually: {HINTS[by]})" if by in HINTS else ""
    return f"process {k} of {len(processes)} that collects was ended by {by.name}{hint}"
