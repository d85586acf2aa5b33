"""Starts scripts as programs of their own, without the seconds in which each would import torch.

The fork server of the standard library imports the libraries once; each script runs in a fork of it, as ``__main__``.
"""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import time
from collections.abc import Mapping
from multiprocessing import get_context
from pathlib import Path

LIBRARIES = ["torchrl.collectors", "torchrl.objectives", "matplotlib.pyplot", "bsk_torch", "bsk_torch.cli", "bsk_torch.rl"]
"""What the fork server imports: modules that scripts import, and that start no threads and read no changing settings."""

WALL: list[float] = []
"""Seconds that each script has taken; the CPU time of the fork server's processes is not that of the tests."""

SERVER = get_context("forkserver")
SERVER.set_forkserver_preload(LIBRARIES)


def run_script(script: Path, *arguments: str, folder: Path, environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a script of Python in a folder, with additions to the environment; returns its exit status and what it wrote."""
    files = folder / "stdout.txt", folder / "stderr.txt"
    begin = time.perf_counter()
    process = SERVER.Process(target=_play, args=(script, arguments, folder, dict(environment), *files))
    process.start()
    process.join()
    WALL.append(time.perf_counter() - begin)
    written = [file.read_text() if file.exists() else "" for file in files]
    for file in files:
        file.unlink(missing_ok=True)
    assert process.exitcode is not None
    return subprocess.CompletedProcess([str(script), *arguments], process.exitcode, *written)


def _play(script: Path, arguments: tuple[str, ...], folder: Path, environment: dict[str, str], *files: Path) -> None:
    for number, file in enumerate(files, start=1):
        sys.stdout.flush() if number == 1 else sys.stderr.flush()
        os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    os.chdir(folder)
    os.environ.update(environment)
    sys.path[:0] = [str(script.parent), *environment.get("PYTHONPATH", "").split(os.pathsep)]
    sys.argv = [str(script), *arguments]
    runpy.run_path(str(script), run_name="__main__")
