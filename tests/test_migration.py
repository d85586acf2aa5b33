"""docs/migration_reference.md: every row of its tables names a test that exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "migration_reference.md").read_text()
ROWS = [line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith(("| bsk_rl |", "| topic |"))]


def functions(path: Path) -> set[str]:
    """Names of the functions of a file."""
    return {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("row", ROWS, ids=[row[2:42] for row in ROWS])
def test_a_claim_is_a_test(row):
    named = re.findall(r"<!-- (tests/\S+\.py)(?:::(test_\w+))? -->", row)
    assert len(named) == 1
    path, function = named[0]
    assert (ROOT / path).exists()
    found = functions(ROOT / path)
    assert function in found if function else any(name.startswith("test_") for name in found)


def test_all_tables_are_read():
    assert len(ROWS) > 70
