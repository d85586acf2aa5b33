"""Kernels whose source is kept in the folder of the cache, so that no process traces and prints them again.

Tracing takes most of the time in which an environment is built. What a function traces from its arguments alone changes only with
the source of the package, whose hash the file begins with.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path

import torch

from bsk_torch.codegen.build import processor
from bsk_torch.codegen.cache import PRIVATE, build_folder, cache_folder, check_owner, read_trusted
from bsk_torch.codegen.kernel import Kernel, Printed

PARTS = ("astro", "codegen", "sim")
"""What kernels are traced from, with the modules next to these; imports run one way, so that nothing else can change them."""

SEAL = hashlib.sha256().digest_size
"""Bytes of the hash at the beginning of a file."""


@cache
def source_hash() -> bytes:
    """Return a hash of source and tables of the :data:`PARTS`, and of what else traces depend on."""
    total = hashlib.sha256("\n".join([sys.version, torch.__version__, processor()]).encode())
    folder = Path(__file__).parents[1]
    files = [*folder.glob("*.py"), *(path for part in PARTS for path in (folder / part).rglob("*.*"))]
    for path in sorted(files):
        if path.suffix != ".pyc":
            total.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return total.digest()


def stored_kernel(make: Callable[..., Kernel]) -> Callable[..., Kernel]:
    """Return ``make``, which returns a kernel without a stop, with files of its kernels; a process keeps those that it has made.

    ``make`` is defined in :data:`PARTS`. Nothing but their source, and its arguments, which name the file, may decide the result.
    """

    @cache
    @wraps(make)
    def kernel(*args: object) -> Kernel:
        path = cache_folder() / f"{'-'.join([make.__module__, make.__name__, *map(str, args)])}.json"
        if (read := _read(path)) is not None:
            return Kernel(*read)
        made = make(*args)
        with suppress(OSError):  # the next process traces it, too
            _write(path, made)
        return made

    return kernel


def _seal(content: bytes) -> bytes:
    return hashlib.sha256(source_hash() + content).digest()


def _read(path: Path) -> tuple[str, Printed] | None:
    """Return name and source of a kernel; None for a file that is missing, damaged, not to be trusted, or of another source."""
    if not path.parent.exists():
        return None
    check_owner(path.parent)
    file = read_trusted(path) or b""
    if file[:SEAL] != _seal(file[SEAL:]):
        return None
    name, *printed = json.loads(file[SEAL:])
    return name, Printed(*printed)


def _write(path: Path, kernel: Kernel) -> None:
    """Put name and source of a kernel into a file, at once: several processes may do so."""
    assert isinstance(kernel.loop, Printed)
    content = json.dumps([kernel.name, *kernel.loop]).encode()
    with build_folder(path.parent) as folder:
        file = folder / path.name
        file.write_bytes(_seal(content) + content)
        file.chmod(PRIVATE)  # whatever the umask is
        os.replace(file, path)
