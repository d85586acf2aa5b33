"""Texts of strangers: a file or the text itself, bounded, by line."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, NoReturn

from bsk_torch.untrusted import one_line, read_bytes

MOST_BYTES = 2**26
"""Largest file of orbits, bytes: the public catalog of 30,000 objects is 5 MB as two-line sets, and 45 MB as XML."""


class Source(NamedTuple):
    """A text and what messages call it."""

    title: str
    text: str

    def fail(self, line: int | None, problem: str) -> NoReturn:
        """Raise the ValueError about a line, counted from 1, or the whole text."""
        where = self.title if line is None else f"{self.title}, line {line}"
        raise ValueError(one_line(f"{where}: {problem}"))


def read_source(source: str | Path) -> Source:
    """Return the text of a file, or a text itself, which is a string with a line break or an opening bracket of JSON or XML.

    Raises:
        OSError: If the file cannot be read.
        TypeError: For anything but a string or path.
        ValueError: If it is empty, too large, or not UTF-8.
    """
    if not isinstance(source, str | Path):
        raise TypeError(f"source={source!r} must be the path of a file, or its text")
    if isinstance(source, str) and ("\n" in source or source.lstrip()[:1] in ("<", "{", "[")):
        document = Source("the text", source)
        size = len(source)
    else:
        title = repr(str(source))
        try:
            content = read_bytes(source, MOST_BYTES)
            document = Source(title, content.decode("utf-8-sig"))
        except UnicodeDecodeError as error:
            raise ValueError(f"{title} is no text: byte {error.start:,} is not UTF-8") from None
        except ValueError as error:
            raise ValueError(one_line(f"{title}: {error}")) from None
        size = len(content)
    if size > MOST_BYTES:
        document.fail(None, f"it has more than {MOST_BYTES:,} bytes")
    if not document.text.strip():
        document.fail(None, "it is empty")
    return document
