"""The folder in which compiled kernels are kept: where it is, whom it may belong to, and what a killed build leaves in it.

A library from the folder runs with all rights of the user, and the hash at its end only tells whether it is complete and has its
own name: whoever can write a library can write the hash, too. So folder and libraries must belong to the user, or to root, and
must not be writable by others; links are not followed. New folders are open to their owner only.
"""

from __future__ import annotations

import logging
import os
import shlex
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import platformdirs

POSIX = os.name == "posix"
"""Elsewhere folders of users have no such owners and modes, and files no such locks."""

if POSIX:
    import fcntl

logger = logging.getLogger(__name__)

VARIABLE = "BSK_TORCH_CACHE"

BUILDS = "build-"
"""How the names of folders in which a kernel is being built begin."""

LOCK = "lock"
"""File in such a folder that the building process has locked for as long as it lives."""

UNLOCKED_FOR = 3600.0
"""Age in seconds from which such a folder without a lock is an old one: its process has had the time to take the lock."""

ROOT = 0

PRIVATE = 0o700
"""Mode of folders and libraries made here."""


def cache_folder() -> Path:
    """Return the absolute path of the folder of the cache: that of ``BSK_TORCH_CACHE``, or the user's own one."""
    setting = os.environ.get(VARIABLE)
    return Path(os.path.abspath(Path(setting).expanduser())) if setting else platformdirs.user_cache_path("bsk_torch")


def check_owner(folder: Path) -> None:
    """Raise PermissionError for a cache that others own or may write to; close the user's own one to others."""
    status = folder.stat()
    if complaint := _complaint(status):
        if not os.environ.get(VARIABLE) and not _foreign(status):  # made under a lenient umask
            folder.chmod(PRIVATE)
            return
        is_own = POSIX and status.st_uid == os.geteuid() and not status.st_mode & stat.S_ISVTX
        advice = f", or run chmod go-w {shlex.quote(str(folder))} if it is yours alone" if is_own else ""
        raise PermissionError(
            f"the kernel cache {folder} {complaint}, and libraries placed there by others would run with your permissions; let "
            f"{VARIABLE} name a folder that only you can write to{advice}"
        )


def read_trusted(path: Path) -> bytes | None:
    """Return the content of a library in the cache; None if there is none, or one that others may have put there."""
    try:
        file = os.open(path, os.O_RDONLY | sum(getattr(os, flag, 0) for flag in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY")))
    except FileNotFoundError:
        return None
    except OSError as error:  # a link, for example
        logger.warning("%s is not used and will be built again: %s", path, error)
        return None
    try:
        status = os.fstat(file)
        if complaint := "is no ordinary file" if not stat.S_ISREG(status.st_mode) else _complaint(status):
            logger.warning("%s %s; it is not used and will be built again", path, complaint)
            return None
        with open(file, "rb", closefd=False) as stream:
            return stream.read()
    finally:
        os.close(file)


def _foreign(status: os.stat_result) -> bool:
    return POSIX and status.st_uid not in (os.geteuid(), ROOT)


def _complaint(status: os.stat_result) -> str:
    """Return what is wrong with owner and mode of a folder or file; nothing where only the user or root can change it."""
    if _foreign(status):
        return f"belongs to user {status.st_uid}, not to you ({os.geteuid()})"
    if POSIX and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"may be written to by other users (mode {stat.S_IMODE(status.st_mode):04o})"
    return ""


# -- folders of builds ---------------------------------------------------------------------------------------------------------


@contextmanager
def build_folder(parent: Path) -> Iterator[Path]:
    """Make a build folder, deleted at the end, or by :func:`sweep` if this process is killed."""
    with tempfile.TemporaryDirectory(dir=parent, prefix=BUILDS) as name, open(Path(name, "new"), "wb") as lock:
        if POSIX:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.rename(lock.name, Path(name, LOCK))  # under this name it has been locked from the first moment on
        yield Path(name)


@cache
def sweep(parent: Path) -> None:
    """Delete the folders of builds whose processes are dead, once in a process; the system has released their locks."""
    for path in parent.glob(f"{BUILDS}*"):
        with suppress(OSError):
            if not _is_locked(path):
                logger.info("deleting %s, left by a killed build", path)
                shutil.rmtree(path)


def _is_locked(path: Path) -> bool:
    """Return whether the process that builds in a folder is, or may be, alive."""
    if not POSIX or not (path / LOCK).exists():
        return time.time() - path.stat().st_mtime < UNLOCKED_FOR
    with open(path / LOCK, "rb") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
