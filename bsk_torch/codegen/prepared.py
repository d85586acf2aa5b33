"""What the builds of all kernels have in common, prepared once in the folder of the cache, for GCC on Linux.

A kernel includes the headers of vector instructions, which are longer than the kernel, and is linked with torch's library of
400 MB for a few functions. Both take half of the time in which a tick is compiled. So the headers are precompiled, and the
linker gets an empty library of the name of torch's, which the process has loaded already when it loads a kernel. Instructions
are the same bit for bit. GCC ignores precompiled headers that do not fit it, and a build that fails is repeated without them.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import torch

from bsk_torch.codegen.cache import PRIVATE, build_folder, check_owner

logger = logging.getLogger(__name__)

HEADER = "standard.h"

INCLUDES = """#include <cmath>
#include <cstdint>
#include <limits>
#if defined(CPU_CAPABILITY_AVX512) || defined(CPU_CAPABILITY_AVX2)
#include <immintrin.h>
#include <sleef.h>
#else
#include <ATen/cpu/vec/vec.h>
#endif
"""
"""The headers of others that ``simd.h`` includes."""

LIBRARY = "torch_cpu"
"""The library of torch that kernels call."""

LINKED = ("-ltorch", "-ltorch_cpu", "-ltorch_python")
"""Options of inductor's in place of which kernels are linked with an empty library."""

FOLDERS = "prepared-"
"""How the names of folders begin in which headers and library are kept, 45 MB."""

UNUSED = 30 * 86400.0
"""Seconds after which a folder that was not used is removed: several compilers, or options, may share a cache."""

PAYS_FROM = 2
"""Kernels that a process has built in a folder when it prepares: one or two are built sooner without."""

_built: Counter[Path] = Counter()


def faster(command: Sequence[str], folder: Path, machine: str) -> list[str] | None:
    """Return a command that builds the same kernel in less time, or None where there is nothing prepared.

    Args:
        command: GCC and its arguments.
        folder: The folder of the cache.
        machine: Description of the processor, of which ``-march=native`` makes use.
    """
    if not sys.platform.startswith("linux"):
        return None
    headers = folder / f"{FOLDERS}{_key(tuple(command), machine)}"
    _built[folder] += 1
    if not headers.is_dir() and (_built[folder] <= PAYS_FROM or not _prepare(headers, tuple(command))):
        return None
    try:
        check_owner(headers)
        os.utime(headers)
    except PermissionError as error:
        logger.warning("precompiled headers are not used: %s", error)
        return None
    except FileNotFoundError:  # another process has emptied the cache
        return None
    rest = [word for word in command[1:] if word not in LINKED]
    linked = ("-Wl,--push-state,--no-as-needed", f"-l{LIBRARY}", "-Wl,--pop-state")
    return [command[0], f"-L{headers}", "-include", str(headers / HEADER), *rest, *linked]


@cache
def _key(command: tuple[str, ...], machine: str) -> str:
    """Return a name for what fits one compiler, its options, a version of torch and a processor."""
    compiler = Path(shutil.which(command[0]) or command[0])
    status = compiler.resolve().stat()
    described = [INCLUDES, torch.__version__, machine, *command, str(compiler.resolve()), str(status.st_mtime_ns)]
    return hashlib.sha256("\n".join(described).encode()).hexdigest()[:32]


def _last_use(folder: Path) -> float:
    """Return the time of the last build with a folder, s; now for one that is gone."""
    try:
        return folder.stat().st_mtime
    except FileNotFoundError:
        return time.time()


@cache
def _prepare(headers: Path, command: tuple[str, ...]) -> bool:
    """Precompile the headers and make the empty library; return whether they are there. It is tried once in a process."""
    options = [word for word in command[1 : command.index("-o")] if not word.endswith(".cpp")]
    header = [command[0], *options, "-x", "c++-header", HEADER, "-o", f"{HEADER}.gch"]
    empty = [command[0], "-shared", "-x", "c", os.devnull, f"-Wl,-soname,lib{LIBRARY}.so", "-o", f"lib{LIBRARY}.so"]
    with build_folder(headers.parent) as place:
        new = place / "new-headers"
        new.mkdir(mode=PRIVATE)
        (new / HEADER).write_text(INCLUDES)
        for step in (header, empty):
            run = subprocess.run(step, cwd=new, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
            if run.returncode:
                logger.info("headers are not precompiled: %s", run.stdout.strip())
                return False
        for old in headers.parent.glob(f"{FOLDERS}*"):  # of another compiler or version, which no process has used for long
            if old != headers and time.time() - _last_use(old) > UNUSED:
                shutil.rmtree(old, ignore_errors=True)
        try:
            new.rename(headers)
        except OSError:  # another process was faster
            return headers.is_dir()
    return True
