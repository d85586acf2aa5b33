"""Write generated tables into the pages of docs/, and titles into their links without text.

    python docs/fill.py

A page asks for a table with ``<!-- generated: NAME ARGUMENTS -->``, a function of ``docs/_ext/tables.py``; the text is written
below, up to ``<!-- end -->``. A link ``[](page.md)`` or ``[](page.md#section)`` gets the title of its page or section once, and
is text of the page from then on.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from docs._ext import tables  # noqa: E402

DOCS = ROOT / "docs"
BUILT = ("_build", "_tutorials", "gallery", "api/reference")
"""Folders that a build of the site writes."""

MARK = re.compile(
    r"^<!-- generated: (\w+) *(.*?) -->\n(?:(?:(?!<!-- generated).*\n)*?<!-- end -->\n)?",
    re.MULTILINE,
)
EMPTY = re.compile(r"(?<![!`])\[\]\(([^)#\s]*\.md)?(?:#([^)\s]+))?\)")
HEAD = re.compile(r"^#+ (.*)$", re.MULTILINE)


def pages() -> list[Path]:
    """Return the pages of docs/ without the built ones."""
    return [
        path
        for path in sorted(DOCS.rglob("*.md"))
        if not path.relative_to(DOCS).as_posix().startswith(BUILT)
    ]


def anchor(head: str) -> str:
    """Return the anchor that repositories and MyST give to a heading."""
    return re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-")


def headings(text: str) -> dict[str, str]:
    """Return the headings of a page by their anchors."""
    plain = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return {anchor(head): head for head in HEAD.findall(plain)}


def filled(path: Path) -> str:
    """Return a page with its tables and the titles of its links."""

    def title(link: re.Match[str]) -> str:
        heads = headings((path.parent / link[1] if link[1] else path).read_text())
        text = heads[link[2]] if link[2] else next(iter(heads.values()))
        return f"[{text}]{link[0][2:]}"

    def table(mark: re.Match[str]) -> str:
        begin = " ".join(["<!-- generated:", mark[1], *mark[2].split(), "-->"])
        return f"{begin}\n\n{tables.TABLES[mark[1]](*mark[2].split()).strip()}\n\n<!-- end -->\n"

    return EMPTY.sub(title, MARK.sub(table, path.read_text()))


def main() -> None:
    """Write the pages that are not current."""
    for path in pages():
        text = filled(path)
        if text != path.read_text():
            path.write_text(text)
            print(os.path.relpath(path))  # noqa: T201


if __name__ == "__main__":
    main()
