"""docs/migration_reference.md: every row of its tables names a test that exists."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "migration_reference.md").read_text()


def test_claims_are_tests():
    rows = [line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith(("| bsk_rl |", "| topic |"))]
    assert len(rows) > 60
    wrong = []
    for row in rows:
        named = re.findall(r"<!-- (tests/\S+\.py)(?:::(test_\w+))? -->", row)
        path = ROOT / named[0][0] if len(named) == 1 else None
        body = ast.parse(path.read_text()).body if path is not None and path.exists() else []
        functions = {node.name for node in body if isinstance(node, ast.FunctionDef)}
        if not (named and (named[0][1] in functions or (not named[0][1] and functions))):
            wrong.append(row)
    assert not wrong, "\n".join(wrong)
