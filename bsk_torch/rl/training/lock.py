"""A run's folder is of one process at a time."""

from __future__ import annotations

import os
import socket
import stat
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from bsk_torch.files import sweep

LOCK = "run.lock"
"""File in a run folder while a process works there; names the process."""

WAIT = 0.5
"""Time to wait for a process that is about to end, s."""


class FolderInUseError(RuntimeError):
    """Another process works in the folder of a run."""


class FolderLock:
    """The right to work in a folder, until :meth:`release` or the end of the process, however it ends.

    The operating system releases the lock when a process dies; the file it left is reused.
    """

    def __init__(self, folder: Path) -> None:
        """Acquire the lock and delete partial files that a killed process left in the folder.

        Raises:
            FolderInUseError: If another process has it; the message names the process.
            OSError: If the folder cannot be written to, or the file of the lock leads elsewhere or belongs to someone else.
        """
        self.path = folder / LOCK
        with suppress(FileNotFoundError):
            _check(self.path, self.path.lstat())
        self._lock = FileLock(self.path, timeout=WAIT, thread_local=False)
        try:
            self._lock.acquire()
        except Timeout:
            raise FolderInUseError(f"{str(folder)!r} is in use by {_holder(self.path)}; wait for its end, or end it") from None
        try:
            _write(self.path, f"process {os.getpid()} on {socket.gethostname()} since {datetime.now():%Y-%m-%d %H:%M:%S}")
            sweep(folder)
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Give the lock back; more than once does no harm."""
        if self._lock.is_locked:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)  # while it is ours: who has opened it already sees that and opens the next one
            self._lock.release()


def _check(path: Path, status: os.stat_result) -> None:
    """Raise PermissionError for a file whose content may be someone's work: a link, or a file of another user."""
    kind = "a symbolic link" if stat.S_ISLNK(status.st_mode) else "no ordinary file"
    if stat.S_ISREG(status.st_mode):
        is_foreign = hasattr(os, "geteuid") and status.st_uid != os.geteuid()
        if status.st_nlink == 1 and not is_foreign:
            return
        kind = f"a file of user {status.st_uid}" if is_foreign else f"a hard link, one of {status.st_nlink} names of a file"
    raise PermissionError(f"{str(path)!r} is {kind}, and is not overwritten; delete it if no process works in the folder")


def _write(path: Path, text: str) -> None:
    """Replace the content of the file; what it is, is checked on the opened one, which no one can exchange."""
    with open(os.open(path, os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0)), "w", encoding="utf-8") as file:
        _check(path, os.fstat(file.fileno()))
        file.truncate()
        file.write(text)


def _holder(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")[:200] or "another process"
    except OSError:
        return "another process"
