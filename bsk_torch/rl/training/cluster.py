"""A Ray cluster: connection and cores. Ray is imported only where a training uses it."""

from __future__ import annotations

import math
import os
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from urllib.parse import urlsplit

ADDRESS = "RAY_ADDRESS"
"""Environment variable with the address of the cluster, as Ray reads it."""

PORT = 6379
"""Ray's port where an address names none."""

PATIENCE = 10.0
"""Time within which the head node must answer, s; Ray waits for two minutes, and then ends the program."""


def check_ray() -> None:
    """Check that Ray can be used, before anything is built.

    Raises:
        ModuleNotFoundError: If it is not installed; the message names the command that installs it.
        ConnectionError: If the environment names a cluster that does not answer within :data:`PATIENCE`.
    """
    if find_spec("ray") is None:
        raise ModuleNotFoundError("collector='ray' needs Ray; pip install 'bsk_torch[ray]'", name="ray")
    address = os.environ.get(ADDRESS, "")
    if not address or address in ("auto", "local"):
        return
    try:
        parts = urlsplit(address if "://" in address else f"//{address}")
        socket.create_connection((parts.hostname or "", parts.port or PORT), PATIENCE).close()
    except (OSError, ValueError) as error:
        raise ConnectionError(
            f"the Ray cluster at {ADDRESS}={address} does not answer ({error}); start its head node with 'ray start --head "
            f"--port={PORT}' and the others with 'ray start --address=HOST:{PORT}', or unset {ADDRESS} to use this machine alone"
        ) from error


@contextmanager
def connected() -> Iterator[None]:
    """Be connected to the Ray cluster of the environment, or to a new one on this machine; ConnectionError if that fails."""
    import ray

    if ray.is_initialized():
        yield
        return
    check_ray()
    try:
        ray.init()
    except SystemExit as error:  # Ray ends the program if a cluster is lost while it connects
        raise ConnectionError(f"the Ray cluster does not answer (exit code {error.code})") from error
    try:
        yield
    finally:
        ray.shutdown()


def cluster_cores() -> list[int]:
    """Return the cores of every node, as many as it offers to Ray."""
    import ray

    return [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]


def share_of_core(workers: int, cores: Sequence[int]) -> float:
    """Return how much of a core each process may ask for, so that all fit on nodes with so many ``cores``.

    Ray would wait forever for cores that do not exist. Parts of a core are its units of 1e-4; 0 without any core.
    """
    if not any(cores):
        return 0.0
    return int(1e4 / math.ceil(workers / sum(cores))) / 1e4
