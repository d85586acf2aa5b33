"""Report words and patterns that the documentation avoids, with what to write instead.

    python scripts/tools/check_prose.py [file ...]

The patterns are in ``prose.csv``, next to this script: regular expressions, matched in any case and across line breaks. Checked
are pages without their code, and docstrings, comments and other strings of Python files. Text in backticks is code. Without
arguments, the script checks :data:`PLACES`, and of the changelog only the newest version.
"""

from __future__ import annotations

import argparse
import ast
import csv
import io
import itertools
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CODE = "\N{REPLACEMENT CHARACTER}"
"""Replaces code, so that no phrase is found across it."""

PLACES = ("*.md", "bsk_torch", "docs", "examples", "scripts", ":!tests", ":!benchmarks")
"""Files and folders checked by default."""

NO_PROSE = re.compile(
    r"^(?P<fence>```+|~~~+)(?!\{(?:note|tip|warning|figure|admonition)\})[\s\S]*?^(?P=fence)"  # blocks of code
    r"|^<!-- generated: [\s\S]*?^<!-- end -->"
    r"|``[\s\S]+?``|`[^`]+`|<!--[\s\S]*?-->|\]\([^)]*\)|https?://\S+|<[a-z/][^>]*>",  # code, comments, targets of links, HTML
    re.MULTILINE,
)


def patterns() -> list[tuple[re.Pattern[str], str]]:
    """Return the patterns to avoid, each with its replacement."""
    with (Path(__file__).parent / "prose.csv").open() as file:
        rows = [(row["avoid"], row["write"]) for row in csv.DictReader(file)]
    loose = [(re.sub(r"(?<=[\w)?]) (?=[\w(])", r"\\s+", avoid), write) for avoid, write in rows]  # lines break at spaces
    return [(re.compile(rf"(?<!\w)(?:{avoid})(?!\w)", re.IGNORECASE | re.MULTILINE), write) for avoid, write in loose]


def blank(text: str) -> str:
    """Return text with its code replaced, character by character, so that line numbers are unchanged."""
    return NO_PROSE.sub(lambda found: re.sub(r"[^\n]", CODE, found[0]), text)


def page_text(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """Yield the prose of a page with its first line."""
    if path.name == "CHANGELOG.md":
        versions = re.finditer(r"^## [\d.]+", text, re.MULTILINE)
        text = text[: next((earlier.start() for earlier in itertools.islice(versions, 1, None)), None)]
    yield 1, blank(text)


def program_text(text: str) -> Iterator[tuple[int, str]]:
    """Yield comments and strings of a program with their first lines; consecutive lines of comments are joined."""
    start, lines, last = 0, [], -1
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            if token.start[0] != last + 1:
                yield start, blank("\n".join(lines))
                start, lines = token.start[0], []
            lines.append(token.string.removeprefix("#").removeprefix(" "))
            last = token.start[0]
    yield start, blank("\n".join(lines))
    tree = ast.parse(text)
    formatted = {part for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield node.lineno, blank("".join(part.value if isinstance(part, ast.Constant) else CODE for part in node.values))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value and node not in formatted:
            yield node.lineno, blank(node.value)


def check(path: Path, avoid: list[tuple[re.Pattern[str], str]]) -> Iterator[str]:
    """Yield a line for each match in a file: place, text, replacement."""
    text = path.read_text()
    for first, prose in program_text(text) if path.suffix == ".py" else page_text(path, text):
        for pattern, write in avoid:
            for found in pattern.finditer(prose):
                line = first + prose.count("\n", 0, found.start())
                yield f"{path}:{line}: {' '.join(found[0].split())!r}: {write}"


def main(names: list[str]) -> None:
    """Print the matches; exit with 1 if there are any."""
    if not names:
        listed = subprocess.run(["git", "ls-files", "-z", *PLACES], cwd=ROOT, capture_output=True, text=True, check=True)
        names = [name for name in listed.stdout.split("\0") if name.endswith((".md", ".py"))]
    avoid = patterns()
    found = [line for name in names if (ROOT / name).is_file() for line in check(ROOT / name, avoid)]
    print("\n".join(found) or f"no pattern of prose.csv in {len(names)} files")
    sys.exit(bool(found))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", metavar="file")
    main(parser.parse_args().files)
