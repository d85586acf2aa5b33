"""Files replaced as a whole, so that no reader, crash or full disk ever leaves half of one."""

from __future__ import annotations

import os
import re
import secrets
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from math import isfinite
from pathlib import Path

PART = re.compile(r"\..+\.[0-9a-f]{16}\.part")
"""Names of files that :func:`write_file` has not moved into place yet."""


def write_file(path: Path | str, content: bytes | str) -> None:
    """Write a file, or replace the one of that name; the old one stays as it is if that fails.

    The content goes to a new file next to it with a name that cannot be foreseen, reaches the disk, then is moved. A symbolic
    link at ``path`` is replaced, and never followed: in a folder that others can write to, it could lead anywhere.

    Args:
        path: The file.
        content: Its content; text is encoded as UTF-8.

    Raises:
        OSError: If it cannot be written, such as on a full disk; the error names ``path``.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise OSError(f"{str(path)!r} cannot be written: it is no ordinary file")
    aside = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    try:
        _write_new(aside, content.encode() if isinstance(content, str) else content)
        os.replace(aside, path)
    except BaseException as error:
        with suppress(OSError):
            aside.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, f"cannot be written: {error.strerror}", str(path)) from error
        raise


def finite(values: Sequence[float]) -> list[float | None]:
    """Return numbers for JSON, with None for NaN and infinity, which JSON has not."""
    return [value if isfinite(value) else None for value in values]


def unwritable(folder: Path) -> str | None:
    """Return why no file can be made in a folder that exists, such as ``"... is read-only"``; None if one can.

    Permissions do not tell for the superuser, who has them in ``/proc`` and on file systems mounted read-only, so a file without
    a name is made, and removed.
    """
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"the folder {str(folder)!r} is read-only"
    try:
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return f"no file can be made in the folder {str(folder)!r} ({error.strerror})"


def _write_new(path: Path, content: bytes) -> None:
    """Write a file that must not exist, and wait for the disk."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    with open(os.open(path, flags, 0o666), "wb") as file:  # the umask applies
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def sweep(folder: Path) -> None:
    """Delete what :func:`write_file` has left in a folder where a process was killed; no other process may write there now."""
    for path in folder.iterdir():
        if PART.fullmatch(path.name):
            path.unlink(missing_ok=True)
