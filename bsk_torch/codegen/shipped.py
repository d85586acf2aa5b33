"""Kernels built on one machine for others without a compiler.

:func:`building` makes every kernel needed within it, for a named set of instructions of x86-64 processors instead of this
very processor, and puts it into a folder. Where ``BSK_TORCH_KERNELS`` names such folders, :func:`find` looks there first. The
name of a library is a hash of its source, of torch's version, of the compiler's options and of the instructions, so that a folder
can hold kernels of several versions, and one that does not fit is never found. Owner and mode are checked as in the cache.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import NamedTuple

import torch

from bsk_torch.codegen.cache import check_owner

VARIABLE = "BSK_TORCH_KERNELS"

LEVELS = {"avx512": "x86-64-v4", "avx2": "x86-64-v3", "default": "x86-64"}
"""Values of ``BSK_TORCH_ISA``, best first, and what GCC and clang call these instructions.

Every processor that torch calls capable of them has these.
"""

NARROWER = ("-march=", "-mcpu=", "-mtune=", "-mavx", "-mamx", "-mfma")
"""How options begin that choose the instructions of one processor."""

READABLE = 0o755
"""Mode of folders and libraries made here: other users may run them."""


class Target(NamedTuple):
    """Where shipped kernels are put, and for which instructions."""

    folder: Path
    isa: str


BUILDING: ContextVar[Target | None] = ContextVar("BUILDING", default=None)


def can_run() -> list[str]:
    """Return the names of :data:`LEVELS` whose instructions this processor has, best first; none if it is no x86-64."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return []
    names = list(LEVELS)
    capability = torch.backends.cpu.get_cpu_capability().lower()
    return names[names.index(capability) :] if capability in names else names[-1:]


@contextmanager
def building(folder: Path, isa: str | None = None) -> Iterator[Target]:
    """Put all kernels needed within this context, and not yet loaded by this process, into a folder.

    Args:
        folder: Made if it is missing; for :data:`VARIABLE` of other machines.
        isa: Instructions, a name of :data:`LEVELS` (default: the best that this processor has).

    Raises:
        ValueError: For instructions that this processor does not have, or processors other than x86-64.
        PermissionError: If others own the folder or may write to it.
    """
    able = can_run()
    if not able:
        raise ValueError(f"kernels for other machines can be built on x86-64 processors only, not on {platform.machine()}")
    isa = isa or able[0]
    if isa not in able:
        raise ValueError(f"isa={isa!r} must be one of {able}: kernels are loaded where they are built")
    target = Target(Path(os.path.abspath(folder)), isa)
    target.folder.mkdir(mode=READABLE, parents=True, exist_ok=True)
    check_owner(target.folder)
    token = BUILDING.set(target)
    try:
        yield target
    finally:
        BUILDING.reset(token)


def library_name(parts: Sequence[str], isa: str) -> str:
    """Return the file name of a kernel from what it is made of, without anything of this very processor."""
    described = [*parts, sys.platform, platform.machine(), LEVELS[isa]]
    return f"{isa}-{hashlib.sha256(chr(10).join(described).encode()).hexdigest()[:32]}.so"


def portable(command: Sequence[str], isa: str) -> list[str]:
    """Return a compiler's command with the instructions of a level in place of this processor's."""
    return [command[0], f"-march={LEVELS[isa]}", *(part for part in command[1:] if not part.startswith(NARROWER))]


def candidates(parts: Sequence[str], isas: Sequence[str]) -> list[Path]:
    """Return the files that may hold a kernel for one of the instructions, in the folders that :data:`VARIABLE` names.

    Raises:
        FileNotFoundError: For a folder that does not exist.
        PermissionError: For one that others own or may write to.
    """
    setting = os.environ.get(VARIABLE)
    if not setting:
        return []
    folders = [Path(os.path.abspath(Path(name).expanduser())) for name in setting.split(os.pathsep) if name]
    for folder in folders:
        if not folder.is_dir():
            raise FileNotFoundError(f"{VARIABLE} names the folder {folder}, which does not exist")
        check_owner(folder)
    return [folder / library_name(parts, isa) for isa in isas for folder in folders]
