"""Policy and checkpoint files: torch's format followed by a checksum, which detects damage.

The checksum is the SHA-256 of all preceding bytes. It detects damage but does not prove the origin, since anyone can compute it.
Nothing in a file is executed; torch reads only tensors and plain values.
"""

from __future__ import annotations

import hashlib
import io
import logging
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from bsk_torch.files import write_file
from bsk_torch.untrusted import read_tensors

logger = logging.getLogger(__name__)

CHECKSUM_MARK = b"\nbsk_torch SHA-256:"
"""Marks the checksum at the end of a file. ``torch.load`` also reads such files, without checking it."""

RECORD, VERSION = "archive/bsk_torch_format", b"2"
"""Entry of the archive in files with a checksum, and its content. Files of release 0.1 have neither."""


def save_checksummed(path: Path, entries: Mapping[str, object]) -> None:
    """Write a dictionary of tensors and plain values; see :func:`~bsk_torch.files.write_file` for errors."""
    buffer = io.BytesIO()
    torch.save(dict(entries), buffer)
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr(zipfile.ZipInfo(RECORD), VERSION)
    content = buffer.getvalue()
    write_file(path, content + CHECKSUM_MARK + hashlib.sha256(content).digest())


def is_checksummed(path: Path) -> bool:
    """Return whether a file ends as those of :func:`save_checksummed`."""
    if not path.is_file():
        return False
    with open(path, "rb") as file:
        file.seek(-min(path.stat().st_size, len(CHECKSUM_MARK) + hashlib.sha256().digest_size), 2)
        return file.read().startswith(CHECKSUM_MARK)


def load_checksummed(path: Path, what: str, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read a file of :func:`save_checksummed`; files of release 0.1, which lack a checksum, are read with a warning.

    Args:
        path: The file.
        what: Kind of the file in messages, such as ``"policy"``.
        device: Device of the tensors.

    Raises:
        ValueError: For a damaged or truncated file, or one of another kind; the message names it.
    """
    content = path.read_bytes()
    body = len(content) - len(CHECKSUM_MARK) - hashlib.sha256().digest_size
    has_checksum = body > 0 and content[body:].startswith(CHECKSUM_MARK)
    if has_checksum and hashlib.sha256(content[:body]).digest() != content[body + len(CHECKSUM_MARK) :]:
        raise ValueError(f"{str(path)!r} is a damaged {what}: its checksum does not fit its content")
    try:
        entries, version = read_tensors(content[:body] if has_checksum else content, RECORD, device)
    except ValueError as error:
        raise ValueError(f"{str(path)!r} is no file of a {what}: {error}") from error
    if not has_checksum and version is not None:
        raise ValueError(f"{str(path)!r} is a damaged {what}: the checksum at its end is missing")
    if version not in (None, VERSION):
        raise ValueError(f"{str(path)!r} is a {what} of format {version!r}; this version of bsk_torch reads {VERSION!r}")
    if not isinstance(entries, dict):
        raise ValueError(f"{str(path)!r} is no file of a {what}: it holds a {type(entries).__name__}")
    if not has_checksum:
        logger.warning("%s has no checksum, as in release 0.1: damage may go unnoticed", path)
    return entries
