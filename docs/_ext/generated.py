"""Replaces ``<!-- generated: NAME ARGUMENTS -->`` in pages by Markdown that a function makes from results or from the package."""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata

from docs._ext import tables

MARK = re.compile(r"^<!-- generated: (\w+) *(.*?) -->$", re.MULTILINE)


def filled(text: str) -> str:
    """Return a page with its marks replaced."""
    return MARK.sub(lambda mark: tables.TABLES[mark[1]](*mark[2].split()), text)


def read(app: Sphinx, page: str, source: list[str]) -> None:
    """Fill in a page that Sphinx reads."""
    source[0] = filled(source[0])


def keep(app: Sphinx, error: Exception | None) -> None:
    """Fill in the copies of the sources that readers, and llms.txt, get."""
    for path in (Path(app.outdir) / "_sources").rglob("*.md.txt") if error is None else ():
        text = path.read_text()
        if MARK.search(text):
            path.write_text(filled(text))


def setup(app: Sphinx) -> ExtensionMetadata:
    """Add the replacement."""
    app.connect("source-read", read)
    app.connect("build-finished", keep, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
