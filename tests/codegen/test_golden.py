"""The C++ of every preset's ticks is the one that was last reviewed."""

from __future__ import annotations

import difflib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts" / "tools"))

from update_golden import FOLDER, TABLE, golden_files  # noqa: E402

SHOWN = 60
"""Lines of a difference that a failure shows."""


@pytest.fixture(scope="module")
def files() -> dict[str, str]:
    return golden_files()


def difference(name: str, expected: str, found: str) -> str:
    """A unified difference, cut off after ``SHOWN`` lines."""
    lines = list(difflib.unified_diff(expected.splitlines(), found.splitlines(), f"golden/{name}", "now", lineterm="", n=2))
    return "\n".join([*lines[:SHOWN], *([f"... and {len(lines) - SHOWN} more lines"] if len(lines) > SHOWN else [])])


def test_sources_are_the_golden_ones(files):
    assert {path.name for path in FOLDER.iterdir()} == set(files), "run python scripts/tools/update_golden.py"
    for name, found in files.items():
        expected = (FOLDER / name).read_text()
        assert found == expected, (
            f"the generated code has changed:\n{difference(name, expected, found)}\n"
            "If that is intended, run python scripts/tools/update_golden.py and commit the new files with the change."
        )


def test_differences_are_shown():
    shown = difference("a.cpp", "1\n2\n3", "1\ntwo\n3")
    assert shown.splitlines() == ["--- golden/a.cpp", "+++ now", "@@ -1,3 +1,3 @@", " 1", "-2", "+two", " 3"]
    long = difference("a.cpp", "", "\n".join(map(str, range(100))))
    assert long.splitlines()[-1] == "... and 43 more lines"


def test_sources_hold_nothing_of_the_machine(files):
    """Vectors are as wide as the header says; the header decides by macros of the compiler."""
    assert len(files) > 1
    for name in files.keys() - {TABLE}:
        assert not any(word in files[name].lower() for word in ("avx", "_mm", "__m512", "neon", "double[8]", str(ROOT)))
