"""Starts scripts and processes that collect without the seconds in which each would import torch.

The fork server of the standard library imports the libraries once; each script runs in a fork of it, as ``__main__``.
"""

import multiprocessing
import os
import runpy
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import forkserver, get_context
from pathlib import Path

LIBRARIES = ["torchrl.collectors", "torchrl.objectives", "matplotlib.pyplot", "bsk_torch.cli", "bsk_torch.rl.training.collect"]
"""What the fork server imports: modules that scripts import, and that start no threads and read no changing settings."""

SERVER = get_context("forkserver")
SERVER.set_forkserver_preload(LIBRARIES)


def server_seconds() -> float:
    """CPU seconds of the fork server and of its processes that have ended, which are no children of the tests' process."""
    server = forkserver._forkserver._forkserver_pid
    if server is None or not Path(f"/proc/{server}/stat").exists():
        return 0.0
    times = Path(f"/proc/{server}/stat").read_text().rpartition(")")[2].split()[11:15]
    return sum(map(int, times)) / os.sysconf("SC_CLK_TCK")


def run_script(script: Path, *arguments: str, folder: Path, environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a script of Python in a folder, with additions to the environment; returns its exit status and what it wrote."""
    files = folder / "stdout.txt", folder / "stderr.txt"
    forkserver.ensure_running()
    address = forkserver._forkserver._forkserver_address
    process = SERVER.Process(target=_play, args=(address, script, arguments, folder, dict(environment), *files))
    process.start()
    process.join()
    written = [file.read_text() if file.exists() else "" for file in files]
    for file in files:
        file.unlink(missing_ok=True)
    assert process.exitcode is not None
    return subprocess.CompletedProcess([str(script), *arguments], process.exitcode, *written)


@contextmanager
def forked_processes() -> Iterator[None]:
    """Let TorchRL start its processes as forks of the server, in place of new interpreters."""
    method = multiprocessing.get_start_method(allow_none=True)
    multiprocessing.set_start_method("forkserver", force=True)
    try:
        yield
    finally:
        multiprocessing.set_start_method(method, force=True)


def _play(
    address: str, script: Path, arguments: tuple[str, ...], folder: Path, environment: dict[str, str], *files: Path
) -> None:
    for number, file in enumerate(files, start=1):
        sys.stdout.flush() if number == 1 else sys.stderr.flush()
        os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    os.chdir(folder)
    os.environ.update(environment)
    sys.path[:0] = [str(script.parent), *environment.get("PYTHONPATH", "").split(os.pathsep)]
    sys.argv = [str(script), *arguments]
    multiprocessing.set_start_method("forkserver", force=True)
    server = forkserver._forkserver  # the script's own processes are forks of the same server, not of another one
    server._forkserver_address, server.ensure_running = address, lambda: None
    runpy.run_path(str(script), run_name="__main__")
