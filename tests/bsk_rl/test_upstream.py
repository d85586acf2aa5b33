"""bsk_rl's integration tests and examples, run by ``scripts/validation/upstream.py``; it needs the package index."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("what", ["tests", "examples"])
@pytest.mark.nightly
def test_what_bsk_rl_ships_runs_with_replaced_imports(what):
    script = ROOT / "scripts" / "validation" / "upstream.py"
    ran = subprocess.run([sys.executable, str(script), what], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout[-3000:] + ran.stderr[-3000:]


def test_the_script_starts():
    ran = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "validation" / "upstream.py"), "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "{tests,examples}" in ran.stdout
